"""Presets paper and geraf1: a training with checkpoints, then the mesh.

geraf1 follows the paper's description of its predecessor, without walls. The box is cropped out of
the radar image, the field is the distance of one region, and its transmittance is not corrected.
The level is chosen after the training, in the publication by hand.
"""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from geraf2._memory import require_memory
from geraf2.baselines.heat import counted_voxels
from geraf2.baselines.level import best_level
from geraf2.fields import SdfGrid
from geraf2.io.checkpoint import load_checkpoint, save_checkpoint
from geraf2.io.locks import lock_folder
from geraf2.io.run_folder import (
    CHECKPOINT_NAME,
    FIELDS_NAME,
    FIT_NAME,
    LOG_NAME,
    TRAINING_FOLDER,
    stage_key,
)
from geraf2.learned.config import TRAINING_VERSION, PaperConfig
from geraf2.pipeline.stages.direct import draw_surface
from geraf2.pipeline.stages.job import Job, Step
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


def crop_prior(prior: LosPrior, crop_m: float) -> LosPrior:
    """Bounding box of the innermost known box, cropped on every side [m], without walls."""
    if len(prior.walls) > 1:
        prior = LosPrior.from_box(prior.walls[-1].size_m, prior.walls[-1].center_m)
    return prior.crop(crop_m)


def reconstruct_paper(job: Job) -> None:
    """Train the fields of the paper."""
    config = job.config.paper
    draw_surface(job, _train(job, job.prior, config), float(config.crop_m))


def reconstruct_geraf1(job: Job) -> None:
    """Train inside the cropped box, and choose the level that explains the signals best."""
    paper, threads = job.config.paper, job.num_threads
    sdf = _train(job, crop_prior(job.prior, paper.crop_m), geraf1_config(paper))
    counted = counted_voxels(job.prior, sdf.grid, paper.crop_m, num_threads=threads)
    level = best_level(sdf, counted, job.capture, 0.0, job.config.level, num_threads=threads)
    values = (sdf.values - level).astype(sdf.values.dtype)
    draw_surface(job, SdfGrid(grid=sdf.grid, values=values), float(paper.crop_m))


def _train(job: Job, prior: LosPrior, config: PaperConfig) -> SdfGrid:
    """Train both stages, or their remaining steps, and write the fields."""
    import torch  # noqa: PLC0415 - torch takes a second

    from geraf2.learned.checkpoints import save_state  # noqa: PLC0415 - needs torch
    from geraf2.learned.resources import training_bytes  # noqa: PLC0415 - needs torch
    from geraf2.learned.trainer import PaperTrainer, run_steps  # noqa: PLC0415 - needs torch

    if job.num_threads is not None:
        torch.set_num_threads(job.num_threads)
    require_memory(
        training_bytes(config, job.capture, torch.get_num_threads()),
        "lower --paper.n-cells, --paper.n-samples or --paper.n-antennas",
    )
    settings = {name: value for name, value in asdict(config).items() if name != "device"}
    key = stage_key(
        version=TRAINING_VERSION,
        preset=job.config.preset,
        config=settings,
        seed=job.seed,
        **job.inputs,
    )
    run, checkpoint = job.run, job.run.place / CHECKPOINT_NAME
    with job.step("train") as step, _keep_unfinished(job):
        trainer = PaperTrainer(
            job.capture, prior, config, seed=job.seed, num_threads=job.num_threads
        )
        run.log("device", level="info", device=str(trainer.device))
        if checkpoint.is_file():
            _resume(job, trainer, key)
        try:
            run_steps(trainer, on_step=_Watcher(job, step, trainer, config, key))
            sdf, shift = trainer.distance(), trainer.glint_shift
        except KeyboardInterrupt:
            save_checkpoint(checkpoint, save_state(trainer, key))
            raise
        save_checkpoint(checkpoint, save_state(trainer, key))
        if shift is not None:
            run.log(
                "glint_level",
                level="info",
                glints=shift.n_glints,
                inward_mm=1e3 * shift.inward_m,
                outside_mm=[1e3 * outside_m for outside_m in shift.outside_m],
            )
        sdf.save(run.path / FIT_NAME)
    return sdf


@contextmanager
def _keep_unfinished(job: Job) -> Iterator[None]:
    """Folder of the training beside the new one, whose files the new one gets at the end.

    A failed training keeps it where there is a checkpoint.
    """
    run, was_there = job.run, job.run.place.exists()
    folder = run.place / TRAINING_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    with lock_folder(folder):
        if not job.resume:
            for path in folder.iterdir():
                if path.is_file():
                    path.unlink()
        begun = run.log_path.read_bytes()
        run.log_path = folder / LOG_NAME
        with run.log_path.open("ab") as log:
            log.write(begun)
        try:
            yield
        except BaseException:
            if not (run.place / CHECKPOINT_NAME).is_file():
                shutil.rmtree(folder, ignore_errors=True)
                with suppress(OSError):
                    if not was_there:
                        run.place.rmdir()
            raise
        for name, link in (
            (CHECKPOINT_NAME, FIELDS_NAME),
            (f"{TRAINING_FOLDER}/{LOG_NAME}", LOG_NAME),
        ):
            (run.path / link).unlink(missing_ok=True)
            shutil.copy2(run.place / name, run.path / link)
        run.log_path = run.path / LOG_NAME


def _resume(job: Job, trainer: "PaperTrainer", key: str) -> None:
    from geraf2.learned.checkpoints import KIND, VERSION, load_state  # noqa: PLC0415 - needs torch

    path = job.run.place / CHECKPOINT_NAME
    checkpoint = load_checkpoint(path, kind=KIND, version=VERSION)
    if checkpoint.header.get("key") != key:
        job.listener.warning(f"{path} has other settings; the training starts again")
        return
    load_state(trainer, checkpoint, key, path)


class _Watcher:
    """Logs and saves during the training, and reports its progress."""

    def __init__(
        self,
        job: Job,
        step: Step,
        trainer: "PaperTrainer",
        config: PaperConfig,
        key: str,
    ) -> None:
        self._run, self._progress = job.run, step.progress
        self._trainer, self._config, self._key = trainer, config, key
        self._sums: dict[str, float] = {}
        self._n_summed = 0
        self._saved = time.monotonic()

    def __call__(self, step: "StepReport") -> None:
        from geraf2.learned.checkpoints import save_state  # noqa: PLC0415 - needs torch

        config, n_done = self._config, self._trainer.stages.steps_done
        self._progress(n_done / max(self._trainer.stages.total_steps, 1))
        values = {"heatmap": step.heatmap, "eikonal": step.eikonal, "rsdf": step.rsdf}
        for name, value in values.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._n_summed += 1
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
            state = save_state(self._trainer, self._key)
            save_checkpoint(self._run.place / CHECKPOINT_NAME, state)
