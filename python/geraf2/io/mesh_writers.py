"""Writers of GLB, which is binary glTF 2.0, and of binary STL.

With trimesh they would take half a second more, most of it to import it.
"""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from geraf2 import __version__
from geraf2._types import Array, Bytes, Floats, Ints
from geraf2.geometry.triangles import unit_normals, vertex_normals
from geraf2.io.mesh_colours import to_linear

FRAME_FROM_GLTF = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
"""Axes of the file in the frame, as columns: glTF is +Y up by its standard, frames are +Z up."""
_MATERIAL = {
    "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
    "doubleSided": True,
}
_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_COMPONENT_TYPES = {"u1": 5121, "u4": 5125, "f4": 5126}
_SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def stl_bytes(vertices: Floats, faces: Ints) -> bytes:
    """Binary STL of a mesh; vertices (n_vertices, 3) [m], faces (n_faces, 3)."""
    facets = np.zeros(len(faces), dtype=_STL_FACET)
    facets["corners"] = vertices[faces]
    facets["normal"] = unit_normals(vertices[faces])
    return bytes(80) + struct.pack("<I", len(faces)) + facets.tobytes()


def glb_bytes(
    vertices: Floats,
    faces: Ints,
    srgb: Bytes,
    columns: Mapping[str, Array],
    made_from: Mapping[str, str],
) -> bytes:
    """GLB of a mesh.

    vertices, faces: (n_vertices, 3) [m] in the frame, (n_faces, 3).
    srgb: colour of each vertex, (n_vertices, 3).
    columns: more numbers of the vertices, each (n_vertices,), by name.
    made_from: what the mesh was made from, kept as metadata.
    """
    # glTF vertex colours are linear light, the palette is sRGB (gamma close to 2.2).
    colours = np.full((len(vertices), 4), 255, dtype=np.uint8)
    colours[:, :3] = np.rint(255.0 * to_linear(srgb / 255.0))
    normals = vertex_normals(vertices, faces)
    # glTF asks for unit normals everywhere; a vertex without area gets an arbitrary one.
    normals[~np.any(normals, axis=1)] = (0.0, 0.0, 1.0)
    buffer = _Buffer()
    attributes = {
        "POSITION": buffer.add(vertices, "f4", has_bounds=True),
        "NORMAL": buffer.add(normals, "f4"),
        "COLOR_0": buffer.add(colours, "u1", normalized=True),
        # glTF takes no wider integers here, and bytes would have to be padded.
        **{f"_{name.upper()}": buffer.add(of, "f4") for name, of in columns.items()},
    }
    primitive = {
        "attributes": attributes,
        "indices": buffer.add(faces.ravel(), "u4"),
        "material": 0,
    }
    asset = {"version": "2.0", "generator": f"geraf2 {__version__}"}
    node = {"name": "surface", "mesh": 0, "matrix": FRAME_FROM_GLTF.ravel().tolist()}
    content = {
        "asset": asset | ({"extras": {"made_from": dict(made_from)}} if made_from else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"name": "surface", "primitives": [primitive]}],
        "materials": [_MATERIAL],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    # Of an empty mesh the standard allows no accessors.
    text = json.dumps(content if len(faces) else {"asset": content["asset"]}).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(b"JSON", text), *([(b"BIN\0", bytes(buffer.data))] if len(faces) else [])]
    body = b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


class _Buffer:
    """Numbers of a file, and what describes them."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views = list[dict[str, int]]()
        self.accessors = list[dict[str, Any]]()

    def add(
        self, values: Array, kind: str, *, has_bounds: bool = False, normalized: bool = False
    ) -> int:
        """Append rows of 4, 8, ... bytes, and return the number of their accessor."""
        rows = np.ascontiguousarray(values, dtype=f"<{kind}")
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": _COMPONENT_TYPES[kind],
            "count": len(rows),
            "type": _SHAPES[rows.shape[1] if rows.ndim > 1 else 1],
        }
        if normalized:
            accessor["normalized"] = True
        if has_bounds and len(rows):
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": rows.nbytes})
        self.data += rows.tobytes()
        self.accessors.append(accessor)
        return len(self.accessors) - 1
