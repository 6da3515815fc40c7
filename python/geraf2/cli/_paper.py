"""Stages of `geraf2 reconstruct --preset paper`: training with checkpoints, then the mesh."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geraf2.cli._console import warn
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.io.checkpoint import load_checkpoint, save_checkpoint
from geraf2.io.run_folder import RunFolder
from geraf2.paper.config import PaperConfig
from geraf2.paper.memory import training_bytes
from geraf2.pipeline.estimates import require_memory
from geraf2.scene import Capture, LosPrior

if TYPE_CHECKING:
    from geraf2.paper.trainer import PaperTrainer, StepReport

CHECKPOINT_NAME = "checkpoint.safetensors"
FIELDS_NAME = "fields.safetensors"
LIVE_FOLDER = "live"
TENSORBOARD_FOLDER = "tensorboard"
_LOG_EVERY = 100


@dataclass(frozen=True, kw_only=True)
class PaperJob:
    """What the stages of the preset need."""

    run: RunFolder
    capture: Capture
    prior: LosPrior
    config: PaperConfig
    seed: int
    num_threads: int | None
    resume: bool
    key: str
    """Of the training: a checkpoint of another key is not gone on with."""


def train(job: PaperJob, report: Callable[[float], None]) -> tuple[SdfGrid, list[str]]:
    """Train both stages, or what is left of them; writes the fields and the distance on a grid."""
    import torch  # noqa: PLC0415 - torch takes a second

    from geraf2.paper.checkpoints import save_state  # noqa: PLC0415 - needs torch
    from geraf2.paper.trainer import PaperTrainer, run_steps  # noqa: PLC0415 - needs torch

    require_memory(
        training_bytes(job.config, job.capture),
        "lower --paper.n-cells, --paper.n-samples or --paper.n-antennas",
    )
    if job.num_threads is not None:
        torch.set_num_threads(job.num_threads)
    trainer = PaperTrainer(
        job.capture, job.prior, job.config, seed=job.seed, num_threads=job.num_threads
    )
    checkpoint = job.run.path / CHECKPOINT_NAME
    if job.resume and checkpoint.is_file():
        _go_on(trainer, checkpoint, job.key)
    watcher = _Watcher(job, trainer, checkpoint, report)
    try:
        run_steps(trainer, on_step=watcher)
    except KeyboardInterrupt:
        save_checkpoint(checkpoint, save_state(trainer, job.key))
        raise
    finally:
        watcher.close()
    save_checkpoint(job.run.path / FIELDS_NAME, save_state(trainer, job.key))
    checkpoint.unlink(missing_ok=True)
    sdf = trainer.model.sdf.sample_grid(trainer.domain.grid(job.config.mesh_n))
    sdf.save(job.run.path / "sdf_fit.npz")
    return sdf, [FIELDS_NAME, "sdf_fit.npz"]


def _go_on(trainer: "PaperTrainer", path: Path, key: str) -> None:
    from geraf2.paper.checkpoints import KIND, VERSION, load_state  # noqa: PLC0415 - needs torch

    checkpoint = load_checkpoint(path, kind=KIND, version=VERSION)
    if checkpoint.header.get("key") != key:
        warn(f"{path} is of other settings; the training starts again")
        return
    load_state(trainer, checkpoint, key, path)


class _Watcher:
    """Logs, saves, draws and counts while the training runs."""

    def __init__(
        self,
        job: PaperJob,
        trainer: "PaperTrainer",
        checkpoint: Path,
        report: Callable[[float], None],
    ) -> None:
        self._job, self._trainer, self._checkpoint = job, trainer, checkpoint
        self._report = report
        self._sums: dict[str, float] = {}
        self._n_summed = 0
        self._writer: Any = None
        if job.config.tensorboard:
            try:
                from torch.utils.tensorboard import SummaryWriter  # noqa: PLC0415 - an extra
            except ImportError as error:
                raise UserError(
                    what="--paper.tensorboard wants the package tensorboard",
                    hint="pip install 'geraf2[tensorboard]'",
                ) from error
            self._writer = SummaryWriter(
                str(job.run.path / TENSORBOARD_FOLDER), purge_step=trainer.steps_done
            )

    def __call__(self, step: "StepReport") -> None:
        from geraf2.paper.checkpoints import save_state  # noqa: PLC0415 - needs torch

        config, n_done = self._job.config, self._trainer.steps_done
        self._report(n_done / max(self._trainer.total_steps, 1))
        values = {"heatmap": step.heatmap, "eikonal": step.eikonal, "rsdf": step.rsdf}
        for name, value in values.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._n_summed += 1
        if self._writer is not None:
            for name, value in values.items():
                self._writer.add_scalar(f"loss/{name}", value, n_done)
            self._writer.add_scalar("fields/power", step.power, n_done)
            self._writer.add_scalar("fields/inv_s", step.inv_s, n_done)
        if n_done % _LOG_EVERY == 0 or self._trainer.is_done:
            means = {n: round(v / self._n_summed, 6) for n, v in self._sums.items()}
            self._job.run.log(
                "training", level="info", stage=step.stage, step=n_done, power=step.power,
                inv_s=step.inv_s, **means,
            )  # fmt: skip
            self._sums, self._n_summed = {}, 0
        if n_done % config.checkpoint_every == 0:
            save_checkpoint(self._checkpoint, save_state(self._trainer, self._job.key))
        if config.slice_every and n_done % config.slice_every == 0:
            self._draw(n_done)

    def _draw(self, n_done: int) -> None:
        from geraf2.report.figures import sdf_slices  # noqa: PLC0415 - matplotlib takes 0.5 s

        folder = self._job.run.path / LIVE_FOLDER
        folder.mkdir(exist_ok=True)
        sdf = self._trainer.model.sdf.sample_grid(self._trainer.domain.grid(65))
        sdf_slices(sdf, folder / f"step_{n_done:06d}.png", center_m=self._job.prior.center_m)

    def close(self) -> None:
        """Flush what is written besides."""
        if self._writer is not None:
            self._writer.close()
