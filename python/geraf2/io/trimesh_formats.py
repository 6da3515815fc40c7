"""STL, GLB and glTF by trimesh, from bytes to bytes: it opens no file but a glTF's own buffers.

ValueError states what is wrong with the bytes. A small glTF that unpacks to any size, or that
trimesh would read wrongly, is refused or changed before.
"""

import json
import re
import struct
from collections import Counter
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from geraf2 import __version__
from geraf2._memory import require_memory
from geraf2._types import Array, Bytes, Floats, Ints
from geraf2.errors import UserError
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh_colours import to_linear
from geraf2.io.mesh_formats import RawMesh
from geraf2.io.regular import BINARY_BYTES, read_regular
from geraf2.io.text import parse_json

FRAME_FROM_GLTF = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
"""Axes of the file in the frame, as columns: glTF is +Y up by its standard, frames are +Z up."""
_STL_HEAD, _STL_FACET = 84, 50
MAX_NODES = 10_000
"""Objects of a glTF scene; each is placed by itself."""
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Largest value of normalised integers, which stands for 1.
_LARGEST = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}
_JSON_CHUNK = b"JSON"
_APPEARANCE = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
"""Beginnings of the names of glTF extensions that leave vertices as they are."""
_QUANTIZED = "KHR_mesh_quantization"
_MATERIAL = {
    "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
    "doubleSided": True,
}


class _Beside:
    """Reads the buffers of a glTF, which lie beside it or below, for trimesh."""

    def __init__(self, mesh: Path) -> None:
        self.mesh = mesh

    def __getitem__(self, name: str) -> bytes:
        folder, path = self.mesh.parent.resolve(), (self.mesh.parent / name).resolve()
        if not path.is_relative_to(folder):
            raise UserError(what="names a file outside its folder", where=self.mesh, got=repr(name))
        return read_regular(path, BINARY_BYTES)

    get = __getitem__


def parse_gltf(data: bytes, source: Path) -> RawMesh:
    """Mesh of a glTF or GLB, which is +Y up, turned to +Z up.

    source: its name, beside which the buffers lie.
    """
    raw = _load(_readable_gltf(data, source), source.suffix.lower()[1:], _Beside(source))
    return RawMesh(vertices=raw.vertices @ FRAME_FROM_GLTF[:3, :3].T, faces=raw.faces)


def _readable_gltf(data: bytes, where: Path) -> bytes:
    """Bytes of a glTF or GLB whose vertices are not normalised integers but in the node's units.

    UserError for one that cannot be read rightly: with compressed vertices, with objects that
    repeat, or without the data that it states.
    """
    is_glb = where.suffix.lower() == ".glb"
    end = 20 + int.from_bytes(data[12:16], "little")
    text = data[20:end] if data[16:20] == _JSON_CHUNK else b""
    try:
        content = parse_json(text if is_glb else data)
        names = content.get("extensionsRequired", ())
        unread = [e for e in names if not e.startswith((*_APPEARANCE, _QUANTIZED))]
        what = "" if unread else _complaint(content)
        scaled = not (unread or what) and _scale_normalised(content)
    except (ValueError, LookupError, TypeError, AttributeError):
        return data  # the reader states what is wrong
    if unread:
        raise UserError(
            what=f"needs {', '.join(unread)}, which is not read",
            where=where,
            hint="export it without compression of vertices, and without instances",
        )
    if what:
        raise UserError(what=what, where=where)
    if not scaled:
        return data
    text = json.dumps(content).encode()
    if not is_glb:
        return text
    text += b" " * (-len(text) % 4)
    n_bytes = len(data) - (end - 20) + len(text)
    sizes = [n.to_bytes(4, "little") for n in (n_bytes, len(text))]
    return data[:8] + sizes[0] + sizes[1] + _JSON_CHUNK + text + data[end:]


