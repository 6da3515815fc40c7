"""Neural surface from photos: start, steps, checkpoints, progress."""

import json
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from geraf2._types import AnyPath
from geraf2.apps.photos.config import PhotoConfig
from geraf2.apps.photos.grid_smoothing import quick_redistance
from geraf2.apps.photos.neural_surface import KIND, VERSION, NeuralSurface, enclosing_cube
from geraf2.apps.photos.neus.coloured_grid import ColouredGrid
from geraf2.apps.photos.photo_checks import MIN_PHOTOS
from geraf2.apps.photos.rays import fit_resolution
from geraf2.apps.photos.trainer import PhotoTrainer
from geraf2.apps.photos.visual_hull import Region, VisualHull, find_region
from geraf2.errors import UserError
from geraf2.io.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from geraf2.io.text import parse_json
from geraf2.io.toml import from_table
from geraf2.scene.photos import PhotoSet

_CHECKPOINT_EVERY_S = 60.0

Progress = Callable[[PhotoTrainer, dict[str, float]], None]


def train_neural_surface(
    photo_set: PhotoSet,
    config: PhotoConfig | None = None,
    *,
    region: Region | None = None,
    progress: Progress | None = None,
    checkpoint: AnyPath | None = None,
    resume: bool = False,
) -> NeuralSurface:
    """Surface of a photo set, trained by volume rendering.

    photo_set: photos with cameras and masks, at least three.
    config: PhotoConfig() when None.
    region: box in which the surface lies; else found from the silhouettes.
    progress: receives the trainer and the weighted terms of its loss after every step.
    checkpoint: file that is written every minute and at the end.
    resume: continue from `checkpoint` if it exists, with bit-identical result.

    Returns NeuralSurface in the frame of the cameras, in metres. Raises UserError for photos
    without a common object, a loss that is not finite, or a checkpoint of other settings.
    """
    config = PhotoConfig() if config is None else config
    if len(photo_set) < MIN_PHOTOS:
        raise UserError(
            what="too few photos for a surface",
            expected=f"at least {MIN_PHOTOS}",
            got=len(photo_set),
        )
    photos = fit_resolution(photo_set)
    path = None if checkpoint is None else Path(checkpoint)
    stored = None
    if resume and path is not None and path.is_file():
        stored = load_checkpoint(path, kind=KIND, version=VERSION)
        _require_same(path, stored, config, photos)
    if stored is None:
        surface = start_surface(photos, config, region)
        rays_region = surface.region
    else:
        surface = NeuralSurface.from_state(stored.arrays, stored.header)
        rays_region = from_table(stored.header["rays_region"], Region, path)
    trainer = PhotoTrainer(photos, rays_region, surface, config)
    if stored is not None:
        trainer.restore(stored.arrays, stored.header)
    _run(trainer, progress, path, photos.names)
    return trainer.surface


def start_surface(
    photos: PhotoSet, config: PhotoConfig, region: Region | None = None
) -> NeuralSurface:
    """Start of the training: the visual hull of the silhouettes."""
    torch.manual_seed(config.seed)
    hull = VisualHull(photos)
    region = find_region(photos, hull) if region is None else region
    grid = region.grid(config.stages[0].n_longest)
    distance = hull.distance(grid.points()).reshape(grid.shape)
    values = torch.from_numpy(quick_redistance(distance, grid.spacing_m))
    field = ColouredGrid(enclosing_cube(region), grid, values, config.model)
    inv_s = config.first_sharpness / grid.spacing_m
    return NeuralSurface(config, region, field, inv_s=inv_s, frame=photos.frame)


def _run(
    trainer: PhotoTrainer, progress: Progress | None, path: Path | None, names: Sequence[str]
) -> None:
    saved_s = time.monotonic()
    with _delay_interrupts() as stops:
        while trainer.step_number < trainer.n_steps and not stops:
            losses = trainer.step()
            if path is not None and time.monotonic() - saved_s >= _CHECKPOINT_EVERY_S:
                _save(path, trainer, names)
                saved_s = time.monotonic()
            if progress is not None:
                progress(trainer, losses)
        if path is not None:
            _save(path, trainer, names)
        if stops:
            raise KeyboardInterrupt(stops[0])


def _save(path: Path, trainer: PhotoTrainer, names: Sequence[str]) -> None:
    arrays, header = trainer.state()
    header = parse_json(json.dumps(header | {"photos": list(names)}))
    save_checkpoint(path, Checkpoint(kind=KIND, version=VERSION, arrays=arrays, header=header))


@contextmanager
def _delay_interrupts() -> Iterator[list[int]]:
    """Delay the first Ctrl-C or SIGTERM to the end of a step; its number is in the list."""
    got: list[int] = []

    def remember(number: int, _: object) -> None:
        got.append(number)
        if len(got) > 1:
            raise KeyboardInterrupt(number)

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(signal.getsignal(number)):
                before[number] = signal.signal(number, remember)
    try:
        yield got
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _require_same(path: Path, stored: Checkpoint, config: PhotoConfig, photos: PhotoSet) -> None:
    wanted: dict[str, Any] = {
        "config": parse_json(json.dumps(asdict(config))),
        "photos": list(photos.names),
    }
    for name, value in wanted.items():
        if stored.header.get(name) != value:
            raise UserError(
                what=f"the checkpoint was made with another {name}",
                where=path,
                hint="choose another output, or start again without resuming",
            )
