"""Limits of meshes that are read: small files that unpack to any size are refused before."""

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
_JSON_CHUNK = b"JSON"
_APPEARANCE = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
"""Beginnings of the names of glTF extensions that leave vertices as they are."""


def require_mesh_size(source: Path) -> None:
    """Raise UserError for a mesh that takes more memory than is free."""
    needed = _BYTES_PER_BYTE.get(source.suffix.lower(), 12.0) * source.stat().st_size
    require_memory(needed, "use a mesh of fewer triangles", where=source)


def require_gltf_content(data: bytes, where: Path) -> None:
    """Raise UserError for the bytes of a glTF or GLB that cannot be read rightly.

    Those are files with compressed or quantised vertices, with objects that repeat, or without
    the data that they state.
    """
    if where.suffix.lower() == ".glb":
        end = 20 + int.from_bytes(data[12:16], "little")
        data = data[20:end] if data[16:20] == _JSON_CHUNK else b""
    try:
        content = parse_json(data)
        unread = [e for e in content.get("extensionsRequired", ()) if not e.startswith(_APPEARANCE)]
        what = "" if unread else _complaint(content)
    except (ValueError, LookupError, TypeError, AttributeError):
        return  # the reader states what is wrong
    if unread:
        raise UserError(
            what=f"needs {', '.join(unread)}, which is not read",
            where=where,
            hint="export it without compression and quantization of vertices",
        )
    if what:
        raise UserError(what=what, where=where)


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
            return f"accessor {number} has no data"
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
