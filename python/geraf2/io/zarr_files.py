"""Writer of the zarr v3 files of a scene: groups, and arrays in plain uncompressed chunks.

Metadata are JSON, and a chunk is a file of numbers (zarr specification 3.1, codec `bytes`, chunk
key encoding `default`). Written so, the package zarr need not be imported, which takes a fifth of a
second, and chunks can grow as parts come.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Array

METADATA_NAME = "zarr.json"


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
            "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}],
            "attributes": dict(self.attributes),
            "dimension_names": self.dimensions,
        }
        return json.dumps(content, indent=2, allow_nan=False)

    def chunk(self, group: Path, index: tuple[int, ...]) -> Path:
        """File of the chunk of these indices."""
        return group.joinpath(self.name, "c", *map(str, index))

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


def _fill_value(dtype: np.dtype[Any], fill: complex) -> Any:
    """JSON has no NaN and no complex numbers; zarr specifies how to write them."""
    if dtype.kind == "i":
        return int(fill.real)
    parts = [fill.real, fill.imag] if dtype.kind == "c" else [fill.real]
    written = ["NaN" if np.isnan(part) else float(part) for part in parts]
    return written if dtype.kind == "c" else written[0]
