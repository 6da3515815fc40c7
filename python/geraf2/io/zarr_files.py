"""The zarr v3 files of a scene: groups, and arrays in plain uncompressed chunks.

Metadata are JSON, and a chunk is a file of numbers (zarr specification 3.1, codec `bytes`, chunk
key encoding `default`). The package zarr, which takes a third of a second to import, is not needed,
and chunks can grow as parts come.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Array
from geraf2.errors import UserError
from geraf2.io.objects import read_bytes
from geraf2.io.regular import RECORD_BYTES
from geraf2.io.text import parse_json

METADATA_NAME = "zarr.json"
PLAIN = "bytes"
"""Codec of chunks that are neither compressed nor filtered."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ZarrArray:
    """An array of a group; chunks along the first two axes, whole along the others."""

    name: str
    dtype: str
    """As of NumPy, little-endian."""
    fill: complex
    """Value of missing chunks."""
    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    attributes: Mapping[str, str] = field(default_factory=dict)

    def write_metadata(self, group: Path) -> None:
        """Make the array's folder in that of its group."""
        folder = group / self.name
        folder.mkdir()
        (folder / METADATA_NAME).write_text(self.text)

    @property
    def text(self) -> str:
        """Metadata of the array."""
        content = {
            "zarr_format": 3,
            "node_type": "array",
            "shape": self.shape,
            "data_type": np.dtype(self.dtype).name,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": self.chunks}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": _fill_value(np.dtype(self.dtype), self.fill),
            "codecs": [{"name": PLAIN, "configuration": {"endian": "little"}}],
            "attributes": dict(self.attributes),
            "dimension_names": self.dimensions,
        }
        return json.dumps(content, indent=2, allow_nan=False)

    def chunk(self, group: Path, index: tuple[int, ...]) -> Path:
        """File of the chunk of these indices."""
        return group.joinpath(self.name, "c", *map(str, index))

    @property
    def chunk_bytes(self) -> int:
        """Size of a whole chunk."""
        return int(np.dtype(self.dtype).itemsize * prod(self.chunks))

    def read(self, group: Path, *ranges: tuple[int, int]) -> Array:
        """Values between first and stop along the first axes, and all along the others.

        OSError or ValueError where a chunk cannot be read; one that is missing has the fill value.
        """
        spans = [*ranges, *((0, length) for length in self.shape[len(ranges) :])]
        values = np.full([stop - first for first, stop in spans], self.fill, dtype=self.dtype)
        sides = list(zip(spans, self.chunks, strict=True))
        for index in product(*(range(a // side, -(-b // side)) for (a, b), side in sides)):
            try:
                data = read_bytes(self.chunk(group, index), max(RECORD_BYTES, self.chunk_bytes))
            except FileNotFoundError:
                continue
            chunk = np.frombuffer(data, dtype=self.dtype).reshape(self.chunks)
            starts = [number * side for number, (_, side) in zip(index, sides, strict=True)]
            part, place = [], []
            for start, ((first, stop), side) in zip(starts, sides, strict=True):
                low, high = max(start, first), min(start + side, stop)
                part.append(slice(low - start, high - start))
                place.append(slice(low - first, high - first))
            values[tuple(place)] = chunk[tuple(part)]
        return values

    def append(self, group: Path, index: tuple[int, ...], values: Array) -> None:
        """Append to one chunk, that of these indices; a new one is made."""
        path = self.chunk(group, index)
        path.parent.mkdir(parents=True, exist_ok=True)
        data = np.ascontiguousarray(values, dtype=self.dtype).data
        with path.open("ab") as handle:
            handle.write(data)


def write_group(folder: Path, attributes: Mapping[str, Any]) -> None:
    """Metadata of a group in a folder that is there; may be written again."""
    (folder / METADATA_NAME).write_text(group_text(attributes))


def group_text(attributes: Mapping[str, Any]) -> str:
    """Metadata of a group."""
    content = {"zarr_format": 3, "node_type": "group", "attributes": dict(attributes)}
    return json.dumps(content, indent=2, allow_nan=False)


def read_group(folder: Path) -> dict[str, Any]:
    """Attributes of a group; ValueError or another error where it is none."""
    attributes = _read_metadata(folder, "group").get("attributes", {})
    return dict(attributes)


def read_array(group: Path, name: str, dtypes: Collection[str]) -> ZarrArray:
    """Metadata of an array of one of these types, as of NumPy.

    UserError for another type or codec, FileNotFoundError where it is missing, ValueError or
    another error where its metadata are wrong.
    """
    where = group / name
    content = _read_metadata(where, "array")
    if (dtype := content["data_type"]) not in dtypes:
        raise UserError(
            what="has the wrong type", where=where, expected=" or ".join(dtypes), got=str(dtype)
        )
    codecs = [codec["name"] for codec in content["codecs"]]
    if codecs != [PLAIN]:  # others unpack to any size, and no scene has them
        what, expected = "is compressed or filtered", f"plain numbers (codec {PLAIN})"
        raise UserError(what, where=where, expected=expected, got=", ".join(codecs) or "none")
    fill = content["fill_value"]
    found = ZarrArray(
        name=name,
        dtype=np.dtype(dtype).newbyteorder("<").str,
        fill=complex(*map(float, fill)) if isinstance(fill, list) else float(fill),
        dimensions=(),
        shape=_lengths(content["shape"], least=0),
        chunks=_lengths(content["chunk_grid"]["configuration"]["chunk_shape"], least=1),
    )
    as_written = parse_json(found.text)
    for key in ("chunk_grid", "chunk_key_encoding", "codecs"):
        if content[key] != as_written[key]:
            msg = f"{key} is {content[key]}, expected {as_written[key]}"
            raise ValueError(msg)
    if len(found.shape) != len(found.chunks):
        msg = f"chunks of shape {found.chunks} in an array of shape {found.shape}"
        raise ValueError(msg)
    return found


def _read_metadata(folder: Path, kind: str) -> dict[str, Any]:
    content = parse_json(read_bytes(folder / METADATA_NAME, RECORD_BYTES))
    found = content["zarr_format"], content["node_type"]
    if found != (3, kind):
        msg = f"zarr format {found[0]}, {found[1]}, expected 3, {kind}"
        raise ValueError(msg)
    return dict(content)


def _lengths(values: list[int], least: int) -> tuple[int, ...]:
    if not all(type(value) is int and value >= least for value in values):
        msg = f"lengths must be integers from {least}, got {values}"
        raise ValueError(msg)
    return tuple(values)


def _fill_value(dtype: np.dtype[Any], fill: complex) -> Any:
    """JSON has no NaN and no complex numbers; zarr specifies how to write them."""
    if dtype.kind == "i":
        return int(fill.real)
    parts = [fill.real, fill.imag] if dtype.kind == "c" else [fill.real]
    written = ["NaN" if np.isnan(part) else float(part) for part in parts]
    return written if dtype.kind == "c" else written[0]
