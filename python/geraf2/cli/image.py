"""`geraf2 image`: matched-filter volume of a scene."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray

from geraf2.cli._console import (
    Positional,
    Threads,
    print_findings,
    progress_bar,
    require_threads,
    say,
)
from geraf2.cli._estimates import DEFAULT_IMAGE_SIDE_M, DEFAULT_IMAGE_SPACING_M
from geraf2.errors import UserError
from geraf2.imaging.volume import image_volume
from geraf2.io.atomic import write_json_atomic, write_npz_atomic
from geraf2.io.run_folder import RunFolder, stage_key
from geraf2.scene import Capture, Grid, load_capture
from geraf2.scene.checks import require_plausible
from geraf2.scene.store import capture_digest
from geraf2.scene.summary import CaptureSummary, summarize_capture

IMAGE_NAME = "image.npz"
SIDECAR_NAME = "image.json"
PICTURE_NAME = "figures/projections.png"
# A grid beyond this is a slip of the keyboard: 8 GiB.
_MAX_VOXELS = 2_000_000_000


@dataclass(frozen=True, kw_only=True)
class Config:
    """Image a scene with the matched filter: full apertures, magnitudes added over the poses."""

    scene: Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Run folder; gets image.npz, image.json and figures/projections.png."""
    pose: int | None = None
    """Image this pose alone, counted from 0."""
    every: int = 1
    """Use every n-th pose only."""
    spacing_m: float = DEFAULT_IMAGE_SPACING_M
    """Distance of voxels [m]."""
    size_m: tuple[float, float, float] | None = None
    """Side lengths of the volume [m]; by default the outer wall's, or 0.24 m."""
    center_m: tuple[float, float, float] | None = None
    """Centre of the volume [m]; by default the outer wall's, or where the poses look at."""
    threads: Threads = None
    """Threads to use; all when not given."""


def main(config: Config) -> int:
    """Run the command."""
    num_threads = require_threads(config.threads)
    capture = load_capture(config.scene)
    summary = summarize_capture(capture)
    print_findings(require_plausible(summary, config.scene))
    poses = _chosen_poses(config, capture)
    grid = _grid(config, summary)
    run = RunFolder.open(
        config.out, scene_digest=capture_digest(capture), scene_name=config.scene.resolve().name
    )
    start = time.perf_counter()
    with progress_bar(f"imaging {len(poses)} poses, {grid.n_voxels} voxels") as report:
        volume = image_volume(capture, grid, poses=poses, num_threads=num_threads, progress=report)
    write_npz_atomic(
        run.path / IMAGE_NAME,
        {
            "volume": volume,
            "origin_m": np.asarray(grid.origin_m),
            "spacing_m": np.asarray(grid.spacing_m),
            "poses": np.asarray(poses, dtype=np.int64),
        },
    )
    _write_sidecar(run.path / SIDECAR_NAME, capture, grid, poses)
    _draw(volume, grid, run.path / PICTURE_NAME)
    files = [IMAGE_NAME, SIDECAR_NAME, PICTURE_NAME]
    key = stage_key(scene=run.scene_digest, grid=grid, poses=poses)
    seconds = time.perf_counter() - start
    run.mark_done("image", key, files, seconds)
    run.log("image", level="info", seconds=round(seconds, 2), poses=len(poses))
    strongest = grid.points()[int(volume.argmax())]
    say("largest at     ({:.3f}, {:.3f}, {:.3f}) m".format(*strongest))
    for label, name in (("volume", IMAGE_NAME), ("about it", SIDECAR_NAME)):
        say(f"{label:<13}  {run.path / name}")
    say(f"{'projections':<13}  {run.path / PICTURE_NAME}")
    return 0


def _chosen_poses(config: Config, capture: Capture) -> list[int]:
    n_poses = len(capture.poses)
    if config.every < 1:
        raise UserError(what="--every must be at least 1", got=config.every)
    if config.pose is None:
        return list(range(0, n_poses, config.every))
    if not 0 <= config.pose < n_poses:
        raise UserError(
            what="--pose names no pose", expected=f"0 to {n_poses - 1}", got=config.pose
        )
    return [config.pose]


def _grid(config: Config, summary: CaptureSummary) -> Grid:
    """Voxels centred on the volume, which they cover."""
    if not (np.isfinite(config.spacing_m) and config.spacing_m > 0):
        raise UserError(what="--spacing-m must be positive", got=config.spacing_m)
    wall = summary.walls[0] if summary.walls else None
    size = config.size_m or (wall.size_m if wall else (DEFAULT_IMAGE_SIDE_M,) * 3)
    if not (np.isfinite(size).all() and min(size) > 0):
        raise UserError(what="--size-m must be three positive lengths", got=size)
    center = config.center_m or (wall.center_m if wall else summary.focus)
    if center is None or not np.isfinite(center).all():
        raise UserError(what="--center-m must be three coordinates", got=center)
    steps = np.ceil(np.asarray(size) / config.spacing_m - 1e-9)
    if float(np.prod(steps + 1)) > _MAX_VOXELS:
        raise UserError(
            what=f"the volume would have {float(np.prod(steps + 1)):.2g} voxels",
            expected=f"at most {_MAX_VOXELS:.2g}",
            hint="raise --spacing-m or lower --size-m",
        )
    origin = np.asarray(center) - 0.5 * steps * config.spacing_m
    return Grid(
        origin_m=(float(origin[0]), float(origin[1]), float(origin[2])),
        spacing_m=config.spacing_m,
        shape=(int(steps[0]) + 1, int(steps[1]) + 1, int(steps[2]) + 1),
    )


def _write_sidecar(path: Path, capture: Capture, grid: Grid, poses: list[int]) -> None:
    write_json_atomic(
        path,
        {
            "format": "geraf2-image",
            "format_version": 1,
            "file": IMAGE_NAME,
            "unit": "metre",
            "frame": capture.frame,
            "quantity": "sum over poses of the magnitude of the matched-filter image, each "
            "normalised by its number of antennas",
            "axes": "volume[x, y, z] at origin_m + index * spacing_m",
            "origin_m": list(grid.origin_m),
            "spacing_m": grid.spacing_m,
            "shape": list(grid.shape),
            "poses": poses,
        },
    )


def _draw(volume: NDArray[np.float32], grid: Grid, path: Path) -> None:
    from geraf2.report import projections  # noqa: PLC0415 - matplotlib takes 0.5 s

    path.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar("drawing"):
        projections(volume, grid, path)
