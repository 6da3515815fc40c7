"""Matched-filter volume of a scene into a run folder, with pictures."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import ArrayLike, NDArray

from geraf2._bounds import Bounded, CellM, Count, CountOrZero, LengthM, MarginM, Sides, Triple
from geraf2._memory import require_memory
from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.geometry.boxes import box_corners
from geraf2.geometry.transforms import triple
from geraf2.imaging.plane_waves import depth_sharpness, keep_angles, search_depth
from geraf2.imaging.volume import image_volume, slabs_of
from geraf2.io.atomic import write_json_atomic, write_npz_atomic
from geraf2.io.run_folder import IMAGE_NAME, OF_IMAGE, RunFolder, StageRecord, stage_key
from geraf2.ops import explain_method
from geraf2.pipeline.estimates import DEFAULT_IMAGE_SIDE_M, DEFAULT_IMAGE_SPACING_M, image_estimate
from geraf2.pipeline.events import Listener
from geraf2.scene import Capture, Grid, Pose
from geraf2.scene.capture import LazyPoses
from geraf2.scene.checks import require_plausible
from geraf2.scene.plan import depth_of_focus_m
from geraf2.scene.store import capture_digest, open_capture
from geraf2.scene.summary import CaptureSummary, summarize_capture

SIDECAR_NAME = "image.json"
PICTURE_NAME = "figures/projections.png"
DEPTH_PICTURE_NAME = "figures/depth.png"
# A looking direction this near to an axis of the frame, as a cosine, has slices across it.
_ALONG_AXIS = 0.999
# Around a depth that was searched a wide plane is imaged no finer than this allows: a minute.
_MAX_SEARCHED_VOXELS = 2_000_000
# A grid beyond this is a slip of the keyboard: 8 GiB.
_MAX_VOXELS = 2_000_000_000


_Angle = Annotated[float, Interval(ge=0.0, le=90.0)]


@dataclass(frozen=True, kw_only=True)
class ImageOptions(Bounded):
    """Poses and grid of an image."""

    plane: CountOrZero | None = None
    """Image this plane alone, counted from 0."""
    every: Count = 1
    """Use every n-th plane only."""
    spacing_m: CellM | None = None
    """Distance of voxels [m]; by default 0.004; before a single plane half of what it resolves
    across where that is less, or what 2 million voxels hold."""
    size_m: Sides | None = None
    """Side lengths of the volume [m]; by default the outer wall's, or 0.24 m."""
    center_m: Triple | None = None
    """Centre of the volume [m]; by default the outer wall's, or the point that the planes face."""
    depth_m: tuple[MarginM, MarginM] | None = None
    """Image one plane between these distances from its antennas [m], and find the sharpest; of a
    single plane without a box the distance is searched by default."""
    extent_m: tuple[LengthM, LengthM] | None = None
    """With --depth-m: horizontal and vertical extent across the looking direction [m]; by default
    that of the antennas."""
    angles_deg: tuple[_Angle, _Angle] | None = None
    """Keep only waves from between these angles off the looking direction [degrees]: 0 60 removes
    waves along the antennas, 10 60 also flat reflections from right before the radar."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageResult:
    """A volume in memory, which also lies in a run folder."""

    path: Path
    """The folder."""
    files: tuple[str, ...]
    """Names of its files in the folder."""
    method: str
    """Kernel of the first pose, and the reason; other poses are similar."""
    depths_m: NDArray[np.float64]
    """Distance of each slice from the antennas with depth_m, else empty [m]."""
    sharpness: NDArray[np.float64]
    """Of each of these slices."""
    searched_m: float | None = None
    """Where a search before a single plane found it sharpest [m]; the volume lies around it."""
    volume: NDArray[np.float32]
    """Sum over poses of the magnitude of their images, grid.shape."""
    grid: Grid
    """Voxels of the volume [m]."""

    @property
    def strongest_m(self) -> tuple[float, float, float]:
        """Position of the largest value [m]."""
        index = np.unravel_index(int(self.volume.argmax()), self.volume.shape)
        return triple(axis[i] for axis, i in zip(self.grid.axes_m, index, strict=True))


def image_scene(
    scene: Capture | Path | str,
    out: Path,
    options: ImageOptions | None = None,
    *,
    overwrite: bool = False,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> ImageResult:
    """Image a scene with the matched filter, and write volume, record and pictures.

    scene: capture, or the folder of one.
    out: run folder of the scene, made if need be; gets image.npz, image.json and figures/.
    overwrite: replace an image of other options, or the run of another scene.

    UserError for an implausible capture, options that do not fit it, a folder of another scene.
    """
    plan = _plan_image(scene, options or ImageOptions(), listener := listener or Listener())
    grid = plan.grid
    run = RunFolder.open(out, scene_digest=plan.digest, scene_name=plan.name, overwrite=overwrite)
    key = plan.key()
    run.require_same("image", key, "image", overwrite=overwrite)
    start, method = time.perf_counter(), _explain_image(plan)
    with listener.step(f"imaging {len(plan.poses)} planes, {grid.n_voxels} voxels") as report:
        volume = image_volume(
            plan.imaged,
            grid,
            poses=plan.poses,
            num_threads=num_threads,
            progress=report,
        )
    sharpness = np.zeros(0)
    if plan.axis is not None:
        sharpness = depth_sharpness(volume, plan.axis)
        plan.warn_of_ends(sharpness, listener)
    result = ImageResult(
        path=run.path,
        files=(IMAGE_NAME, SIDECAR_NAME, *plan.pictures),
        volume=volume,
        grid=grid,
        method=method,
        depths_m=plan.depths_m,
        sharpness=sharpness,
        searched_m=plan.searched_m,
    )
    run.begin()
    with run.rewrite(*OF_IMAGE):
        _write(result, plan)
        with listener.step("drawing"):
            _draw_image(plan, run.path, volume, sharpness)
        seconds = time.perf_counter() - start
        run.asked["image"] = key
        run.stages["image"] = StageRecord(seconds=round(seconds, 3))
        run.log("image", level="info", seconds=round(seconds, 2), method=method)
    return result


@dataclass(frozen=True, kw_only=True, eq=False)
class _ImagePlan:
    """Plan of an image; poses are read when needed."""

    name: str
    """Of the scene."""
    digest: str
    """Hash of the capture."""
    options: ImageOptions
    """With the depths that were searched."""
    imaged: Capture
    """Capture, without waves outside the requested angles."""
    poses: list[int]
    grid: Grid
    """Voxels [m]."""
    axis: int | None
    """Axis of the frame along which depths are compared, if they are."""
    depths_m: Floats
    """Distance of each slice across this axis from the antennas [m]."""
    searched_m: float | None
    """Depth that was searched [m]."""

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of the pictures."""
        return (PICTURE_NAME, *([DEPTH_PICTURE_NAME] * (self.axis is not None)))

    def key(self) -> str:
        """Hash of all that the volume depends on."""
        angles = self.options.angles_deg
        return stage_key(scene=self.digest, grid=self.grid, poses=self.poses, angles_deg=angles)

    def describe(self, sharpness: Floats) -> dict[str, object]:
        """Record of the volume, for its sidecar."""
        grid, angles = self.grid, self.options.angles_deg
        about: dict[str, object] = {
            "format": "geraf2-image",
            "format_version": 1,
            "file": IMAGE_NAME,
            "unit": "metre",
            "frame": self.imaged.frame,
            "quantity": "sum over poses of the magnitude of the matched-filter image, each "
            "normalised by its number of antennas",
            "axes": "volume[x, y, z] at origin_m + index * spacing_m",
            "origin_m": list(grid.origin_m),
            "spacing_m": grid.spacing_m,
            "shape": list(grid.shape),
            "poses": self.poses,
            "angles_deg": None if angles is None else list(angles),
        }
        if self.searched_m is not None:
            about["searched_depth_m"] = self.searched_m
        if len(sharpness):
            about |= {"depths_m": self.depths_m.tolist(), "sharpness": sharpness.tolist()}
            about["sharpest_depth_m"] = float(self.depths_m[sharpness.argmax()])
        return about

    def warn_of_ends(self, sharpness: Floats, listener: Listener) -> None:
        """Warning where the sharpest slice is the first or the last."""
        if sharpness.argmax() in (0, len(sharpness) - 1):
            listener.warning("the image is sharpest where it ends: widen --depth-m")


