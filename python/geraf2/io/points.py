"""Vertices, oriented points and triangles as PLY files."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from geraf2._types import AnyPath, Array, Floats, Ints
from geraf2.errors import UserError
from geraf2.io.mesh_formats import parse_ply
from geraf2.io.regular import BINARY_BYTES, read_regular


def cloud_bytes(
    positions: Floats, normals: Floats, columns: Mapping[str, Any], comments: Sequence[str] = ()
) -> bytes:
    """Binary PLY of points (n, 3) [m] with their normals.

    columns: further values of each point, (n,); bytes stay bytes, all else becomes float.
    """
    values: dict[str, Any] = {name: positions[:, axis] for axis, name in enumerate("xyz")}
    values |= {"n" + name: normals[:, axis] for axis, name in enumerate("xyz")}
    return ply_file({**values, **columns}, ("unit metre", *comments))


def ply_file(
    columns: Mapping[str, Any], comments: Sequence[str], faces: Ints | None = None
) -> bytes:
    """Binary PLY of named columns of vertices, (n,) each, and triangles (n_faces, 3)."""
    values = {name: np.asarray(of) for name, of in columns.items()}
    kinds = {name: "u1" if of.dtype == np.uint8 else "<f4" for name, of in values.items()}
    rows = np.zeros(len(values["x"]), dtype=list(kinds.items()))
    for name, of in values.items():
        rows[name] = of
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {len(rows)}",
        *(f"property {'uchar' if kind == 'u1' else 'float'} {n}" for n, kind in kinds.items()),
    ]
    data = rows.tobytes()
    if faces is not None:
        triangles = np.zeros(len(faces), dtype=[("n", "u1"), ("v", "<i4", (3,))])
        triangles["n"], triangles["v"] = 3, faces
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        data += triangles.tobytes()
    return "\n".join([*header, "end_header", ""]).encode("ascii", "replace") + data


class Cloud(NamedTuple):
    """Oriented points of a file."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """(n, 3)."""
    columns: Mapping[str, Array]
    """Further values of each point by name, (n,)."""


def read_cloud(path: AnyPath) -> Cloud:
    """Points of a file of :func:`cloud_bytes`; else UserError."""
    try:
        raw = parse_ply(read_regular(path, BINARY_BYTES))
        normals = np.stack([raw.columns["n" + axis] for axis in "xyz"], axis=1)
    except (ValueError, KeyError) as error:
        raise UserError(
            what="cannot be read as points with normals",
            where=path,
            expected="a PLY file of geraf2",
            hint="run 'geraf2 reconstruct' again",
        ) from error
    return Cloud(raw.vertices, normals.astype(np.float64), raw.columns)
