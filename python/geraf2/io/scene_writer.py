"""Writer of scene folders (geraf2.io.container): pose by pose, whole or not at all."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from geraf2._types import Array
from geraf2._validation import require_shape
from geraf2.errors import UserError
from geraf2.io import container
from geraf2.io.atomic import atomic_folder
from geraf2.io.manifest import SCENE_VERSION, SceneManifest
from geraf2.io.outputs import require_consent, require_folder
from geraf2.io.pose_digest import ANTENNA_ARRAYS
from geraf2.io.samples import NO_SAMPLE, crc_of, stored_integers
from geraf2.io.toml import write_toml
from geraf2.io.zarr_files import METADATA_NAME, ZarrArray, write_group
from geraf2.records import RawPose

# Bytes of signal in a chunk: what a part of a pose costs to read.
_CHUNK_BYTES = 1 << 24
_AXES = "rows: looking direction, horizontal, vertical"


class SceneWriter(ExitStack):
    """Writes a scene pose by pose; the folder appears when the block ends without error.

    The same content in an existing folder changes nothing (`unchanged` is then true), other content
    needs `overwrite`. With `integers` the samples come as int16, I and Q, and stay so.
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
        super().__init__()
        self.path = Path(path)
        self.manifest = manifest
        self.unchanged = False
        self._overwrite = overwrite
        self._integers = integers
        self._shape = (n_poses, n_antennas_max, manifest.waveform.n_samples)
        self._names: list[str] = []
        antenna_bytes = (4 if integers else 8) * max(1, self._shape[2])
        self._n_chunk = max(1, min(n_antennas_max, _CHUNK_BYTES // antenna_bytes))
        self._begun: RawPose | None = None
        self._n_begun = 0
        self.folder = self.path
        """Where to put optional files (truth.ply, los.ply) before the block ends."""
        self._arrays = scene_arrays(self._shape, self._n_chunk, integers=integers)
        self._counts: list[int] = []
        self._begun_sums = dict.fromkeys(ANTENNA_ARRAYS, 0)
        self._checksums: dict[str, list[str]] = {name: [] for name in container.ARRAY_TYPES}
        self._angles: list[float] = []
        require_folder(self.path, "scene", own=container.is_scene(self.path))

    @property
    def _group(self) -> Path:
        return self.folder / container.RADAR_NAME

    def __enter__(self) -> Self:
        self.enter_context(self._writing())
        return super().__enter__()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            with atomic_folder(self.path) as self.folder:
                self._group.mkdir()
                self._write_group()
                for array in self._arrays.values():
                    (self._group / array.name).mkdir()
                    (self._group / array.name / METADATA_NAME).write_text(array.text)
                yield
                if len(self._names) != self._shape[0] or self._begun is not None:
                    msg = f"{self._shape[0]} planes were announced, got {len(self._names)}"
                    raise ValueError(msg)
                self._write_group()
                if self._names:
                    counts, angles = np.array(self._counts), np.array(self._angles)
                    self._arrays["antenna_count"].append(self._group, (0,), counts)
                    self._arrays["angle"].append(self._group, (0,), angles)
                write_toml(self.folder / container.MANIFEST_NAME, self.manifest)
                if container.is_scene(self.path) and not self._overwrite:
                    self._compare_with_existing()
        except _Unchanged:
            self.unchanged = True

    def append(self, pose: RawPose, *, n_antennas: int | None = None) -> None:
        """Write the next pose, or a part of it.

        n_antennas: antennas of the whole pose, where `pose` is a part of it.
        """
        index, keep = len(self._names), pose.signal.shape[0]
        n_antennas = keep if n_antennas is None else n_antennas
        n_so_far = self._n_begun + keep
        if index >= self._shape[0] or n_so_far > n_antennas or n_antennas > self._shape[1]:
            msg = f"plane {index} with {n_so_far} antennas does not fit into {self._shape}"
            raise ValueError(msg)
        samples = stored_integers(pose.signal) if self._integers else pose.signal
        require_shape("signal", samples, (keep, self._shape[2], *((2,) if self._integers else ())))
        if self._begun is None:
            self._begun = pose
        for name in ANTENNA_ARRAYS:
            array = samples if name == "signal" else getattr(pose, name)
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
            whole = self._begun  # but for its antennas
            self._arrays["axes"].append(self._group, (index, 0, 0), whole.axes)
            self._counts.append(n_antennas)
            self._angles.append(angle_of(whole))
            self._names.append(whole.name)
            for name, value in checksums(whole, n_antennas, self._begun_sums).items():
                self._checksums[name].append(value)
            self._begun, self._n_begun = None, 0
            self._begun_sums = dict.fromkeys(ANTENNA_ARRAYS, 0)

    def _write_antennas(self, name: str, index: int, first: int, array: Array) -> None:
        """Append antennas from `first` on to the chunk files that they belong to."""
        done = 0
        while done < len(array):
            number, inside = divmod(first + done, self._n_chunk)
            some = array[done : done + self._n_chunk - inside]
            after = (0,) * (array.ndim - 1)
            self._arrays[name].append(self._group, (index, number, *after), some)
            done += len(some)

    def _compare_with_existing(self) -> None:
        try:
            old = container.SceneReader(self.path)
            same = (
                old.manifest.waveform == self.manifest.waveform
                and old.manifest.walls == self.manifest.walls
                and old.manifest.frame == self.manifest.frame
                and old.holds_same_poses(container.SceneReader(self.folder))
                and container.verify_scene(self.path) == old.n_poses
            )
        except UserError:
            same = False
        if same:
            raise _Unchanged
        require_consent(self.path, "another scene", overwrite=False)

    def _write_group(self) -> None:
        write_group(self._group, group_attributes(self._names, self._checksums))


def group_attributes(names: Sequence[str], sums: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Attributes of the group: names of the poses, and their checksums by array."""
    return {
        "format": "geraf2-radar",
        "version": SCENE_VERSION,
        "pose_names": list(names),
        container.CHECKSUMS: {name: list(sums[name]) for name in container.ARRAY_TYPES},
    }


def checksums(pose: RawPose, n_antennas: int, of_antennas: Mapping[str, int]) -> dict[str, str]:
    """Checksums of a pose, by array; `of_antennas` are those of its samples and positions."""
    sums = {
        **of_antennas,
        "axes": crc_of(np.asarray(pose.axes, dtype="<f8")),
        "antenna_count": crc_of(np.asarray(n_antennas, dtype="<i8")),
        "angle": crc_of(np.asarray(angle_of(pose), dtype="<f8")),
    }
    return {name: f"{value:08x}" for name, value in sums.items()}


def angle_of(pose: RawPose) -> float:
    """Angle of a pose as it is stored, NaN where it is not known [degrees]."""
    return float("nan") if pose.angle_deg is None else pose.angle_deg


def scene_arrays(
    shape: tuple[int, int, int], n_chunk: int, *, integers: bool, n_counted: int | None = None
) -> dict[str, ZarrArray]:
    """Arrays of a scene of (n_poses, n_antennas, n_samples), `n_chunk` antennas in a chunk.

    n_counted: poses in a chunk of counts and angles; all when None.

    Neither compressed nor filtered: noise does not compress, zstd takes 8 % off a capture at
    20 dB SNR.
    """
    n_poses, n_antennas, n_samples = shape
    nan, positions = float("nan"), ("<f8", "pose antenna xyz", (n_antennas, 3))
    kind, fill = ("<i2", int(NO_SAMPLE)) if integers else ("<c8", container.COMPLEX_NAN)
    samples = (n_antennas, n_samples, 2) if integers else (n_antennas, n_samples)
    sampled = "pose antenna sample" + " part" * integers
    table: dict[str, tuple[str, str, tuple[int, ...], complex, str, str]] = {
        "signal": (kind, sampled, samples, fill, "1", "raw ADC samples" + ", I and Q" * integers),
        "tx_positions": (*positions, nan, "m", ""),
        "rx_positions": (*positions, nan, "m", ""),
        "axes": ("<f8", "pose axis xyz", (3, 3), nan, "1", _AXES),
        "antenna_count": ("<i8", "pose", (), 0, "1", ""),
        "angle": ("<f8", "pose", (), nan, "deg", ""),
    }
    arrays = {}
    for name, (dtype, dimensions, sides, missing, unit, about) in table.items():
        # A chunk side of 0 is not allowed, an empty pose is.
        chunks = (1, *(max(1, n) for n in sides)) if sides else (n_counted or max(1, n_poses),)
        arrays[name] = ZarrArray(
            name=name,
            dtype=dtype,
            fill=missing,
            dimensions=tuple(dimensions.split()),
            shape=(n_poses, *sides),
            chunks=(1, n_chunk, *chunks[2:]) if name in ANTENNA_ARRAYS else chunks,
            attributes={"unit": unit, **({"long_name": about} if about else {})},
        )
    return arrays


class _Unchanged(Exception):
    """The folder already holds exactly this scene."""