def _plan_image(
    scene: Capture | Path | str, options: ImageOptions, listener: Listener
) -> _ImagePlan:
    """Plan an image of a capture or a scene folder, whose poses are read one at a time.

    UserError for an implausible capture and options that do not fit it.
    """
    in_memory = isinstance(scene, Capture)
    capture = scene if isinstance(scene, Capture) else open_capture(scene)
    name = "capture" if isinstance(scene, Capture) else Path(scene).resolve().name
    summary = summarize_capture(capture)
    listener.findings(require_plausible(summary, name if in_memory else scene))
    poses = _chosen_poses(options, capture)
    imaged, searched = _filter_angles(options.angles_deg, capture, poses), None
    if summary.is_plane and not (options.depth_m or options.size_m or options.center_m):
        options, searched = _search_depth(options, imaged, listener)
    axis, depths = None, np.zeros(0)
    first = capture.poses[poses[0]]
    by_depth = options.depth_m is not None
    grid = _depth_grid(options, first, len(poses)) if by_depth else _grid(options, summary)
    needed = image_estimate(summary, grid.n_voxels).memory_bytes
    require_memory(needed, "raise --spacing-m or lower --size-m", where=name)
    if by_depth:
        axis = _axis_along(first)
        if axis is not None:
            depths = _depths(grid, axis, first)
    return _ImagePlan(
        name=name,
        digest=capture_digest(capture),
        options=options,
        imaged=imaged,
        poses=poses,
        grid=grid,
        axis=axis,
        depths_m=depths,
        searched_m=searched,
    )


