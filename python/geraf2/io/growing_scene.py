"""A scene folder (geraf2.io.container) that grows by one plane at a time.

A plane counts once the group's metadata name it, and those are written last. So a process that is
killed leaves all planes before, and a reader that comes in between finds them or has to wait.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Array
from geraf2.errors import UserError
from geraf2.io import container
from geraf2.io.atomic import sweep_folder, write_bytes_atomic, write_text_atomic
from geraf2.io.manifest import SceneManifest
from geraf2.io.outputs import require_folder
from geraf2.io.pose_digest import ANTENNA_ARRAYS
from geraf2.io.regular import RECORD_BYTES, read_regular
from geraf2.io.samples import crc_of
from geraf2.io.scene_writer import angle_of, checksums, group_attributes, scene_arrays
from geraf2.io.text import parse_json
from geraf2.io.toml import write_toml
from geraf2.io.zarr_files import METADATA_NAME, ZarrArray, group_text
from geraf2.records import Pose

# Poses in a chunk of counts and angles, which is written again for each of them.
_N_COUNTED = 128


class GrowingScene:
    """Scene folder to which planes are appended; it is made with its first plane.

    manifest: of the scene; UserError if the folder holds a scene of another radar.
    """

    def __init__(self, path: Path, manifest: SceneManifest) -> None:
        self.path, self.manifest = Path(path), manifest
        self._names: list[str] = []
        self._counted: dict[str, list[Any]] = {"antenna_count": [], "angle": []}
        self._sums: dict[str, list[str]] = {}
        self._shape, self._n_chunk = (0, 0, manifest.waveform.n_samples), 0
        require_folder(self.path, "scene", own=container.is_scene(self.path) or self._is_begun)
        sweep_folder(self.path)
        if container.is_scene(self.path):
            self._continue()

    def __len__(self) -> int:
        return len(self._names)

    @property
    def _group(self) -> Path:
        return self.path / container.RADAR_NAME

    @property
    def _is_begun(self) -> bool:
        """Whether the folder holds nothing but a first plane that was not finished."""
        here = self.path
        return here.is_dir() and all(e.name == container.RADAR_NAME for e in here.iterdir())

    def _continue(self) -> None:
        """Take over the planes of the folder; those that are half written are dropped."""
        known = container.read_scene_manifest(self.path)
        if (known.waveform, known.walls, known.frame) != (
            self.manifest.waveform,
            self.manifest.walls,
            self.manifest.frame,
        ):
            raise UserError(
                what="holds planes of another radar, box or frame",
                where=self.path,
                hint="choose another folder, or continue with the same ones",
            )
        self.manifest = known
        group = self._group
        attributes = _metadata(group)["attributes"]
        self._names = [str(name) for name in attributes["pose_names"]]
        signal = _metadata(group / "signal")
        if not may_grow(self.path):
            raise UserError(what="is a finished scene", where=self.path, expected="a growing one")
        self._n_chunk = int(signal["chunk_grid"]["configuration"]["chunk_shape"][1])
        self._shape = (len(self._names), int(signal["shape"][1]), self._shape[2])
        self._write_metadata(
            scene_arrays(self._shape, self._n_chunk, integers=False, n_counted=_N_COUNTED)
        )
        reader = container.SceneReader(self.path)
        self._counted = {
            "antenna_count": reader.n_antennas.tolist(),
            "angle": reader.angles_deg.tolist(),
        }
        self._sums = {name: list(sums) for name, sums in attributes[container.CHECKSUMS].items()}

    def append(self, pose: Pose) -> None:
        """Write the next plane; it counts when this returns, and after an error nothing changed."""
        index, n_antennas = len(self), pose.n_antennas
        if index >= container.MAX_PLANES:
            raise UserError(what="too many planes", where=self.path, expected=container.MAX_PLANES)
        n_chunk = self._n_chunk or max(1, n_antennas)
        shape = (index + 1, max(n_antennas, self._shape[1]), self._shape[2])
        arrays = scene_arrays(shape, n_chunk, integers=False, n_counted=_N_COUNTED)
        of_antennas = {}
        for name, dtype in ANTENNA_ARRAYS.items():
            values = np.ascontiguousarray(getattr(pose, name), dtype=dtype)
            of_antennas[name] = crc_of(values)
            for number in range(max(1, -(-n_antennas // n_chunk))):
                part = values[number * n_chunk : (number + 1) * n_chunk]
                self._write(arrays[name], (index, number, *(0,) * (values.ndim - 1)), part)
        self._write(arrays["axes"], (index, 0, 0), pose.axes)
        counted = {
            "antenna_count": [*self._counted["antenna_count"], n_antennas],
            "angle": [*self._counted["angle"], angle_of(pose)],
        }
        first = index // _N_COUNTED * _N_COUNTED
        for name, numbers in counted.items():
            self._write(arrays[name], (index // _N_COUNTED,), np.array(numbers[first:]))
        self._write_metadata(arrays)
        names = [*self._names, pose.name]
        sums = {
            name: [*self._sums.get(name, ()), value]
            for name, value in checksums(pose, n_antennas, of_antennas).items()
        }
        group = group_text(group_attributes(names, sums))
        write_text_atomic(self._group / METADATA_NAME, group)
        if not index:
            write_toml(self.path / container.MANIFEST_NAME, self.manifest)
        self._names, self._sums, self._counted = names, sums, counted
        self._shape, self._n_chunk = shape, n_chunk

    def _write_metadata(self, arrays: Mapping[str, ZarrArray]) -> None:
        for array in arrays.values():
            write_text_atomic(self._group / array.name / METADATA_NAME, array.text)

    def _write(self, array: ZarrArray, index: tuple[int, ...], values: Array) -> None:
        """Write a chunk, whose rest is filled."""
        whole = np.full(array.chunks, array.fill, dtype=array.dtype)
        (whole if whole.ndim == 1 else whole[0])[: len(values)] = values
        write_bytes_atomic(array.chunk(self._group, index), whole.tobytes())


def may_grow(scene: Path) -> bool:
    """Whether planes may still be appended to a scene: it was not written whole."""
    counts = _metadata(scene / container.RADAR_NAME / "antenna_count")
    return bool(counts["chunk_grid"]["configuration"]["chunk_shape"] == [_N_COUNTED])


def _metadata(folder: Path) -> Any:
    return parse_json(read_regular(folder / METADATA_NAME, RECORD_BYTES))
