"""The scene folder: scene.toml beside radar.zarr (zarr v3), written whole or not at all.

    scene/
        scene.toml    frame, unit, waveform, walls, provenance (geraf2.io.manifest)
        radar.zarr    signal        complex64 (pose, antenna, sample), or
                                    int16     (pose, antenna, sample, I and Q)
                      tx_positions  float64   (pose, antenna, xyz) [m]
                      rx_positions  float64   (pose, antenna, xyz) [m]
                      axes          float64   (pose, axis, xyz), rows looking, horizontal, vertical
                      antenna_count int64     (pose,), antennas beyond it are padding
                      angle         float64   (pose,) [deg], NaN where unknown
        truth.ply, los.ply  optional meshes [m]
        photos/       optional photos of the box, transforms.json in metres

A chunk never holds antennas of two poses, so that a pose is read without the others; up to
16 MiB a pose is one chunk. Padding, and a chunk that is lost, read as NaN (of integers -32768
marks it, see geraf2.io.samples). The group's attributes hold checksums of each pose, which are
compared whenever it is read. Chunks are neither compressed nor filtered, so that a chunk is a
file of plain numbers and grows as parts come. Samples that a converter gave as integers may stay
so: half the bytes, which is most of the time of an import. They are read as complex64.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._memory import require_memory
from geraf2.errors import UserError
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.manifest import SCENE_VERSION, SceneManifest
from geraf2.io.objects import exists, is_file, is_remote, zarr_store
from geraf2.io.outputs import require_consent, require_folder
from geraf2.io.pose_digest import ANTENNA_ARRAYS
from geraf2.io.regular import RECORD_BYTES, require_no_links, require_regular
from geraf2.io.samples import NO_SAMPLE, complex_samples, crc_of
from geraf2.io.toml import from_table, read_table
from geraf2.io.zarr_files import METADATA_NAME
from geraf2.records import Pose, RawPose

MANIFEST_NAME = "scene.toml"
RADAR_NAME = "radar.zarr"
TRUTH_NAME = "truth.ply"
LOS_NAME = "los.ply"
LOS_RECORD_NAME = "los.json"

COMPLEX_NAN = complex(float("nan"), float("nan"))

# Types that the arrays of a scene may have; others would be converted in silence.
ARRAY_TYPES = {
    "signal": ("complex64", "int16"),
    "tx_positions": ("float64",),
    "rx_positions": ("float64",),
    "axes": ("float64",),
    "antenna_count": ("int64",),
    "angle": ("float64",),
}
MAX_PLANES = 10_000
"""Each takes some milliseconds to check; scans have up to hundreds."""
CHECKSUMS = "checksums"
"""Attribute of the group: CRC-32 of each pose, antennas without padding, by array, in hex."""


def join_parts(parts: Sequence[RawPose]) -> RawPose:
    """Antennas of all parts as one pose; its axes, name and angle are those of the first."""
    if len(parts) == 1:
        return parts[0]
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in ANTENNA_ARRAYS
    }
    return replace(parts[0], **arrays)


def is_scene(path: Path) -> bool:
    """Whether `path` has the manifest of a scene folder."""
    return is_file(path / MANIFEST_NAME)


def read_scene_manifest(path: Path) -> SceneManifest:
    """Read and check scene.toml of a scene folder."""
    path = Path(path)
    if not exists(path):
        raise UserError(what="no such scene", where=path, hint="make one with 'geraf2 import'")
    if not is_scene(path):
        raise UserError(
            what=f"is not a scene: it has no {MANIFEST_NAME}",
            where=path,
            hint="make one with 'geraf2 import' or 'geraf2 simulate'",
        )
    if not is_remote(path):  # links lead out of the scene, metadata may be without end
        for file in require_no_links(path):
            if file.name == METADATA_NAME:
                require_regular(file, RECORD_BYTES)
    table = read_table(path / MANIFEST_NAME)
    version = table.get("version")
    if isinstance(version, int) and version > SCENE_VERSION:
        raise UserError(
            what=f"scene of version {version} was written by a newer geraf2",
            where=path,
            expected=f"version {SCENE_VERSION}",
        )
    return from_table(table, SceneManifest, path / MANIFEST_NAME)


def verify_scene(path: Path) -> int:
    """Compare each pose with its checksums; return how many there are, 0 without. UserError."""
    reader = SceneReader(path)
    if not reader.has_checksums:
        return 0
    for index in range(reader.n_poses):
        reader.read_pose(index)
    return reader.n_poses


def require_scene_folder(
    path: Path, *, overwrite: bool, may_be_same: Callable[["SceneReader"], bool]
) -> None:
    """Refuse a path for a scene before the work whose result would be refused there.

    may_be_same: whether the scene that lies there may be the one to come.
    """
    require_folder(path, "scene", own=is_scene(path))
    if overwrite or not is_scene(path):
        return
    try:
        same = may_be_same(SceneReader(path))
    except UserError:  # broken
        same = False
    if not same:
        require_consent(path, "another scene", overwrite=False)


class SceneReader:
    """Lazy view of a scene folder; poses are read one at a time."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.manifest = read_scene_manifest(self.path)
        self._group = self._open_group()
        self._arrays = {name: self._open_array(name) for name in ARRAY_TYPES}
        self.n_antennas = np.asarray(self._read("antenna_count", slice(None)), dtype=np.int64)
        self.angles_deg = np.asarray(self._read("angle", slice(None)), dtype=np.float64)
        self._names = self._pose_names()
        self._check_shapes()
        self._checksums = self._read_checksums()

    @property
    def n_poses(self) -> int:
        """Number of scan planes."""
        return int(self.n_antennas.shape[0])

    @property
    def has_checksums(self) -> bool:
        """Whether the scene has checksums of its poses."""
        return bool(self._checksums)

    def holds_same_poses(self, other: "SceneReader") -> bool:
        """Whether names and checksums of the poses are the same; False without checksums."""
        mine, others = (self._names, self._checksums), (other._names, other._checksums)
        return self.has_checksums and mine == others

    def read_pose(self, index: int) -> Pose:
        """Read one pose and compare it with its checksums; values are not judged here."""
        if not 0 <= index < self.n_poses:
            msg = f"index of the plane must be in 0..{self.n_poses - 1}, got {index}"
            raise IndexError(msg)
        keep = int(self.n_antennas[index])
        angle = float(self.angles_deg[index])
        stored = {
            name: np.asarray(self._read(name, (index, slice(keep)))) for name in ANTENNA_ARRAYS
        }
        stored["axes"] = np.asarray(self._read("axes", index))
        counted = {"antenna_count": self.n_antennas[index], "angle": self.angles_deg[index]}
        for name, value in {**counted, **stored}.items():
            sums = self._checksums.get(name)
            if sums is not None and sums[index] != f"{crc_of(value):08x}":
                raise UserError(
                    what=f"{name} of plane {self._names[index] or index} is not what was written",
                    where=self.path / RADAR_NAME / name,
                    hint="the file was damaged or changed: copy or import the scene again",
                )
        samples = stored.pop("signal")
        signal = complex_samples(samples)
        if samples.dtype.kind != "c":
            signal[(samples == NO_SAMPLE).any(axis=-1)] = COMPLEX_NAN
        return Pose(
            signal=signal,
            **stored,
            name=self._names[index],
            angle_deg=None if np.isnan(angle) else angle,
        )

    def _open_group(self) -> Any:
        import zarr  # noqa: PLC0415 - keeps `import geraf2` and `geraf2 --help` fast

        store = self.path / RADAR_NAME
        if not exists(store):
            raise UserError(what=f"the scene has no {RADAR_NAME}", where=self.path)
        refuse_other_kind(store / METADATA_NAME)
        with _reading(store):
            where, group = zarr_store(store)
            return zarr.open_group(where, path=group, mode="r", zarr_format=3)

    def _open_array(self, name: str) -> Any:
        where = self.path / RADAR_NAME / name
        refuse_other_kind(where / METADATA_NAME)
        with _reading(where):
            array = self._group.get(name)
            if array is None:
                raise UserError(what="array is missing", where=where)
            dtype, chunk_bytes = array.dtype.name, array.dtype.itemsize * np.prod(array.chunks)
            codecs = [type(codec).__name__ for codec in array.metadata.codecs]
        if dtype not in ARRAY_TYPES[name]:
            expected = " or ".join(ARRAY_TYPES[name])
            raise UserError(what="has the wrong type", where=where, expected=expected, got=dtype)
        if not is_remote(where):  # zarr reads chunks whole
            for file in require_no_links(where):
                with suppress(FileNotFoundError):  # renamed meanwhile, by the writer of the scene
                    require_regular(file, max(RECORD_BYTES, int(chunk_bytes)))
        if codecs != ["BytesCodec"]:
            # Others unpack to any size, and no scene has them.
            what, expected = "is compressed or filtered", "plain numbers (codec bytes)"
            raise UserError(what, where=where, expected=expected, got=", ".join(codecs))
        n_bytes = float(chunk_bytes)
        if name not in ANTENNA_ARRAYS:  # read whole
            n_bytes = max(n_bytes, array.dtype.itemsize * np.prod(array.shape, dtype=float))
        require_memory(2.0 * n_bytes, "it is too large", where=where)
        return array

    def _pose_names(self) -> list[str]:
        names = self._group.attrs.get("pose_names", [])
        if not isinstance(names, list):
            where = self.path / RADAR_NAME
            raise UserError(what="pose_names is no list", where=where, got=repr(names)[:40])
        return [str(name) for name in names]

    def _read_checksums(self) -> dict[str, list[Any]]:
        """Checksums of each pose by array; empty in a scene of an earlier version."""
        sums = self._group.attrs.get(CHECKSUMS, {})
        good = isinstance(sums, dict) and all(
            name in ARRAY_TYPES and isinstance(one, list) and len(one) == self.n_poses
            for name, one in sums.items()
        )
        if not good:
            raise UserError(
                what="the checksums do not go with the arrays", where=self.path / RADAR_NAME
            )
        return dict(sums)

    def _read(self, name: str, selection: Any) -> Any:
        with _reading(self.path / RADAR_NAME / name):
            return self._arrays[name][selection]

    def _check_shapes(self) -> None:
        where = self.path / RADAR_NAME
        n_poses, n_samples = self.n_poses, self.manifest.waveform.n_samples
        if n_poses > MAX_PLANES:
            expected = f"at most {MAX_PLANES} planes"
            raise UserError(what="too many planes", where=where, expected=expected, got=n_poses)
        shape = self._arrays["signal"].shape
        of_integers = self._arrays["signal"].dtype.kind == "i"
        if shape[3:] != ((2,) if of_integers else ()) or len(shape) < 3:
            raise UserError(
                what="signal has the wrong shape",
                where=where,
                expected="(pose, antenna, sample), of integers (pose, antenna, sample, 2)",
                got=shape,
            )
        if shape[2] != n_samples:
            raise UserError(
                what=f"signal has {shape[2]} samples but {MANIFEST_NAME} states "
                f"waveform.n_samples = {n_samples}",
                where=where,
            )
        n_max = shape[1]
        wanted = {
            "signal": (n_poses, n_max, *shape[2:]),
            "tx_positions": (n_poses, n_max, 3),
            "rx_positions": (n_poses, n_max, 3),
            "axes": (n_poses, 3, 3),
            "angle": (n_poses,),
        }
        for name, want in wanted.items():
            if self._arrays[name].shape != want:
                raise UserError(
                    what="array has the wrong shape",
                    where=where / name,
                    expected=want,
                    got=self._arrays[name].shape,
                )
        if len(self._names) != n_poses:
            raise UserError(
                what="pose_names has the wrong length",
                where=where,
                expected=n_poses,
                got=len(self._names),
            )
        if np.any((self.n_antennas < 0) | (self.n_antennas > n_max)):
            raise UserError(what="antenna_count lies outside the arrays", where=where)


@contextmanager
def _reading(where: Path) -> Iterator[None]:
    """UserError for what zarr and its codecs raise where metadata or bytes are wrong: anything."""
    try:
        yield
    except (MemoryError, UserError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(what=f"cannot be read: {reason}", where=where) from None
