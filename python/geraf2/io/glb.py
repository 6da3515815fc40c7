"""Writer of GLB, glTF's binary form."""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from geraf2 import __version__
from geraf2._types import Array, Bytes, Floats, Ints
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh_colours import to_linear

FRAME_FROM_GLTF = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
"""Axes of the file in the frame, as columns: glTF is +Y up by its standard, frames are +Z up."""
_GLTF_NODE_ROTATION = (-float(np.sqrt(0.5)), 0.0, 0.0, float(np.sqrt(0.5)))


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
    positions = vertices.astype("<f4")
    normals = vertex_normals(vertices, faces).astype("<f4")
    # glTF asks for unit normals everywhere; a vertex without area gets an arbitrary one.
    normals[~np.any(normals, axis=1)] = (0.0, 0.0, 1.0)
    # glTF vertex colours are linear light, the palette is sRGB (gamma close to 2.2).
    colours = np.full((len(vertices), 4), 255, dtype=np.uint8)
    colours[:, :3] = np.rint(255.0 * to_linear(srgb / 255.0))
    float_type, uint8_type, uint32_type = 5126, 5121, 5125
    buffers: list[tuple[str, Array, int, str, dict[str, Any]]] = [
        ("POSITION", positions, float_type, "VEC3", {}),
        ("NORMAL", normals, float_type, "VEC3", {}),
        ("COLOR_0", colours, uint8_type, "VEC4", {"normalized": True}),
    ]
    if len(vertices):
        buffers[0][4].update(min=positions.min(axis=0).tolist(), max=positions.max(axis=0).tolist())
    for name, values in columns.items():
        # glTF takes no wider integers here, and bytes would have to be padded.
        scalar = values.astype("<f4")
        buffers.append((f"_{name.upper()}", scalar, float_type, "SCALAR", {}))
    indices = faces.astype("<u4").reshape(-1)
    buffers.append(("", indices, uint32_type, "SCALAR", {}))

    return _document(buffers, made_from)


def _document(
    buffers: list[tuple[str, Array, int, str, dict[str, Any]]], made_from: Mapping[str, str]
) -> bytes:
    """GLB of buffers: name of the attribute, values, component type, kind, and more of each."""
    views, accessors, attributes, offset = [], [], {}, 0
    for number, (name, array, component_type, kind, extra) in enumerate(buffers):
        # Every element here is a multiple of four bytes long, as glTF's alignment asks.
        target = 34962 if name else 34963  # ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER
        views.append(
            {"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": target}
        )
        count = {"bufferView": number, "componentType": component_type, "count": len(array)}
        accessors.append({**count, "type": kind, **extra})
        if name:
            attributes[name] = number
        offset += array.nbytes
    primitive = {"attributes": attributes, "indices": len(buffers) - 1, "material": 0, "mode": 4}
    material = {
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
        "doubleSided": True,
    }
    document = {
        "asset": {
            "version": "2.0",
            "generator": f"geraf2 {__version__}",
            **({"extras": {"made_from": dict(made_from)}} if made_from else {}),
        },
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "surface", "mesh": 0, "rotation": _GLTF_NODE_ROTATION}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [material],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    binary = b"".join(array.tobytes() for _, array, _, _, _ in buffers)
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)  # chunks are aligned to four bytes
    total = 12 + 8 + len(text) + 8 + len(binary)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, total),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(binary), b"BIN\0"),
            binary,
        ]
    )