def _scale_normalised(content: dict[str, Any]) -> bool:
    """Scale the nodes of meshes with normalised integers, which trimesh takes as they are stored.

    UserError for a mesh of several types.
    """
    nodes = content.get("nodes", [])
    found = False
    for node in list(nodes):
        primitives = content["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ()
        used = [content["accessors"][one["attributes"]["POSITION"]] for one in primitives]
        scales = {_LARGEST[a["componentType"]] if a.get("normalized") else 1 for a in used}
        if scales <= {1}:
            continue
        if len(scales) > 1:
            msg = "the primitives of a mesh have different types"
            raise UserError(what=msg)
        found = True
        node["children"] = [*node.get("children", ()), len(nodes)]
        nodes.append({"mesh": node.pop("mesh"), "scale": [1 / scales.pop()] * 3})
    return found


def _complaint(content: Mapping[str, Any]) -> str:
    """Reason to refuse a glTF; empty where there is none."""
    nodes = content.get("nodes", [])
    if len(nodes) > MAX_NODES:
        return f"has {len(nodes)} objects, more than {MAX_NODES}: join them"
    parents = Counter(child for node in nodes for child in node.get("children", ()))
    if any(n > 1 for n in parents.values()):
        return "an object has two parents, which glTF does not allow"
    views = content.get("bufferViews", [])
    for number, accessor in enumerate(content.get("accessors", [])):
        if "bufferView" not in accessor:
            used = ", ".join(content.get("extensionsUsed", ()))
            return f"accessor {number} has no data{f', and {used} is not read' if used else ''}"
        size = _COMPONENT_BYTES[accessor["componentType"]] * _COMPONENTS[accessor["type"]]
        if accessor["count"] * size > views[accessor["bufferView"]]["byteLength"]:
            return f"accessor {number} is longer than its data"
    meshes = [_n_indices(mesh, content["accessors"]) for mesh in content.get("meshes", [])]
    n_placed = sum(meshes[node["mesh"]] for node in nodes if "mesh" in node)
    require_memory(100.0 * n_placed, "join its objects, or use fewer")
    return ""


def _n_indices(mesh: Mapping[str, Any], accessors: list[Any]) -> int:
    parts = mesh["primitives"]
    used = [part.get("indices", part["attributes"].get("POSITION")) for part in parts]
    return sum(accessors[index]["count"] for index in used if index is not None)


def parse_stl(data: bytes) -> RawMesh:
    """Mesh of an STL, text or binary, whose triangles are all there.

    Some binary files begin with 'solid', state 0 or -1 triangles, or hold more behind the last;
    trimesh takes these for text, so it is given their triangles alone.
    """
    if _is_text_stl(data):
        n_facets = len(re.findall(rb"\bouter\s+loop\b", data, re.IGNORECASE))
    elif len(data) < _STL_HEAD:
        msg = "it is neither text nor long enough for a binary STL"
        raise ValueError(msg)
    else:
        (n_facets,) = struct.unpack_from("<I", data, _STL_HEAD - 4)
        n_there = (len(data) - _STL_HEAD) // _STL_FACET
        if n_facets in (0, 0xFFFFFFFF):
            n_facets = n_there
        if n_facets > n_there:
            raise _lacks_facets(n_facets, n_there)
        end = _STL_HEAD + n_facets * _STL_FACET
        data = bytes(_STL_HEAD - 4) + struct.pack("<I", n_facets) + data[_STL_HEAD:end]
    raw = _load(data, "stl")
    if len(raw.faces) != n_facets:
        raise _lacks_facets(n_facets, len(raw.faces))
    return raw


def _lacks_facets(n_stated: int, n_read: int) -> ValueError:
    return ValueError(f"it states {n_stated} triangles, {n_read} can be read")


def _is_text_stl(data: bytes) -> bool:
    head = data[:4096].lstrip().lower()
    if not head.startswith(b"solid") or b"\0" in head:
        return False
    return b"facet" in head or b"endsolid" in head


def _load(data: bytes, kind: str, resolver: _Beside | None = None) -> RawMesh:
    import trimesh  # noqa: PLC0415 - takes 0.3 s to import, needed only here

    loaded = trimesh.load(
        BytesIO(data),
        kind,
        resolver=resolver,
        force="mesh",
        process=False,
        skip_materials=True,  # they name further files, and pictures that start programs
    )
    vertices = np.array(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    return RawMesh(vertices=vertices, faces=np.array(loaded.faces, dtype=np.int64).reshape(-1, 3))


def stl_bytes(vertices: Floats, faces: Ints) -> bytes:
    """Binary STL of a mesh; vertices (n_vertices, 3) [m], faces (n_faces, 3)."""
    import trimesh  # noqa: PLC0415 - as in _load

    return bytes(trimesh.Trimesh(vertices, faces, process=False).export(file_type="stl"))


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
    import trimesh  # noqa: PLC0415 - as in _load

    # glTF vertex colours are linear light, the palette is sRGB (gamma close to 2.2).
    colours = np.full((len(vertices), 4), 255, dtype=np.uint8)
    colours[:, :3] = np.rint(255.0 * to_linear(srgb / 255.0))
    normals = vertex_normals(vertices, faces)
    # glTF asks for unit normals everywhere; a vertex without area gets an arbitrary one.
    normals[~np.any(normals, axis=1)] = (0.0, 0.0, 1.0)
    mesh = trimesh.Trimesh(
        vertices,
        faces,
        process=False,
        vertex_normals=normals if len(normals) else None,
        vertex_colors=colours,
        # glTF takes no wider integers here, and bytes would have to be padded.
        vertex_attributes={f"_{name.upper()}": of.astype("<f4") for name, of in columns.items()},
    )

    def describe(tree: dict[str, Any]) -> None:
        tree["asset"]["generator"] = f"geraf2 {__version__}"
        if made_from:
            tree["asset"]["extras"] = {"made_from": dict(made_from)}
        tree["materials"] = [_MATERIAL]
        for one in tree.get("meshes", ()):
            one["primitives"][0]["material"] = 0

    scene = trimesh.Scene()
    scene.add_geometry(mesh, "surface", "surface", transform=FRAME_FROM_GLTF.T)
    data = scene.export(file_type="glb", include_normals=True, tree_postprocessor=describe)
    return bytes(data)
