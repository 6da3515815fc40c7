"""Triangle meshes: in memory, from and to files."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path

import numpy as np

from geraf2 import __version__
from geraf2._memory import require_memory
from geraf2._short import Short
from geraf2._types import AnyPath, Array, Bytes, Floats, Ints
from geraf2._validation import require_shape
from geraf2.errors import UserError
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import used_vertices
from geraf2.io.atomic import write_bytes_atomic, write_text_atomic
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.mesh_colours import error_colours
from geraf2.io.mesh_formats import parse_obj, parse_ply
from geraf2.io.objects import is_remote, local_copy
from geraf2.io.points import ply_file
from geraf2.io.regular import BINARY_BYTES, RECORD_BYTES, read_regular, require_regular
from geraf2.io.text import parse_json
from geraf2.io.trimesh_formats import FRAME_FROM_GLTF, glb_bytes, parse_gltf, parse_stl, stl_bytes

READABLE_SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf")
"""Mesh formats that `read_mesh` accepts."""
WRITABLE_SUFFIXES = (".ply", ".glb", ".stl")
"""Mesh formats of `write_mesh`."""

# Text is parsed into objects: a PLY of 130 MB took 1.3 GB, an OBJ of 30 MB .5 GB.
_BYTES_PER_BYTE = {".obj": 20.0}
# Vertices beyond are refused: ray queries in single precision take no more.
_MAX_COORDINATE_M = 1e6


VERTEX_COLUMNS = {
    "expected_error_m": "<f4",
    "evidence": "u1",
    "confidence": "<f4",
    "reflectivity_db": "<f4",
}
"""What a mesh may hold of each vertex, and its type in a file."""


class Evidence(IntEnum):
    """Evidence of a vertex of a reconstructed surface."""

    NOT_SEEN = 0
    """Nothing near: the surface is guessed."""
    OUTLINE = 1
    """The edge of the content's shadow on the box's far walls."""
    SEEN = 2
    """An echo from there, with a matching direction."""

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TriangleMesh(Short):
    """Triangles in metres; outward winding where closed.

    Raises
    ------
    ValueError
        For arrays of other shapes than stated below.

    Examples
    --------
    >>> capture, truth = geraf2.examples.small_capture()
    >>> truth.vertices.shape[1], truth.faces.shape[1], truth.corners.shape[1:]
    (3, 3, (3, 3))
    """

    vertices: Floats
    """(n_vertices, 3) [m]."""
    faces: Ints
    """Vertex indices, counter-clockwise from outside, (n_faces, 3)."""
    expected_error_m: Floats | None = None
    """One standard deviation of each vertex's distance to the true surface, (n_vertices,) [m]."""
    evidence: Bytes | None = None
    """Evidence of each vertex, as `Evidence`, (n_vertices,)."""
    confidence: Floats | None = None
    """Probability that the piece of each vertex exists, (n_vertices,)."""
    reflectivity_db: Floats | None = None
    """Amplitude of returns against metal, NaN where none came from, (n_vertices,) [dB]."""

    def __post_init__(self) -> None:
        require_shape("vertices", self.vertices, (None, 3))
        require_shape("faces", self.faces, (None, 3))
        for name in VERTEX_COLUMNS:
            if getattr(self, name) is not None:
                require_shape(name, getattr(self, name), (self.vertices.shape[0],))

    @property
    def corners(self) -> Floats:
        """Of each triangle, (n_faces, 3, 3) [m]."""
        return self.vertices[self.faces]

    @classmethod
    def joined(cls, meshes: Sequence["TriangleMesh"]) -> "TriangleMesh":
        """One mesh of the triangles of several, without their errors and evidence."""
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        return cls(
            vertices=np.concatenate([mesh.vertices for mesh in meshes]),
            faces=np.concatenate([m.faces + n for m, n in zip(meshes, starts[:-1], strict=True)]),
        )

    def moved(self, transform: Floats) -> "TriangleMesh":
        """Mesh after a rigid transform, (4, 4)."""
        return replace(self, vertices=apply_rigid(transform, self.vertices))

    def with_faces(self, faces: Ints) -> "TriangleMesh":
        """Mesh of other faces between the vertices, of which only those in use are kept."""
        used, renumbered = used_vertices(faces)
        columns = {name: getattr(self, name) for name in VERTEX_COLUMNS}
        return TriangleMesh(
            vertices=self.vertices[used],
            faces=renumbered,
            **{name: None if of is None else of[used] for name, of in columns.items()},
        )