def _explain_image(plan: _ImagePlan) -> str:
    """Kernel of the first slab of the first pose, and the reason."""
    pose = plan.imaged.poses[plan.poses[0]]
    _, slab = next(slabs_of(plan.grid))
    return explain_method(
        pose.tx_positions, pose.rx_positions, slab, plan.imaged.waveform, dtype=pose.signal.dtype
    ).reason


def _chosen_poses(options: ImageOptions, capture: Capture) -> list[int]:
    n_poses = len(capture.poses)
    if options.plane is None:
        return list(range(0, n_poses, options.every))
    if not 0 <= options.plane < n_poses:
        raise UserError(
            what="--plane names no plane", expected=f"0 to {n_poses - 1}", got=options.plane
        )
    return [options.plane]


def _search_depth(
    options: ImageOptions, capture: Capture, listener: Listener
) -> tuple[ImageOptions, float | None]:
    """Options with depths around the sharpest before a single plane, and that depth [m].

    The window is four times as deep as the depth of focus 2 lambda z^2 / D^2.
    """
    pose, waveform = capture.poses[0], capture.waveform
    wavelength = waveform.center_wavelength_m
    sides = np.ptp(pose.phase_centers @ pose.axes[1:].T, axis=0)
    try:
        with listener.step("searching the depth"):
            depths, sharpness = search_depth(pose, waveform, waveform.unambiguous_range_m)
    except UserError:
        if waveform.n_samples > 1:  # the strongest echo gives the depth
            return options, None
        return replace(options, depth_m=(0.25 * max(sides), 2.0 * max(sides))), None
    best = int(sharpness.argmax())
    if best in (0, len(depths) - 1):
        listener.warning(
            f"before the plane the image is sharpest where the search ends, at {depths[best]:.3g} "
            "m: name a range by --depth-m"
        )
    half = 2.0 * depth_of_focus_m(depths[best], max(sides), wavelength)
    near, far = max(depths[best] - half, wavelength), depths[best] + half
    fine = 0.25 * wavelength * max(1.0, depths[best] / max(sides))
    coarse = (float(np.prod(sides)) * 2.0 * half / _MAX_SEARCHED_VOXELS) ** (1 / 3)
    spacing = options.spacing_m
    if spacing is None:
        spacing = max(min(DEFAULT_IMAGE_SPACING_M, fine), coarse)
    options = replace(options, depth_m=(near, far), spacing_m=spacing)
    return options, float(depths[best])


def _grid(options: ImageOptions, summary: CaptureSummary) -> Grid:
    """Voxels of the volume that is named, else of the outer wall."""
    wall = summary.walls[0] if summary.walls else None
    size = options.size_m or (wall.size_m if wall else (DEFAULT_IMAGE_SIDE_M,) * 3)
    center = options.center_m or (wall.center_m if wall else summary.focus)
    if center is None:
        raise UserError(what="one frequency gives no range", hint="give --depth-m, or --center-m")
    return _cover(size, center, options.spacing_m)


