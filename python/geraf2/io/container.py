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
says so, see geraf2.io.samples). The group's attributes hold checksums of each pose, which are
compared whenever it is read. Chunks are neither compressed nor filtered, so that a chunk is a
file of plain numbers and grows as parts come. Samples that a converter gave as integers may stay
so: half the bytes, which is most of the time of an import. They are read as complex64.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from geraf2._memory import require_memory
from geraf2._validation import require_shape
from geraf2.errors import UserError
from geraf2.io.atomic import atomic_folder
from geraf2.io.manifest import SCENE_VERSION, SceneManifest
from geraf2.io.objects import exists, is_file, zarr_store
from geraf2.io.outputs import require_consent, require_folder
from geraf2.io.pose_digest import ANTENNA_ARRAYS
from geraf2.io.samples import NO_SAMPLE, complex_samples, crc_of, stored_integers
from geraf2.io.toml import from_table, read_table, write_toml
from geraf2.io.zarr_files import ZarrArray, write_group
from geraf2.records import Pose, RawPose, Samples

MANIFEST_NAME = "scene.toml"
RADAR_NAME = "radar.zarr"
TRUTH_NAME = "truth.ply"
LOS_NAME = "los.ply"
LOS_RECORD_NAME = "los.json"
PHOTOS_NAME = "photos"

_FLOAT_NAN = float("nan")
_COMPLEX_NAN = complex(_FLOAT_NAN, _FLOAT_NAN)

# Types that the arrays of a scene may have; others would be converted in silence.
_DTYPES = {
    "signal": ("complex64", "int16"),
    "tx_positions": ("float64",),
    "rx_positions": ("float64",),
    "axes": ("float64",),
    "antenna_count": ("int64",),
    "angle": ("float64",),
}
_CHECKSUMS = "checksums"
"""Attribute of the group: CRC-32 of each pose, antennas without padding, by array, in hex."""

# Bytes of signal in a chunk: what a part of a pose costs to read.
_CHUNK_BYTES = 1 << 24


def joined(parts: Sequence[RawPose]) -> RawPose:
    """Antennas of all parts as one pose; its axes, name and angle are those of the first."""
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in ANTENNA_ARRAYS
    }
    return replace(parts[0], **arrays)


def is_scene(path: Path) -> bool:
    """Whether `path` looks like a scene folder."""
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
    """Compare each pose with its checksums; how many there are.

    0 for a scene that was written without. UserError for the first one that is missing or another.
    """
    reader = SceneReader(path)
    if not reader.has_checksums:
        return 0
    for index in range(reader.n_poses):
        reader.read_pose(index)
    return reader.n_poses


