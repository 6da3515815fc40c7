"""Stages of the presets paper and geraf1: training with checkpoints, then the mesh.

geraf1 follows the paper's description of its predecessor, without walls. The box is cropped out of
the radar image, the field is the distance of one region, and its transmittance is not corrected.
The level is chosen after the training, in the publication by hand.
"""

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geraf2._memory import require_memory
from geraf2._types import Progress
from geraf2.baselines.heat import counted_voxels
from geraf2.baselines.level import best_level
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.io.checkpoint import load_checkpoint, save_checkpoint
from geraf2.io.run_folder import (
    CHECKPOINT_NAME,
    FIELDS_NAME,
    FIT_NAME,
    LIVE_FOLDER,
    TENSORBOARD_FOLDER,
)
from geraf2.learned.config import TRAINING_VERSION, PaperConfig
from geraf2.pipeline.stages.direct import loader, mesh_stage, saver
from geraf2.pipeline.stages.stage import Job, Stage, Stages
from geraf2.scene import LosPrior

if TYPE_CHECKING:
    from geraf2.learned.trainer import PaperTrainer, StepReport

_LOG_EVERY = 100
CHECKPOINT_S = 300.0
"""Longest time between two checkpoints [s]."""


def geraf1_config(config: PaperConfig) -> PaperConfig:
    """Config of geraf1: one stage with reflectivity, from a ball, without a vision field."""
    return replace(
        config,
        start="ball",
        ulos=False,
        stage1=replace(config.stage1, train_reflectivity=True, rsdf_weight=0.0),
        stage2=replace(config.stage2, n_steps=0),
    )


def cropped_prior(prior: LosPrior, crop_m: float) -> LosPrior:
    """Bounding box of the innermost known box, cropped on every side [m], without walls."""
    if len(prior.walls) > 1:
        prior = LosPrior.from_box(prior.walls[-1].size_m, prior.walls[-1].center_m)
    return prior.crop(crop_m)


def _settings(config: PaperConfig) -> dict[str, Any]:
    """Return the settings that determine the result of a training, without the device."""
    return {name: value for name, value in asdict(config).items() if name != "device"}


@dataclass(frozen=True, kw_only=True, eq=False)
class _Training:
    """Inputs of the training of a preset."""

    job: Job
    key: str
    """Hash of the training's inputs; a checkpoint with another hash is not resumed."""
    prior: LosPrior
    config: PaperConfig


def _train(training: _Training, progress: Progress) -> SdfGrid:
    """Train both stages, or their remaining steps, and write the fields."""
    import torch  # noqa: PLC0415 - torch takes a second

    from geraf2.learned.checkpoints import save_state  # noqa: PLC0415 - needs torch
    from geraf2.learned.resources import training_bytes  # noqa: PLC0415 - needs torch
    from geraf2.learned.trainer import PaperTrainer, run_steps  # noqa: PLC0415 - needs torch

    job, config, key = training.job, training.config, training.key
    if job.num_threads is not None:
        torch.set_num_threads(job.num_threads)
    require_memory(
        training_bytes(config, job.capture, torch.get_num_threads()),
        "lower --paper.n-cells, --paper.n-samples or --paper.n-antennas",
    )
    trainer = PaperTrainer(
        job.capture, training.prior, config, seed=job.seed, num_threads=job.num_threads
    )
    job.run.log("device", level="info", device=str(trainer.device))
    checkpoint = job.run.path / CHECKPOINT_NAME
    if job.resume and checkpoint.is_file():
        _resume(training, trainer, checkpoint)
    watcher = _Watcher(training, trainer, checkpoint, progress)
    try:
        run_steps(trainer, on_step=watcher)
        sdf, shift = trainer.distance(), trainer.glint_shift
    except KeyboardInterrupt:
        save_checkpoint(checkpoint, save_state(trainer, key))
        raise
    finally:
        watcher.close()
    save_checkpoint(job.run.path / FIELDS_NAME, save_state(trainer, key))
    checkpoint.unlink(missing_ok=True)
    if shift is not None:
        outside_mm = [1e3 * outside_m for outside_m in shift.outside_m]
        job.run.log(
            "glint_level",
            level="info",
            glints=shift.n_glints,
            inward_mm=1e3 * shift.inward_m,
            outside_mm=outside_mm,
        )
    return sdf


def _save(job: Job, sdf: SdfGrid) -> list[str]:
    return [FIELDS_NAME, *saver(FIT_NAME)(job, sdf)]


TRAIN: Stage[SdfGrid] = Stage(
    name="train",
    version=TRAINING_VERSION,
    settings=lambda config: _settings(config.paper),
    seeded=True,
    compute=lambda job, progress: _train(
        _Training(job=job, key=job.key(TRAIN), prior=job.prior, config=job.config.paper), progress
    ),
    save=_save,
    load=loader(FIT_NAME),
)
PAPER_STAGES: Stages = (
    TRAIN,
    mesh_stage((TRAIN,), lambda job: job[TRAIN], lambda job: float(job.config.paper.crop_m)),
)


