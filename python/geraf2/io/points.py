"""Oriented points as PLY files."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from geraf2._types import Floats


def cloud_bytes(
    positions: Floats,
    normals: Floats,
    columns: Mapping[str, Any],
    comments: Sequence[str] = (),
) -> bytes:
    """Binary PLY of points (n, 3) [m] with their normals.

    columns: further values of each point, (n,); bytes stay bytes, all else becomes float.
    """
    values: dict[str, Any] = {name: positions[:, axis] for axis, name in enumerate("xyz")}
    values |= {"n" + name: normals[:, axis] for axis, name in enumerate("xyz")}
    values |= columns
    kinds = {name: "u1" if _is_bytes(of) else "<f4" for name, of in values.items()}
    rows = np.zeros(len(positions), dtype=list(kinds.items()))
    for name, of in values.items():
        rows[name] = of
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment unit metre",
        *(f"comment {text}" for text in comments),
        f"element vertex {len(rows)}",
        *(f"property {'uchar' if kind == 'u1' else 'float'} {n}" for n, kind in kinds.items()),
        "end_header",
    ]
    return ("\n".join(header) + "\n").encode("ascii") + rows.tobytes()


def _is_bytes(values: Any) -> bool:
    return np.asarray(values).dtype == np.uint8
