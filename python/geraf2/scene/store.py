"""Captures from and to scene folders."""

import hashlib
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

from geraf2.io.container import PoseArrays, PoseDigest, SceneReader, SceneWriter
from geraf2.io.manifest import SceneManifest, WallManifest, WaveformManifest
from geraf2.io.samples import complex_samples
from geraf2.scene.capture import Capture, Pose, Wall
from geraf2.scene.waveform import Waveform


def load_capture(path: Path | str) -> Capture:
    """Read a scene folder into memory.

    Parameters
    ----------
    path
        Folder with scene.toml and radar.zarr, see geraf2.io.container.
    """
    reader = SceneReader(Path(path))
    poses = tuple(pose_from_arrays(reader.read_pose(index)) for index in range(reader.n_poses))
    return replace(capture_without_poses(reader.manifest), poses=poses)


def save_capture(
    capture: Capture,
    path: Path | str,
    *,
    overwrite: bool = False,
    extras: Callable[[Path], None] | None = None,
) -> bool:
    """Write a capture as a scene folder, whole or not at all.

    Parameters
    ----------
    capture
        What to write.
    path
        Folder to make. If it already holds this very capture, nothing changes.
    overwrite
        Replace a scene with other content; without it that is a UserError.
    extras
        Writes further files (truth.ply, los.ply) into the folder it is given, before the scene
        appears.

    Returns
    -------
    bool
        Whether anything was written.
    """
    writer = SceneWriter(
        Path(path),
        manifest_of(capture),
        n_poses=len(capture.poses),
        n_antennas_max=max((pose.n_antennas for pose in capture.poses), default=0),
        overwrite=overwrite,
    )
    with writer:
        for pose in capture.poses:
            writer.append(pose_to_arrays(pose))
        if extras is not None:
            extras(writer.folder)
    return not writer.unchanged


def capture_digest(capture: Capture) -> str:
    """Hash of everything that a reconstruction depends on; how it came about is left out."""
    digest = PoseDigest()
    for pose in capture.poses:
        digest.add(pose_to_arrays(pose))
    about = manifest_of(replace(capture, calibration=(), provenance={})).model_dump_json()
    return hashlib.blake2b((about + digest.hexdigest()).encode(), digest_size=16).hexdigest()


def manifest_of(capture: Capture) -> SceneManifest:
    """Everything of a capture but its poses, for scene.toml."""
    return SceneManifest(
        frame=capture.frame,
        waveform=WaveformManifest(**asdict(capture.waveform)),
        walls=[
            WallManifest(
                size_m=[float(side) for side in wall.size_m],
                thickness_m=float(wall.thickness_m),
                permittivity=float(wall.permittivity),
                center_m=[float(value) for value in wall.center_m],
            )
            for wall in capture.walls
        ],
        calibration=list(capture.calibration),
        provenance=dict(capture.provenance),
    )


def capture_without_poses(manifest: SceneManifest) -> Capture:
    """Capture with waveform, walls and provenance of a manifest, and no pose yet."""
    return Capture(
        waveform=Waveform(**manifest.waveform.model_dump()),
        poses=(),
        frame=manifest.frame,
        walls=tuple(
            Wall(
                size_m=(wall.size_m[0], wall.size_m[1], wall.size_m[2]),
                thickness_m=wall.thickness_m,
                permittivity=wall.permittivity,
                center_m=(wall.center_m[0], wall.center_m[1], wall.center_m[2]),
            )
            for wall in manifest.walls
        ),
        calibration=tuple(manifest.calibration),
        provenance=dict(manifest.provenance),
    )


def pose_from_arrays(pose: PoseArrays) -> Pose:
    """Pose as the scene layer names it; shares the arrays, but for samples that were integers."""
    return Pose(**{**vars(pose), "signal": complex_samples(pose.signal)})


def pose_to_arrays(pose: Pose) -> PoseArrays:
    """Pose as the container stores it; shares the arrays."""
    return PoseArrays(**vars(pose))
