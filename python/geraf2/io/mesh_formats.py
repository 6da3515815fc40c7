"""Readers of OBJ and PLY: vertices, triangles, and columns of the vertices.

ValueError states what is wrong with the bytes.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from geraf2._types import Array, Floats, Ints
from geraf2.geometry.polygons import strip_triangles, triangulated

_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_PLY_ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, kw_only=True, eq=False)
class RawMesh:
    """Content of a mesh file."""

    vertices: Floats
    """(n_vertices, 3)."""
    faces: Ints
    """(n_faces, 3)."""
    columns: Mapping[str, Array] = field(default_factory=dict)
    """Scalar properties of the vertices, (n_vertices,) each."""


def parse_obj(data: bytes) -> RawMesh:
    """Mesh of an OBJ; relative indices count back from the line of their face.

    trimesh counts them back from the end of the file, takes index 0 for the first vertex, and cuts
    concave polygons into fans, all without a word.
    """
    vertices: list[list[float]] = []
    corners: list[int] = []
    counts = []
    text = data.decode("latin-1").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), start=1):
        kind, *words = line.split("#", 1)[0].split() or [""]
        try:
            if kind == "v":
                x, y, z, *_ = words
                vertices.append([float(x), float(y), float(z)])
            elif kind == "f":
                indices = [int(word.split("/", 1)[0]) for word in words]
                if 0 in indices:
                    raise ValueError
                n = len(vertices)
                corners += [index - 1 if index > 0 else n + index for index in indices]
                counts.append(len(indices))
        except ValueError:
            msg = f"line {number} cannot be read: {line.strip()[:40]!r}"
            raise ValueError(msg) from None
    positions = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    faces = triangulated(positions, np.array(corners, dtype=np.int64), np.array(counts, dtype=int))
    return RawMesh(vertices=positions, faces=faces)


def parse_ply(data: bytes) -> RawMesh:
    """Mesh of a PLY: faces of any number of corners, and strips."""
    elements, order, at = _ply_header(data)
    is_text = not order
    if is_text:  # is read as a binary file of doubles
        _require_rows(data[at:], data.count(b"\n", 0, at), elements)
        data, order, at = np.array(data[at:].split(), dtype=np.float64).tobytes(), "=", 0
        elements = [
            (name, count, [(one, "f8", length and "f8") for one, _, length in properties])
            for name, count, properties in elements
        ]
    rows: dict[str, dict[str, Any]] = {}
    for element in elements:
        rows[element[0]], at = _binary_rows(data, order, at, element)
    n_left = 0 if is_text else len(data[at:].strip())
    if n_left:
        msg = f"{n_left} bytes stand behind the last row that the header states"
        raise ValueError(msg)
    vertex = rows.get("vertex", {})
    if not {"x", "y", "z"} <= set(vertex):
        msg = "it has no vertices x, y, z"
        raise ValueError(msg)
    vertices = np.stack([np.asarray(vertex[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    faces = [np.zeros((0, 3), dtype=np.int64)]
    for name in ("vertex_indices", "vertex_index"):
        if name in rows.get("face", {}):
            corners, counts = rows["face"][name]
            faces.append(triangulated(vertices, corners, counts))
        if name in rows.get("tristrips", {}):
            corners, counts = rows["tristrips"][name]
            strips = np.split(corners, np.cumsum(counts)[:-1])
            faces += [strip_triangles(strip) for strip in strips]
    scalars = {name: values for name, values in vertex.items() if isinstance(values, np.ndarray)}
    return RawMesh(vertices=vertices, faces=np.concatenate(faces), columns=scalars)


_Property = tuple[str, str, str | None]
"""Name, type, and type of the length of a list."""
_Element = tuple[str, int, list[_Property]]
"""Name, number of rows, and properties."""


def _ply_header(data: bytes) -> tuple[list[_Element], str, int]:
    """Elements, byte order (empty: text) and where the rows begin."""
    end = re.search(rb"^end_header[^\n]*\n", data, re.MULTILINE)
    if not data.startswith(b"ply") or end is None:
        msg = "it has no header of a PLY"
        raise ValueError(msg)
    elements: list[_Element] = []
    order = None
    for line in data[: end.start()].decode("latin-1").splitlines():
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            if words[1] not in _PLY_ENCODINGS:
                msg = f"unknown encoding {words[1]!r}"
                raise ValueError(msg)
            order = _PLY_ENCODINGS[words[1]]
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append((words[1], int(words[2]), []))
        elif words[:1] in (["element"], ["property"]):
            *types, name = words[1:] or [""]
            known = [_PLY_TYPES.get(kind) for kind in types if kind != "list"]
            is_list = types[:1] == ["list"]
            if not elements or words[0] == "element" or None in known or len(known) != 1 + is_list:
                msg = f"line {line.strip()[:40]!r} of its header cannot be read"
                raise ValueError(msg)
            length = known[0] if is_list else None
            elements[-1][2].append((name, str(known[-1]), length))
    if order is None or not all(properties for _, _, properties in elements):
        msg = "its header has no format, or an element without properties"
        raise ValueError(msg)
    return elements, order, end.end()


def _too_short(name: str, count: int, got: int) -> ValueError:
    return ValueError(f"the mesh lacks {name} rows, expected {count}, got {got}; it may be cut off")


def _require_rows(text: bytes, n_before: int, elements: Sequence[_Element]) -> None:
    """Raise ValueError for the first line that is no row as the header states it."""
    # Without that check words are read on across line ends. Files with fewer lines than rows are
    # cut off, or have several rows in a line.
    lines = enumerate(text.split(b"\n"), start=n_before + 1)
    rows = [(number, words) for number, line in lines if (words := line.split())]
    if len(rows) < sum(count for _, count, _ in elements):
        return
    row = iter(rows)
    for _, count, properties in elements:
        for number, words in islice(row, count):
            n = 0
            for *_, length in properties:
                n += 1 if length is None or n >= len(words) else 1 + int(float(words[n]))
            is_cut = n > len(words) and number == rows[-1][0]  # reported by the reader
            if n != len(words) and not is_cut:
                msg = f"line {number} has {len(words)} words, the header states {n}"
                raise ValueError(msg)
    for number, _ in row:
        msg = f"line {number} stands behind the last row that the header states"
        raise ValueError(msg)


def _indices(values: Any, counts: Any) -> tuple[Ints, Ints]:
    numbers = np.asarray(values)
    if not np.isfinite(numbers).all():
        msg = "a list holds what is no number"
        raise ValueError(msg)
    return numbers.astype(np.int64), np.asarray(counts, dtype=np.int64)


def _binary_rows(data: bytes, order: str, at: int, element: _Element) -> tuple[dict[str, Any], int]:
    """Values of each property, and the byte behind the last row."""
    count, properties = element[1:]
    size, layout, lengths = 0, [], {}
    # Rows of the same lengths as the first are read at once: triangles, or quadrilaterals.
    for one, kind, length in properties:
        n = 1
        if length is not None:
            n = int(_values(data, at + size, order + length, 1, element, 0)[0]) if count else 0
            layout.append((f"length of {one}", order + length, (1,)))
            lengths[f"length of {one}"] = n
            size += np.dtype(length).itemsize
        layout.append((one, order + kind, (max(n, 0),)))
        size += np.dtype(kind).itemsize * n
    if at + count * size <= len(data) and min(lengths.values(), default=0) >= 0:
        rows = np.frombuffer(data, np.dtype(layout), count=count, offset=at)
        if all((rows[one] == n).all() for one, n in lengths.items()):
            found: dict[str, Any] = {}
            for one, _, length in properties:
                flat = rows[one].reshape(-1)
                counts = np.full(count, rows[one].shape[1])
                found[one] = flat if length is None else _indices(flat, counts)
            return found, at + count * size
    parts: dict[str, tuple[list[float], list[int]]] = {one: ([], []) for one, *_ in properties}
    for row in range(count):
        for one, kind, length in properties:
            n = 1
            if length is not None:
                n = int(_values(data, at, order + length, 1, element, row)[0])
                at += np.dtype(length).itemsize
            parts[one][0].extend(_values(data, at, order + kind, n, element, row))
            parts[one][1].append(n)
            at += n * np.dtype(kind).itemsize
    lists = {one for one, _, length in properties if length is not None}
    return {k: _indices(*v) if k in lists else np.array(v[0]) for k, v in parts.items()}, at


def _values(data: bytes, at: int, kind: str, n: int, element: _Element, row: int) -> list[float]:
    if n < 0 or at + n * np.dtype(kind).itemsize > len(data):
        raise _too_short(element[0], element[1], row)
    values: list[float] = np.frombuffer(data, kind, count=n, offset=at).astype(float).tolist()
    return values
