"""One parcel of a recording as an ordinary scan: planes in the frame of the parcel."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from geraf2.apps.belt.cutting import Span, frame_travel
from geraf2.apps.belt.monostatic import move_to_midpoints, move_to_raster, stretch_matrices
from geraf2.apps.belt.motion import Motion, common_lines, correct_plane, find_motion
from geraf2.apps.belt.vibration import remove_vibration
from geraf2.io.belt_file import MOTION_KEY, BeltRecord, read_belt
from geraf2.io.container import SceneReader, is_scene, join_parts
from geraf2.io.samples import complex_pose
from geraf2.io.text import parse_json
from geraf2.ops._threads import limit_blas_threads
from geraf2.records import Pose
from geraf2.scene import Capture, LosPrior
from geraf2.scene.store import capture_without_poses, save_capture

# Side of the region of a parcel over the distance of the nearest array.
_REGION = 1.4
# Travel of one plane [m].
_PLANE_M = 0.25


@limit_blas_threads
def parcel_scan(
    recorded: Capture, record: BeltRecord, *, num_threads: int | None = None
) -> tuple[Capture, Motion]:
    """Planes of a parcel with estimated motion, antennas at midpoints and on rasters.

    recorded: planes of one parcel in the frame of the belt, the parcel's middle at the origin.
    record: the belt's arrays. num_threads: all when None.

    The second of two arrays on one line gives the motion; its planes are left out.
    """
    waveform = recorded.waveform
    parts: dict[str, list[Pose]] = {array.name: [] for array in record.arrays}
    for pose in recorded.poses:
        parts[record.of_plane(pose.name).name].append(pose)
    present = replace(record, arrays=tuple(a for a in record.arrays if parts[a.name]))
    whole = {}
    for array in present.arrays:
        pose = remove_offset(complex_pose(join_parts(parts[array.name])), array.n_channels)
        pose = move_to_midpoints(pose, stretch_matrices(array, waveform))
        whole[array.name] = move_to_raster(pose, array.n_channels, waveform)
    distances = [np.abs(a.phase_centers_m[:, 1:]).max(axis=1).min() for a in record.arrays]
    region = LosPrior.from_box((_REGION * float(min(distances)),) * 3)
    n_channels = [array.n_channels for array in present.arrays]
    whole = remove_vibration(whole, n_channels, waveform, region, num_threads)
    lines = common_lines(present, whole)
    motion = find_motion(waveform, lines, region, num_threads)
    second = {line.arrays[1].name for line in lines}
    poses: list[Pose] = []
    for array in present.arrays:
        if array.name in second:
            continue
        moved = correct_plane(whole[array.name], array, motion)
        n_planes = max(1, round(float(np.ptp(moved.phase_centers[:, 0])) / _PLANE_M))
        frames = np.arange(moved.n_antennas).reshape(-1, array.n_channels)
        for number, own in enumerate(np.array_split(frames, n_planes)):
            plane = replace(moved.select(own.ravel()), name=f"{array.name}/{number}")
            poses.append(move_to_raster(turn_along_path(plane), array.n_channels, waveform))
    about = {**recorded.provenance, MOTION_KEY: json.dumps(asdict(motion))}
    return replace(recorded, poses=tuple(poses), provenance=about), motion


def remove_offset(pose: Pose, n_channels: int) -> Pose:
    """Plane of whole frames without the constant that a converter adds to each channel.

    Over all frames an echo has hardly any mean: its phase turns as the parcel passes.
    """
    frames = pose.signal.reshape(-1, n_channels, pose.signal.shape[1])
    rest = frames - frames.mean(axis=(0, 2))[:, None]
    return replace(pose, signal=rest.reshape(pose.signal.shape))


def turn_along_path(pose: Pose) -> Pose:
    """Plane whose axes are turned about the vertical, into the direction of its path."""
    x, y = (pose.phase_centers - pose.phase_centers.mean(axis=0))[:, :2].T
    slope = float(x @ y) / max(float(x @ x), 1e-300)
    cos, sin = np.array([1.0, slope]) / np.hypot(1.0, slope)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(pose, axes=pose.axes @ turn.T)


def cut_parcel(stream: Path, folder: Path, span: Span, *, num_threads: int | None = None) -> Motion:
    """Write one parcel of a stream as a scene, unless it is there; its motion.

    span: which frames belong to it.
    """
    if is_scene(folder):  # by a process that was stopped
        return Motion(**parse_json(SceneReader(folder).manifest.provenance[MOTION_KEY]))
    record, reader = read_belt(stream), SceneReader(stream)
    last: dict[str, float] = {}
    poses = []
    for number in span.planes:
        pose = reader.read_pose(number)
        array = record.of_plane(pose.name)
        x, kept = frame_travel(pose, array, record, last.get(array.name))
        own = kept & (x >= span.low_m) & (x <= span.high_m)
        if kept.any():
            last[array.name] = float(x[kept][-1])
        index = np.arange(pose.n_antennas).reshape(-1, array.n_channels)[own].ravel()
        if len(index):
            poses.append(pose.select(index).moved(np.array([-span.middle_m, 0.0, 0.0])))
    recorded = replace(capture_without_poses(reader.manifest), poses=tuple(poses))
    scan, motion = parcel_scan(recorded, record, num_threads=num_threads)
    save_capture(scan, folder)
    return motion