def require_scene_folder(
    path: Path, *, overwrite: bool, may_be_same: Callable[["SceneReader"], bool]
) -> None:
    """Refuse a place for a scene before the work whose result would be refused there.

    may_be_same: whether the scene that lies there may be the one to come, which would change
    nothing; called only where nothing else decides.
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
        self._arrays = {name: self._open_array(name) for name in _DTYPES}
        self.n_antennas = np.asarray(self._read("antenna_count", slice(None)), dtype=np.int64)
        self._angles = np.asarray(self._read("angle", slice(None)), dtype=np.float64)
        self._names = self._pose_names()
        self._check_shapes()
        self._checksums = self._read_checksums()

    @property
    def n_poses(self) -> int:
        """Number of scan planes."""
        return int(self.n_antennas.shape[0])

    @property
    def has_checksums(self) -> bool:
        """Whether the scene says what its poses were when it was written."""
        return bool(self._checksums)

    def holds_same_poses(self, other: "SceneReader") -> bool:
        """Whether the poses are the same bit by bit; a chunk's worth of antennas is held."""
        if (
            self._names != other._names
            or self._shape("signal")[2] != other._shape("signal")[2]
            or not np.array_equal(self.n_antennas, other.n_antennas)
            or not np.array_equal(self._angles, other._angles, equal_nan=True)
        ):
            return False
        step = other._arrays["signal"].chunks[1]
        for index, n_antennas in enumerate(self.n_antennas):
            parts = [
                (index, slice(k, min(k + step, n_antennas))) for k in range(0, n_antennas, step)
            ]
            asked = [("axes", index), *((name, part) for part in parts for name in ANTENNA_ARRAYS)]
            for name, selection in asked:
                mine, others = (
                    np.ascontiguousarray(reader._read(name, selection)) for reader in (self, other)
                )
                if mine.dtype != others.dtype or mine.tobytes() != others.tobytes():
                    return False
        return True

    def read_pose(self, index: int) -> Pose:
        """Read one pose and compare it with its checksums.

        Values are not judged here (see geraf2.scene.check_capture).
        """
        if not 0 <= index < self.n_poses:
            msg = f"pose index must be in 0..{self.n_poses - 1}, got {index}"
            raise IndexError(msg)
        keep = int(self.n_antennas[index])
        angle = float(self._angles[index])
        stored = {
            name: np.asarray(self._read(name, (index, slice(keep)))) for name in ANTENNA_ARRAYS
        }
        stored["axes"] = np.asarray(self._read("axes", index))
        counted = {"antenna_count": self.n_antennas[index], "angle": self._angles[index]}
        for name, value in {**counted, **stored}.items():
            sums = self._checksums.get(name)
            if sums is not None and sums[index] != f"{crc_of(value):08x}":
                raise UserError(
                    what=f"{name} of plane {self._names[index] or index} is not what was written",
                    where=self.path / RADAR_NAME / name,
                    hint="the file was damaged or changed: copy or import the scene again",
                )
        return Pose(
            signal=_read_as_complex(stored.pop("signal")),
            **stored,
            name=self._names[index],
            angle_deg=None if np.isnan(angle) else angle,
        )

    def _open_group(self) -> Any:
        import zarr  # noqa: PLC0415 - keeps `import geraf2` and `geraf2 --help` fast

        store = self.path / RADAR_NAME
        if not exists(store):
            raise UserError(what=f"the scene has no {RADAR_NAME}", where=self.path)
        try:
            where, group = zarr_store(store)
            return zarr.open_group(where, path=group, mode="r")
        except MemoryError:
            raise
        except Exception as error:  # zarr raises anything where metadata are wrong
            raise UserError(what=f"cannot be read: {_one_line(error)}", where=store) from None

    def _open_array(self, name: str) -> Any:
        where = self.path / RADAR_NAME / name
        try:
            array = self._group[name]
            dtype, chunk_bytes = array.dtype.name, array.dtype.itemsize * np.prod(array.chunks)
        except KeyError:
            raise UserError(what="array is missing", where=where) from None
        except MemoryError:
            raise
        except Exception as error:  # as above
            raise UserError(what=f"cannot be read: {_one_line(error)}", where=where) from None
        if dtype not in _DTYPES[name]:
            expected = " or ".join(_DTYPES[name])
            raise UserError(what="has the wrong type", where=where, expected=expected, got=dtype)
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
        sums = self._group.attrs.get(_CHECKSUMS, {})
        good = isinstance(sums, dict) and all(
            name in _DTYPES and isinstance(one, list) and len(one) == self.n_poses
            for name, one in sums.items()
        )
        if not good:
            raise UserError(
                what="the checksums do not go with the arrays", where=self.path / RADAR_NAME
            )
        return dict(sums)

    def _read(self, name: str, selection: Any) -> Any:
        where = self.path / RADAR_NAME / name
        try:
            return self._arrays[name][selection]
        except MemoryError:
            raise
        except Exception as error:  # zarr and its codecs raise anything where bytes are wrong
            raise UserError(what=f"cannot be read: {_one_line(error)}", where=where) from None

    def _check_shapes(self) -> None:
        where = self.path / RADAR_NAME
        n_poses, n_samples = self.n_poses, self.manifest.waveform.n_samples
        shape = self._shape("signal")
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
                what=f"signal has {shape[2]} samples but {MANIFEST_NAME} says "
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
            if self._shape(name) != want:
                raise UserError(
                    what="array has the wrong shape",
                    where=where / name,
                    expected=want,
                    got=self._shape(name),
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

    def _shape(self, name: str) -> tuple[int, ...]:
        return tuple(int(n) for n in self._arrays[name].shape)


class SceneWriter(AbstractContextManager["SceneWriter"]):
    """Writes a scene pose by pose; the folder appears when the block ends without error.

    An existing folder is kept: the same content again changes nothing (`unchanged` is then
    true), other content needs `overwrite`, and a folder that is no scene is never replaced.
    With `integers` the samples come as int16, I and Q, and stay so.
    """

    def __init__(
        self,
        path: Path,
        manifest: SceneManifest,
        *,
        n_poses: int,
        n_antennas_max: int,
        overwrite: bool = False,
        integers: bool = False,
    ) -> None:
        self.path = Path(path)
        self.manifest = manifest
        self.unchanged = False
        self._overwrite = overwrite
        self._integers = integers
        self._shape = (n_poses, n_antennas_max, manifest.waveform.n_samples)
        self._names: list[str] = []
        self._n_chunk = _antennas_per_chunk(self._shape, 4 if integers else 8)
        self._begun: RawPose | None = None
        self._n_begun = 0
        self._target: AbstractContextManager[Path] | None = None
        self._folder = self.path
        self._arrays = _arrays_of(self._shape, self._n_chunk, integers=integers)
        self._counts: list[int] = []
        self._begun_sums = dict.fromkeys(ANTENNA_ARRAYS, 0)
        self._checksums: dict[str, list[str]] = {name: [] for name in _DTYPES}
        self._angles: list[float] = []
        require_folder(self.path, "scene", own=is_scene(self.path))

    @property
    def folder(self) -> Path:
        """Where to put optional files (truth.ply, los.ply) before the block ends."""
        return self._folder

    def __enter__(self) -> Self:
        self._target = atomic_folder(self.path)
        self._folder = self._target.__enter__()
        try:
            self._create_arrays()
        except BaseException as error:
            self._target.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def append(self, pose: RawPose, *, n_antennas: int | None = None) -> None:
        """Write the next pose, or a part of it.

        pose: whole, or some of its antennas.
        n_antennas: antennas of the whole pose, where `pose` may be a part; its parts follow each
            other.
        """
        index, keep = len(self._names), pose.signal.shape[0]
        n_antennas = keep if n_antennas is None else n_antennas
        n_so_far = self._n_begun + keep
        if index >= self._shape[0] or n_so_far > n_antennas or n_antennas > self._shape[1]:
            msg = f"pose {index} with {n_so_far} antennas does not fit into {self._shape}"
            raise ValueError(msg)
        samples = stored_integers(pose.signal) if self._integers else pose.signal
        require_shape("signal", samples, (keep, self._shape[2], *((2,) if self._integers else ())))
        if self._begun is None:
            self._begun = pose
        values = {
            "signal": samples,
            "tx_positions": pose.tx_positions,
            "rx_positions": pose.rx_positions,
        }
        for name, array in values.items():
            self._write_antennas(name, index, self._n_begun, array)
            stored = np.asarray(array, dtype=self._arrays[name].dtype)
            self._begun_sums[name] = crc_of(stored, self._begun_sums[name])
            n_padding = -n_antennas % self._n_chunk
            if n_so_far == n_antennas and n_padding:
                fill, dtype = self._arrays[name].fill, self._arrays[name].dtype
                padding = np.full((n_padding, *array.shape[1:]), fill, dtype=dtype)
                self._write_antennas(name, index, n_antennas, padding)
        self._n_begun = n_so_far
        if n_so_far == n_antennas:
            self._end_pose(self._begun, n_antennas)

    def _write_antennas(
        self, name: str, index: int, first: int, array: NDArray[np.generic]
    ) -> None:
        """Append antennas from `first` on to the chunk files that they belong to."""
        done = 0
        while done < len(array):
            number, inside = divmod(first + done, self._n_chunk)
            some = array[done : done + self._n_chunk - inside]
            after = (0,) * (array.ndim - 1)
            self._arrays[name].append(self._folder / RADAR_NAME, (index, number, *after), some)
            done += len(some)

    def _end_pose(self, pose: RawPose, n_antennas: int) -> None:
        group, index = self._folder / RADAR_NAME, len(self._names)
        self._arrays["axes"].append(group, (index, 0, 0), pose.axes)
        angle = np.nan if pose.angle_deg is None else pose.angle_deg
        self._counts.append(n_antennas)
        self._angles.append(angle)
        self._names.append(pose.name)
        self._begun, self._n_begun = None, 0
        sums = {
            **self._begun_sums,
            "axes": crc_of(np.asarray(pose.axes, dtype="<f8")),
            "antenna_count": crc_of(np.asarray(n_antennas, dtype="<i8")),
            "angle": crc_of(np.asarray(angle, dtype="<f8")),
        }
        for name, value in sums.items():
            self._checksums[name].append(f"{value:08x}")
        self._begun_sums = dict.fromkeys(ANTENNA_ARRAYS, 0)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._target is not None  # set by __enter__
        try:
            if error is None:
                self._finish()
        except _Unchanged as unchanged:
            self._target.__exit__(_Unchanged, unchanged, None)
            self.unchanged = True
            return
        except BaseException as late:
            self._target.__exit__(type(late), late, late.__traceback__)
            raise
        self._target.__exit__(kind, error, trace)

    def _finish(self) -> None:
        if len(self._names) != self._shape[0] or self._begun is not None:
            msg = f"{self._shape[0]} poses were announced, got {len(self._names)}"
            raise ValueError(msg)
        self._write_group()
        group = self._folder / RADAR_NAME
        if self._names:
            self._arrays["antenna_count"].append(group, (0,), np.array(self._counts))
            self._arrays["angle"].append(group, (0,), np.array(self._angles))
        write_toml(self._folder / MANIFEST_NAME, self.manifest)
        if is_scene(self.path) and not self._overwrite:
            self._compare_with_existing()

    def _compare_with_existing(self) -> None:
        try:
            old = SceneReader(self.path)
            same = (
                old.manifest.waveform == self.manifest.waveform
                and old.manifest.walls == self.manifest.walls
                and old.manifest.frame == self.manifest.frame
                and old.holds_same_poses(SceneReader(self._folder))
            )
        except UserError:
            same = False
        if same:
            raise _Unchanged
        require_consent(self.path, "another scene", overwrite=False)

    def _create_arrays(self) -> None:
        (self._folder / RADAR_NAME).mkdir()
        self._write_group()
        for array in self._arrays.values():
            array.write_metadata(self._folder / RADAR_NAME)

    def _write_group(self) -> None:
        attributes = {
            "format": "geraf2-radar",
            "version": SCENE_VERSION,
            "pose_names": self._names,
            _CHECKSUMS: self._checksums,
        }
        write_group(self._folder / RADAR_NAME, attributes)


def _arrays_of(
    shape: tuple[int, int, int], n_chunk: int, *, integers: bool
) -> dict[str, ZarrArray]:
    """Arrays of a scene of (n_poses, n_antennas, n_samples), `n_chunk` antennas in a chunk.

    Neither compressed nor filtered: noise does not compress, zstd takes 8 % off a capture at
    20 dB SNR.
    """
    n_poses, n_antennas, n_samples = shape

    def array(
        name: str, dtype: str, dimensions: str, *sides: int, fill: complex, about: str = "1"
    ) -> ZarrArray:
        # A chunk side of 0 is not allowed, an empty pose is.
        chunks = (1, *(max(1, n) for n in sides)) if sides else (max(1, n_poses),)
        if name in ANTENNA_ARRAYS:
            chunks = (1, n_chunk, *chunks[2:])
        unit, _, long_name = about.partition(": ")
        return ZarrArray(
            name=name,
            dtype=dtype,
            fill=fill,
            dimensions=tuple(dimensions.split()),
            shape=(n_poses, *sides),
            chunks=chunks,
            attributes={"unit": unit, **({"long_name": long_name} if long_name else {})},
        )

    about, dimensions, nan = "1: raw ADC samples", "pose antenna sample", _FLOAT_NAN
    fill: complex
    parts: tuple[int, ...] = ()
    if integers:
        kind, fill = "<i2", int(NO_SAMPLE)
        about, dimensions, parts = f"{about}, I and Q", f"{dimensions} part", (2,)
    else:
        kind, fill = "<c8", _COMPLEX_NAN
    sides = (n_antennas, n_samples, *parts)
    signal = array("signal", kind, dimensions, *sides, fill=fill, about=about)
    directions = "1: rows: looking direction, horizontal, vertical"
    arrays = [
        signal,
        array("tx_positions", "<f8", "pose antenna xyz", n_antennas, 3, fill=nan, about="m"),
        array("rx_positions", "<f8", "pose antenna xyz", n_antennas, 3, fill=nan, about="m"),
        array("axes", "<f8", "pose axis xyz", 3, 3, fill=nan, about=directions),
        array("antenna_count", "<i8", "pose", fill=0),
        array("angle", "<f8", "pose", fill=nan, about="deg"),
    ]
    return {array.name: array for array in arrays}


def _antennas_per_chunk(shape: tuple[int, int, int], sample_bytes: int) -> int:
    _, n_antennas, n_samples = shape
    return max(1, min(n_antennas, _CHUNK_BYTES // (sample_bytes * max(1, n_samples))))


def _read_as_complex(stored: Samples) -> NDArray[np.complex64]:
    """Complex samples of what a scene holds; what is no sample is NaN."""
    signal = complex_samples(stored)
    if stored.dtype.kind != "c":
        missing = (stored == NO_SAMPLE).any(axis=-1)
        if missing.any():
            signal[missing] = _COMPLEX_NAN
    return signal


class _Unchanged(Exception):
    """The folder already holds exactly this scene."""


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