def _train_geraf1(job: Job, progress: Progress) -> SdfGrid:
    config = geraf1_config(job.config.paper)
    prior = cropped_prior(job.prior, config.crop_m)
    key = job.key(TRAIN_GERAF1)
    return _train(_Training(job=job, key=key, prior=prior, config=config), progress)


TRAIN_GERAF1: Stage[SdfGrid] = Stage(
    name="train",
    version=TRAINING_VERSION,
    settings=lambda config: ["geraf1", _settings(geraf1_config(config.paper))],
    seeded=True,
    compute=_train_geraf1,
    save=_save,
    load=loader(FIT_NAME),
)


def _at_best_level(job: Job) -> SdfGrid:
    """Field shifted to the level that explains the signals best."""
    sdf, crop_m, threads = job[TRAIN_GERAF1], job.config.paper.crop_m, job.num_threads
    counted = counted_voxels(job.prior, sdf.grid, crop_m, num_threads=threads)
    level = best_level(sdf, counted, job.capture, 0.0, job.config.level, num_threads=threads)
    return SdfGrid(grid=sdf.grid, values=(sdf.values - level).astype(sdf.values.dtype))


GERAF1_STAGES: Stages = (
    TRAIN_GERAF1,
    mesh_stage(
        (TRAIN_GERAF1,),
        _at_best_level,
        lambda job: float(job.config.paper.crop_m),
        settings=lambda config: config.level,
    ),
)


def _resume(training: _Training, trainer: "PaperTrainer", path: Path) -> None:
    from geraf2.learned.checkpoints import KIND, VERSION, load_state  # noqa: PLC0415 - needs torch

    checkpoint = load_checkpoint(path, kind=KIND, version=VERSION)
    if checkpoint.header.get("key") != training.key:
        training.job.listener.warning(f"{path} has other settings; the training starts again")
        return
    load_state(trainer, checkpoint, training.key, path)


class _Watcher:
    """Logs, saves and draws during the training, and reports its progress."""

    def __init__(
        self, training: _Training, trainer: "PaperTrainer", checkpoint: Path, progress: Progress
    ) -> None:
        self._training, self._run = training, training.job.run
        self._trainer, self._checkpoint, self._progress = trainer, checkpoint, progress
        self._sums: dict[str, float] = {}
        self._n_summed = 0
        self._saved = time.monotonic()
        self._writer: Any = None
        if training.config.tensorboard:
            try:
                from torch.utils.tensorboard import SummaryWriter  # noqa: PLC0415 - an extra
            except ImportError as error:
                raise UserError(
                    what="--paper.tensorboard needs the package tensorboard",
                    hint="pip install 'geraf2[tensorboard]'",
                ) from error
            self._writer = SummaryWriter(
                str(self._run.path / TENSORBOARD_FOLDER), purge_step=trainer.stages.steps_done
            )

    def __call__(self, step: "StepReport") -> None:
        from geraf2.learned.checkpoints import save_state  # noqa: PLC0415 - needs torch

        config, n_done = self._training.config, self._trainer.stages.steps_done
        self._progress(n_done / max(self._trainer.stages.total_steps, 1))
        values = {"heatmap": step.heatmap, "eikonal": step.eikonal, "rsdf": step.rsdf}
        for name, value in values.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._n_summed += 1
        if self._writer is not None:
            for name, value in values.items():
                self._writer.add_scalar(f"loss/{name}", value, n_done)
            self._writer.add_scalar("fields/power", step.power, n_done)
            self._writer.add_scalar("fields/inv_s", step.inv_s, n_done)
        if n_done % _LOG_EVERY == 0 or self._trainer.stages.is_done:
            means = {n: round(v / self._n_summed, 6) for n, v in self._sums.items()}
            self._run.log(
                "training",
                level="info",
                stage=step.stage,
                step=n_done,
                power=step.power,
                inv_s=step.inv_s,
                **means,
            )
            self._sums, self._n_summed = {}, 0
        due = time.monotonic() - self._saved > CHECKPOINT_S
        if due or n_done % config.checkpoint_every == 0:
            self._saved = time.monotonic()
            save_checkpoint(self._checkpoint, save_state(self._trainer, self._training.key))
        if config.slice_every and n_done % config.slice_every == 0:
            self._draw(n_done)

    def _draw(self, n_done: int) -> None:
        from geraf2.report.figures import sdf_slices  # noqa: PLC0415 - matplotlib takes 0.5 s

        folder = self._run.path / LIVE_FOLDER
        folder.mkdir(exist_ok=True)
        sdf = self._trainer.model.sdf.sample_grid(self._trainer.domain.grid(65))
        sdf_slices(sdf, folder / f"step_{n_done:06d}.png", center_m=self._training.prior.center_m)

    def close(self) -> None:
        """Close the TensorBoard writer."""
        if self._writer is not None:
            self._writer.close()
