"""Limits of meshes that are read: small files that unpack to any size are refused before."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from geraf2._memory import require_memory
from geraf2.errors import UserError
from geraf2.io.text import parse_json

MAX_NODES = 10_000
"""Objects of a glTF scene; each is placed by itself."""
# Text is parsed into objects: a PLY of 130 MB took 1.3 GB, an OBJ of 30 MB .5 GB.
_BYTES_PER_BYTE = {".ply": 12.0, ".stl": 12.0, ".obj": 20.0}
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Largest value of normalised integers, which stands for 1.
_LARGEST = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}
_JSON_CHUNK = b"JSON"
_APPEARANCE = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
"""Beginnings of the names of glTF extensions that leave vertices as they are."""
_QUANTIZED = "KHR_mesh_quantization"


def require_mesh_size(source: Path) -> None:
    """Raise UserError for a mesh that takes more memory than is free."""
    needed = _BYTES_PER_BYTE.get(source.suffix.lower(), 12.0) * source.stat().st_size
    require_memory(needed, "use a mesh of fewer triangles", where=source)


def require_gltf_content(data: bytes, where: Path) -> bytes:
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
