"""`geraf2 image`: matched-filter volume of a scene."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from geraf2.cli._console import (
    Positional,
    Threads,
    print_findings,
    progress_bar,
    require_threads,
    say,
    warn,
)
from geraf2.cli._fields import Arg
from geraf2.errors import UserError
from geraf2.geometry.boxes import box_corners
from geraf2.imaging.plane_waves import depth_sharpness, keep_angles
from geraf2.imaging.volume import image_volume
from geraf2.io.atomic import write_json_atomic, write_npz_atomic
from geraf2.io.run_folder import RunFolder, stage_key
from geraf2.ops import explain_method
from geraf2.pipeline.estimates import DEFAULT_IMAGE_SIDE_M, DEFAULT_IMAGE_SPACING_M
from geraf2.scene import Capture, Grid, Pose, load_capture
from geraf2.scene.checks import require_plausible
from geraf2.scene.store import capture_digest
from geraf2.scene.summary import CaptureSummary, summarize_capture

IMAGE_NAME = "image.npz"
SIDECAR_NAME = "image.json"
PICTURE_NAME = "figures/projections.png"
DEPTH_PICTURE_NAME = "figures/depth.png"
# A looking direction this near to an axis of the frame, as a cosine, has slices across it.
_ALONG_AXIS = 0.999
_LABELS = {
    IMAGE_NAME: "volume",
    SIDECAR_NAME: "about it",
    PICTURE_NAME: "projections",
    DEPTH_PICTURE_NAME: "sharpest slice",
}
# A grid beyond this is a slip of the keyboard: 8 GiB.
_MAX_VOXELS = 2_000_000_000


@dataclass(frozen=True, kw_only=True)
class Config:
    """Image a scene with the matched filter: full apertures, magnitudes added over the poses.

    A planar scan needs no box: --depth-m and --extent-m say what is imaged, and the depth at
    which its image is sharpest is found.
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
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
    depth_m: Annotated[tuple[float, float] | None, Arg(metavar="NEAR FAR")] = None
    """Image one pose between these distances from its antennas [m], and find the sharpest."""
    extent_m: Annotated[tuple[float, float] | None, Arg(metavar="HORIZONTAL VERTICAL")] = None
    """With --depth-m: extent across the looking direction [m]; by default that of the antennas."""
    angles_deg: Annotated[tuple[float, float] | None, Arg(metavar="LOW HIGH")] = None
    """Keep only waves from between these angles off the looking direction [degrees]: 0 60 takes
    off what runs along the antennas, 10 60 flat reflections from right before the radar, too."""
    threads: Threads = None
    """Threads to use; all when not given."""


def main(config: Config) -> int:
    """Run the command."""
    num_threads = require_threads(config.threads)
    capture = load_capture(config.scene)
    summary = summarize_capture(capture)
    print_findings(require_plausible(summary, config.scene))
    poses = _chosen_poses(config, capture)
    grid = _grid(config, summary) if config.depth_m is None else _depth_grid(config, capture, poses)
    axis = None if config.depth_m is None else _axis_along(capture.poses[poses[0]])
    imaged = _with_angles(config, capture, poses)
    run = RunFolder.open(
        config.out, scene_digest=capture_digest(capture), scene_name=config.scene.resolve().name
    )
    start = time.perf_counter()
    _explain(imaged, grid, poses[0], run)
    with progress_bar(f"imaging {len(poses)} poses, {grid.n_voxels} voxels") as report:
        volume = image_volume(imaged, grid, poses=poses, num_threads=num_threads, progress=report)
    write_npz_atomic(
        run.path / IMAGE_NAME,
        {
            "volume": volume,
            "origin_m": np.asarray(grid.origin_m),
            "spacing_m": np.asarray(grid.spacing_m),
            "poses": np.asarray(poses, dtype=np.int64),
        },
    )
    files = [IMAGE_NAME, SIDECAR_NAME, PICTURE_NAME]
    depths, sharpness = np.zeros(0), np.zeros(0)
    if axis is not None:
        depths, sharpness = _find_depth(volume, grid, axis, capture.poses[poses[0]])
        files.append(DEPTH_PICTURE_NAME)
    _write_sidecar(run.path / SIDECAR_NAME, config, capture, grid, poses, (depths, sharpness))
    _draw(volume, grid, run.path, axis, (depths, sharpness))
    key = stage_key(scene=run.scene_digest, grid=grid, poses=poses, angles_deg=config.angles_deg)
    seconds = time.perf_counter() - start
    run.mark_done("image", key, files, seconds)
    run.log("image", level="info", seconds=round(seconds, 2), poses=len(poses))
    place = np.unravel_index(int(volume.argmax()), volume.shape)
    strongest = [axis_m[i] for axis_m, i in zip(grid.axes_m, place, strict=True)]
    say("largest at     ({:.3f}, {:.3f}, {:.3f}) m".format(*strongest))
    if axis is not None:
        best = int(sharpness.argmax())
        say(f"sharpest depth {depths[best]:.4f} m, sharpness {sharpness[best]:.3g}")
        if best in (0, len(depths) - 1):
            warn("the image is sharpest where it ends: widen --depth-m")
    for name in files:
        say(f"{_LABELS[name]:<13}  {run.path / name}")
    return 0