def _depth_grid(options: ImageOptions, pose: Pose, n_poses: int) -> Grid:
    """Voxels before one pose, which the box of --depth-m and --extent-m bounds."""
    near, far = options.depth_m or (0.0, 0.0)
    if not near < far:
        raise UserError(what="--depth-m must be two rising distances", got=options.depth_m)
    if options.size_m is not None:
        raise UserError(what="--depth-m and --size-m exclude each other")
    if n_poses != 1:
        raise UserError(what="--depth-m needs one plane", got=n_poses, hint="add --plane N")
    along = pose.phase_centers @ pose.axes.T
    extent = options.extent_m or tuple(np.ptp(along[:, 1:], axis=0))
    if not min(extent) > 0:
        raise UserError(what="--extent-m must be two positive lengths", got=extent)
    center = 0.5 * (along.min(axis=0) + along.max(axis=0))
    if options.center_m is not None:
        center[1:] = (pose.axes @ np.asarray(options.center_m))[1:]
    center[0] = float(np.median(along[:, 0])) + 0.5 * (near + far)
    corners = box_corners(center, [far - near, *extent]) @ pose.axes
    size, middle = np.ptp(corners, axis=0), 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    # A side along which nothing extends still needs a voxel.
    return _cover(np.maximum(size, 1e-9), middle, options.spacing_m)


def _cover(size: ArrayLike, center: ArrayLike, spacing_m: float | None) -> Grid:
    """Voxels of a box of these sides around its middle, which they cover [m]."""
    spacing_m = DEFAULT_IMAGE_SPACING_M if spacing_m is None else spacing_m
    shape = np.ceil(np.asarray(size) / spacing_m - 1e-9) + 1
    if float(np.prod(shape)) > _MAX_VOXELS:
        raise UserError(
            what=f"the volume would have {float(np.prod(shape)):.2g} voxels",
            expected=f"at most {_MAX_VOXELS:.2g}",
            hint="raise --spacing-m or lower --size-m",
        )
    return Grid.centered(center, spacing_m, shape)


def _axis_along(pose: Pose) -> int | None:
    """Axis of the frame along which a pose faces; None where it faces none of them."""
    axis = int(np.abs(pose.axes[0]).argmax())
    return axis if abs(pose.axes[0, axis]) >= _ALONG_AXIS else None


def _depths(grid: Grid, axis: int, pose: Pose) -> Floats:
    """Distance of each slice across an axis from the antennas [m]."""
    positions = grid.origin_m[axis] + grid.spacing_m * np.arange(grid.shape[axis])
    antennas = float(np.median(pose.phase_centers[:, axis]))
    return np.asarray((positions - antennas) * np.sign(pose.axes[0, axis]))


def _filter_angles(
    angles_deg: tuple[float, float] | None, capture: Capture, poses: Sequence[int]
) -> Capture:
    """Capture without waves from other angles, of some poses; filtered when they are read."""
    if angles_deg is None:
        return capture
    low, high = angles_deg
    if not low < high:
        raise UserError(what="--angles-deg must be two rising angles", got=angles_deg)
    chosen, waveform = frozenset(poses), capture.waveform

    def filter_pose(index: int, pose: Pose) -> Pose:
        return keep_angles(pose, waveform, low, high) if index in chosen else pose

    poses_kept = capture.poses
    if not isinstance(poses_kept, LazyPoses):
        return replace(capture, poses=tuple(filter_pose(i, p) for i, p in enumerate(poses_kept)))
    return replace(capture, poses=poses_kept.map(filter_pose))


def _write(result: ImageResult, plan: _ImagePlan) -> None:
    grid = result.grid
    arrays = {
        "volume": result.volume,
        "origin_m": np.asarray(grid.origin_m),
        "spacing_m": np.asarray(grid.spacing_m),
        "poses": np.asarray(plan.poses, dtype=np.int64),
    }
    write_npz_atomic(result.path / IMAGE_NAME, arrays)
    write_json_atomic(result.path / SIDECAR_NAME, plan.describe(result.sharpness))


def _draw_image(
    plan: _ImagePlan, folder: Path, volume: NDArray[np.float32], sharpness: Floats
) -> None:
    """Draw the volume's largest values along x, y and z, and its sharpest slice, if any."""
    from geraf2.report.depth import sharpest_slice  # noqa: PLC0415 - takes 0.5 s
    from geraf2.report.figures import draw_projections  # noqa: PLC0415 - as above

    (folder / PICTURE_NAME).parent.mkdir(parents=True, exist_ok=True)
    draw_projections([volume.max(axis=axis) for axis in range(3)], plan.grid, folder / PICTURE_NAME)
    if plan.axis is not None:
        values = np.take(volume, int(sharpness.argmax()), axis=plan.axis)
        focus = (plan.depths_m, sharpness)
        sharpest_slice(values, plan.grid, plan.axis, *focus, folder / DEPTH_PICTURE_NAME)