def read_mesh(path: AnyPath, *, any_unit: bool = False) -> TriangleMesh:
    """Read a PLY, OBJ, STL or glTF mesh.

    Vertices at exactly the same position become one. Faces that thereby lose their area, and
    vertices that no face uses, are dropped: many writers repeat a vertex per face, and a closed
    surface would not be closed. glTF files are +Y up by their standard and are turned to +Z up.

    Parameters
    ----------
    path
        File. Coordinates are taken as metres.
    any_unit
        The caller knows the unit, whatever `<path>.json` states; else that must be metres.

    Returns
    -------
    TriangleMesh
        Vertices (n_vertices, 3) [m] and faces (n_faces, 3); of a PLY also the vertex columns of
        `VERTEX_COLUMNS`.

    Raises
    ------
    UserError
        For anything that is not a usable mesh: another kind of file, one that is cut off, no
        triangles, coordinates that are not finite or beyond a thousand kilometres.

    Examples
    --------
    >>> from geraf2.io.mesh import read_mesh, write_mesh
    >>> write_mesh(geraf2.examples.small_capture()[1], "truth.glb")
    >>> read_mesh("truth.glb").vertices.shape[1]
    3
    """
    source = Path(path)
    if is_remote(source):
        try:
            with local_copy(source) as copy:
                return read_mesh(copy, any_unit=any_unit)
        except OSError as error:
            what = f"cannot be read: {error.strerror}"
            raise UserError(what=what, where=source) from error
    _require_readable(source)
    needed = _BYTES_PER_BYTE.get(source.suffix.lower(), 12.0) * source.stat().st_size
    require_memory(needed, "use a mesh of fewer triangles", where=source)
    if not any_unit:
        _require_metres(source)
    loaded = _load(source)
    vertices, faces = loaded.vertices, loaded.faces
    if faces.shape[0] == 0:
        raise UserError(
            what="the mesh has no triangles",
            where=source,
            hint="is it a point cloud, or was the file cut off?",
        )
    if not np.isfinite(vertices).all():
        n_bad = int((~np.isfinite(vertices).all(axis=1)).sum())
        raise UserError(
            what="vertex coordinates must be finite",
            where=source,
            got=f"{n_bad} of {len(vertices)} vertices with NaN or infinity",
        )
    if np.abs(vertices).max(initial=0.0) > _MAX_COORDINATE_M:
        raise UserError(
            what=f"vertex coordinates reach {np.abs(vertices).max():.3g} m",
            where=source,
            expected=f"at most {_MAX_COORDINATE_M:g} m",
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise UserError(
            what="a face names a vertex that is not there",
            where=source,
            expected=f"indices 0 to {len(vertices) - 1}",
            got=f"{int(faces.min())} to {int(faces.max())}",
            hint="the file may be cut off",
        )
    mesh = merge_duplicate_vertices(loaded)
    if mesh.faces.shape[0] == 0:
        raise UserError(what="every triangle of the mesh has zero area", where=source)
    return mesh


def merge_duplicate_vertices(mesh: TriangleMesh) -> TriangleMesh:
    """Mesh with one vertex per position, without faces of no area and unused vertices.

    Positions are compared exactly: a tolerance would weld thin walls.
    """
    _, first, inverse = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    # Keep the order of first appearance, so that a clean mesh comes back as it was.
    faces = first[inverse.reshape(-1)][mesh.faces]
    distinct = (
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    )
    return mesh.with_faces(faces[distinct])


def write_mesh(
    mesh: TriangleMesh,
    path: AnyPath,
    *,
    frame: str = "capture",
    made_from: Mapping[str, str] | None = None,
) -> None:
    """Write a binary PLY, GLB or STL in metres, and `<path>.json` that describes it.

    PLY: float x, y, z [m] in the frame, uchar red, green, blue, and where the mesh has them
    float `expected_error_m` [m], uchar `evidence` (`Evidence`), float `confidence`, and `quality`,
    which viewers colour by: the expected error again. GLB: the same numbers but `quality`, turned
    to glTF's +Y up by the node's transform, vertex normals and colours, and `_EXPECTED_ERROR_M`,
    `_EVIDENCE` and `_CONFIDENCE`, all float. STL: only triangles. The colour shows the expected
    error (blue 0, dark red 5 mm), grey without one.

    Parameters
    ----------
    mesh
        Vertices in metres.
    path
        Name that ends in .ply, .glb or .stl. Each file appears whole or not at all.
    frame
        Name of the frame of the vertices.
    made_from
        What the mesh was made from, and by which command; recorded in PLY, GLB and `<path>.json`.

    Raises
    ------
    UserError
        For another ending, or where the file cannot be written.

    Examples
    --------
    >>> from geraf2.io.mesh import write_mesh
    >>> write_mesh(geraf2.examples.small_capture()[1], "truth.ply", frame="turntable")
    """
    target, made_from = Path(path), made_from or {}
    suffix, known = target.suffix.lower(), _known_columns(mesh)
    if suffix == ".ply":
        data = ply_bytes(mesh, frame, made_from)
        frame_from_file = np.eye(4)
        columns = ["x [m]", "y [m]", "z [m]", "red", "green", "blue", *known]
        columns += ["quality"] if "expected_error_m" in known else []
    elif suffix == ".glb":
        colours = error_colours(mesh.expected_error_m, len(mesh.vertices))
        data = glb_bytes(mesh.vertices, mesh.faces, colours, known, made_from)
        # Coordinates as a glTF reader places them, after the node's rotation.
        frame_from_file = FRAME_FROM_GLTF
        columns = ["POSITION [m]", "NORMAL", "COLOR_0", *(f"_{name.upper()}" for name in known)]
    elif suffix == ".stl":
        data = stl_bytes(mesh.vertices, mesh.faces)
        frame_from_file, columns = np.eye(4), ["x [m]", "y [m]", "z [m]"]
    else:
        expected = f"a name ending in {' or '.join(WRITABLE_SUFFIXES)}"
        raise UserError(what="unknown mesh format", where=target, expected=expected)
    write_bytes_atomic(target, data)
    sidecar = {
        "format": "geraf2-mesh",
        "format_version": 1,
        "generator": f"geraf2 {__version__}",
        "file": target.name,
        "unit": "metre",
        "frame": frame,
        "frame_from_file": frame_from_file.tolist(),
        "n_vertices": int(mesh.vertices.shape[0]),
        "n_faces": int(mesh.faces.shape[0]),
        "bounds_m": [mesh.vertices.min(axis=0).tolist(), mesh.vertices.max(axis=0).tolist()]
        if len(mesh.vertices)
        else None,
        "vertex_columns": columns,
        "winding": "counter-clockwise seen from outside",
        **({"made_from": dict(made_from)} if made_from else {}),
    }
    write_text_atomic(target.with_name(target.name + ".json"), json.dumps(sidecar, indent=2) + "\n")


def _known_columns(mesh: TriangleMesh) -> dict[str, Array]:
    """Columns of the vertices besides positions, by name, in the types of a file."""
    values = {name: getattr(mesh, name) for name in VERTEX_COLUMNS}
    return {n: of.astype(VERTEX_COLUMNS[n]) for n, of in values.items() if of is not None}


def _require_readable(source: Path) -> None:
    try:
        require_regular(source, BINARY_BYTES)
    except FileNotFoundError:
        raise UserError(what="the mesh file does not exist", where=source) from None
    except IsADirectoryError:
        raise UserError(what="a mesh file is needed", where=source, got="a folder") from None
    if source.suffix.lower() not in READABLE_SUFFIXES:
        raise UserError(
            what="unknown mesh format",
            where=source,
            expected=", ".join(READABLE_SUFFIXES),
            got=source.suffix or "a name without extension",
        )
    if source.stat().st_size == 0:
        raise UserError(what="the mesh file is empty", where=source)
    refuse_other_kind(source)


def _require_metres(source: Path) -> None:
    """Refuse a mesh whose sidecar states another unit."""
    try:
        about = parse_json(read_regular(source.with_name(source.name + ".json"), RECORD_BYTES))
    except (OSError, ValueError):  # none, or not ours
        return
    unit = about.get("unit") if isinstance(about, dict) else None
    if unit not in (None, "m", "metre", "metres", "meter", "meters"):
        raise UserError(
            what=f"is in another unit, as {source.name}.json states",
            where=source,
            expected="metre",
            got=repr(unit)[:40],
            hint="convert it, e.g. with 'geraf2 los MESH OUT --unit mm'",
        )


def _load(source: Path) -> TriangleMesh:
    parse = _PARSERS.get(source.suffix.lower())
    try:
        data = read_regular(source, BINARY_BYTES)
        raw = parse_gltf(data, source) if parse is None else parse(data)
    except (MemoryError, UserError):
        raise
    except Exception as error:
        # Readers of foreign formats raise many types; all mean the same to the user.
        reason = str(error).strip().splitlines() or [type(error).__name__]
        raise UserError(
            what=f"cannot read the mesh: {reason[0]}",
            where=source,
            hint="the file may be cut off or in another format than its name suggests",
        ) from error
    return TriangleMesh(vertices=raw.vertices, faces=raw.faces, **_stored_columns(raw.columns))


_PARSERS = {".obj": parse_obj, ".stl": parse_stl, ".ply": parse_ply}


def _stored_columns(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns of the vertices that `write_mesh` writes, where their values fit."""
    found: dict[str, Array] = {}
    error, evidence = columns.get("expected_error_m"), columns.get("evidence")
    if error is not None and (np.isfinite(error) & (error >= 0)).all():
        found["expected_error_m"] = np.asarray(error, dtype=np.float64)
    if evidence is not None and np.isin(evidence, tuple(Evidence)).all():
        found["evidence"] = np.asarray(evidence, dtype=np.uint8)
        confidence = columns.get("confidence")  # means something else in files of others
        if confidence is not None and ((confidence >= 0) & (confidence <= 1)).all():
            found["confidence"] = np.asarray(confidence, dtype=np.float64)
    if "reflectivity_db" in columns:
        found["reflectivity_db"] = np.asarray(columns["reflectivity_db"], dtype=np.float64)
    return found


def ply_bytes(mesh: TriangleMesh, frame: str, made_from: Mapping[str, str]) -> bytes:
    """Bytes of the PLY that `write_mesh` writes."""
    colours = error_colours(mesh.expected_error_m, len(mesh.vertices))
    columns: dict[str, Array] = {axis: mesh.vertices[:, k] for k, axis in enumerate("xyz")}
    columns |= {name: colours[:, k] for k, name in enumerate(("red", "green", "blue"))}
    columns |= _known_columns(mesh)
    if mesh.expected_error_m is not None:  # once more, under the name that viewers colour by
        columns["quality"] = mesh.expected_error_m
    made = (f"geraf2 {' '.join(f'{name} {of}'.split())}" for name, of in made_from.items())
    comments = (f"geraf2 {__version__}", *made, "unit metre", f"frame {' '.join(frame.split())}")
    return ply_file(columns, comments, mesh.faces)
