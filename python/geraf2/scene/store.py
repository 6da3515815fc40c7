"""Captures from and to scene folders."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from geraf2._memory import require_memory
from geraf2.io.container import SceneReader
from geraf2.io.digests import bytes_digest
from geraf2.io.manifest import SceneManifest
from geraf2.io.pose_digest import PoseDigest
from geraf2.io.scene_writer import SceneWriter
from geraf2.io.toml import from_table, to_table
from geraf2.scene.capture import Capture, LazyPoses

# Samples as they are stored and as complex numbers.
_BYTES_PER_SAMPLE = 12.0


def load_capture(path: Path | str) -> Capture:
    """Read a scene folder into memory.

    path: folder with scene.toml and radar.zarr, see geraf2.io.container.

    Returns the capture: samples complex64, lengths in metres. Raises UserError where the folder is
    no scene or something of it is missing or broken.

    >>> geraf2.save_capture(geraf2.examples.small_capture()[0], "scene", overwrite=True)
    True
    >>> geraf2.load_capture("scene").poses[0].signal.shape
    (441, 32)
    """
    capture = open_capture(path)
    n_samples = float(capture.n_antennas) * capture.waveform.n_samples
    require_memory(_BYTES_PER_SAMPLE * n_samples, "keep fewer planes in a scene", where=path)
    return capture.load()


def open_capture(path: Path | str) -> Capture:
    """Open a scene folder; each pose is read when it is asked for, every time.

    path: folder as that of :func:`load_capture`.

    Returns the capture, lengths in metres: who goes through its poses holds one at a time. Raises
    UserError as :func:`load_capture`, for a broken pose where that is read.

    >>> geraf2.save_capture(geraf2.examples.small_capture()[0], "large")
    True
    >>> capture = geraf2.open_capture("large")  # reads no samples
    >>> sum(float(abs(pose.signal[0, 0])) > 0 for pose in capture.poses)
    6
    """
    reader = SceneReader(Path(path))
    largest = float(reader.n_antennas.max(initial=0)) * reader.manifest.waveform.n_samples
    require_memory(_BYTES_PER_SAMPLE * largest, "cut the planes", where=path)
    poses = LazyPoses(reader.n_antennas.tolist(), reader.read_pose)
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
        What to write, lengths in metres.
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

    Raises
    ------
    UserError
        If the folder holds something else and `overwrite` is not set, or if the capture is not
        plausible.

    Examples
    --------
    >>> capture, truth = geraf2.examples.small_capture()
    >>> written = geraf2.save_capture(capture, "kept")
    >>> geraf2.save_capture(capture, "kept")  # the same is there
    False
    """
    writer = SceneWriter(
        Path(path),
        manifest_of(capture),
        n_poses=len(capture.poses),
        n_antennas_max=max(capture.pose_sizes, default=0),
        overwrite=overwrite,
    )
    with writer:
        for pose in capture.poses:
            writer.append(pose)
        if extras is not None:
            extras(writer.folder)
    return not writer.unchanged


def capture_digest(capture: Capture, poses: PoseDigest | None = None) -> str:
    """Hash of everything that a reconstruction depends on; its history is left out.

    poses: digest of the poses; that of the capture's when None.
    """
    digest = poses or PoseDigest()
    for pose in capture.poses if poses is None else ():
        digest.add(pose)
    about = manifest_of(replace(capture, calibration=(), provenance={})).model_dump_json()
    return bytes_digest((about + digest.hexdigest()).encode())


def manifest_of(capture: Capture) -> SceneManifest:
    """Everything of a capture but its poses, for scene.toml; UserError for an absurd value."""
    about = {key: value for key, value in vars(capture).items() if key != "poses"}
    return from_table(to_table(about), SceneManifest, "the capture")


def capture_without_poses(manifest: SceneManifest) -> Capture:
    """Capture with waveform, walls and provenance of a manifest, and no pose yet."""
    return Capture(
        waveform=manifest.waveform,
        poses=(),
        frame=manifest.frame,
        walls=manifest.walls,
        calibration=manifest.calibration,
        provenance=dict(manifest.provenance),
    )