def _explain(capture: Capture, grid: Grid, index: int, run: RunFolder) -> None:
    """Log which kernel images the first of the poses, and why; the others are much like it."""
    pose = capture.poses[index]
    choice = explain_method(
        pose.tx_positions, pose.rx_positions, grid, capture.waveform, dtype=pose.signal.dtype
    )
    run.log("image_method", level="info", method=choice.method, reason=choice.reason)
    say(f"{'method':<13}  {choice.reason}")


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
    return Grid.centered(center, config.spacing_m, steps + 1)


def _depth_grid(config: Config, capture: Capture, poses: list[int]) -> Grid:
    """Voxels before one pose, which the box of --depth-m and --extent-m bounds."""
    near, far = config.depth_m or (0.0, 0.0)
    if not (np.isfinite((near, far)).all() and 0 <= near < far):
        raise UserError(what="--depth-m must be two rising distances", got=config.depth_m)
    if config.size_m is not None:
        raise UserError(what="--depth-m and --size-m exclude each other")
    if len(poses) != 1:
        raise UserError(what="--depth-m needs one pose", got=len(poses), hint="add --pose N")
    pose = capture.poses[poses[0]]
    along = pose.phase_centers @ pose.axes.T
    extent = config.extent_m or tuple(np.ptp(along[:, 1:], axis=0))
    if not (np.isfinite(extent).all() and min(extent) > 0):
        raise UserError(what="--extent-m must be two positive lengths", got=extent)
    center = 0.5 * (along.min(axis=0) + along.max(axis=0))
    if config.center_m is not None:
        center[1:] = (pose.axes @ np.asarray(config.center_m))[1:]
    center[0] = float(np.median(along[:, 0])) + 0.5 * (near + far)
    corners = box_corners(center, [far - near, *extent]) @ pose.axes
    size, middle = np.ptp(corners, axis=0), 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    # A side along which nothing extends still needs a voxel.
    size = np.maximum(size, 1e-9)
    boxed = replace(
        config,
        size_m=(float(size[0]), float(size[1]), float(size[2])),
        center_m=(float(middle[0]), float(middle[1]), float(middle[2])),
    )
    return _grid(boxed, summarize_capture(replace(capture, poses=(pose,))))


def _axis_along(pose: Pose) -> int | None:
    """Axis of the frame along which a pose looks; None where it looks across them."""
    axis = int(np.abs(pose.axes[0]).argmax())
    return axis if abs(pose.axes[0, axis]) >= _ALONG_AXIS else None


def _find_depth(
    volume: NDArray[np.float32], grid: Grid, axis: int, pose: Pose
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distance of each slice from the antennas [m], and its sharpness."""
    places = grid.origin_m[axis] + grid.spacing_m * np.arange(grid.shape[axis])
    antennas = float(np.median(pose.phase_centers[:, axis]))
    depths = (places - antennas) * np.sign(pose.axes[0, axis])
    return depths, depth_sharpness(volume, axis)


def _with_angles(config: Config, capture: Capture, poses: list[int]) -> Capture:
    if config.angles_deg is None:
        return capture
    low, high = config.angles_deg
    if not 0 <= low < high <= 90:
        raise UserError(
            what="--angles-deg must be two rising angles", expected="0 to 90", got=config.angles_deg
        )
    kept = list(capture.poses)
    for index in poses:
        kept[index] = keep_angles(kept[index], capture.waveform, low, high)
    return replace(capture, poses=tuple(kept))


def _write_sidecar(
    path: Path,
    config: Config,
    capture: Capture,
    grid: Grid,
    poses: list[int],
    focus: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    depths, sharpness = focus
    about_depth = {
        "depths_m": depths.tolist(),
        "sharpness": sharpness.tolist(),
        "sharpest_depth_m": float(depths[sharpness.argmax()]) if len(depths) else None,
    }
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
            "angles_deg": None if config.angles_deg is None else list(config.angles_deg),
            **(about_depth if len(depths) else {}),
        },
    )


def _draw(
    volume: NDArray[np.float32],
    grid: Grid,
    folder: Path,
    axis: int | None,
    focus: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    from geraf2.report import projections, sharpest_slice  # noqa: PLC0415 - takes 0.5 s

    (folder / PICTURE_NAME).parent.mkdir(parents=True, exist_ok=True)
    with progress_bar("drawing"):
        projections(volume, grid, folder / PICTURE_NAME)
        if axis is not None:
            sharpest_slice(volume, grid, axis, *focus, folder / DEPTH_PICTURE_NAME)
