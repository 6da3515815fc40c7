"""Scene of the 3D view: meshes, glints and planes as quantised numbers in JSON."""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Array, Bytes, Floats, Ints
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.components import face_labels
from geraf2.geometry.triangles import closed_edges, face_areas
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.io.mesh_colours import ERROR_COLOURS, WORST_SHOWN_M, worst_shown_m
from geraf2.report.canvas import BLUE, GLINT_COLOUR, RED, SKY, TRUTH_COLOUR, load_matplotlib
from geraf2.report.render import MeshPainter
from geraf2.report.view_layers import BoxFace, Volume, coarsen
from geraf2.surfaces.expected_error import SEEN_ANGLE_RAD, SEEN_REACH_M, seen_vertices
from geraf2.surfaces.isosurface import signed_distances

# With these limits a page stays below 3 MB: 60,000 triangles take 0.8 MB with four attributes.
MAX_CONTENT_FACES = 60_000
_MAX_TRUTH_FACES = 30_000
_MAX_BOX_FACES = 4_000
_MAX_GLINTS = 15_000
_CONTENT_COLOUR, _BOX_COLOUR = "#b9c0c7", "#b08d57"  # of metal, of cardboard
PART_COLOURS = ("#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#F0E442", "#0072B2", "#D55E00")
_EVIDENCE_COLOURS = (RED, "#009E73", SKY)
_N_COLOURS = 17  # of a scale; the view interpolates
_BOX_OPACITY, _TRUTH_OPACITY, _PLANE_OPACITY = 0.2, 0.45, 0.6
_GLINT_RADIUS_M = 0.0009
_GLINT_RANGE_DB = 30.0

NO_WEBGL = "The view in 3D needs JavaScript and WebGL2, which this browser does not offer here."
"""Text in place of a view."""
NOTHING = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
"""Content of a view without one."""


def rgb(colour: str) -> list[int]:
    """Red, green and blue of a colour as "#rrggbb", 0 to 255."""
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Attribute:
    """Values of the vertices, with their colours and units."""

    label: str
    """Name in the list."""
    values: Floats
    """Values in `unit`, or numbers of classes, (n_vertices,)."""
    unit: str = ""
    limits: tuple[float, float] = (0.0, 1.0)
    """Values at the ends of the scale."""
    colour_map: str = "viridis"
    """Name of a colour map of matplotlib."""
    digits: int = 2
    """Number of decimals."""
    sides: tuple[str, str] | None = None
    """Words for values below and above zero, instead of a sign."""
    classes: tuple[str, ...] = ()
    """Names, where values are numbers of classes."""
    colours: tuple[str, ...] = ()
    """Of the classes in order, or along the scale in place of `colour_map`."""
    note: str = ""
    """Explanation."""


def content_attributes(
    content: TriangleMesh,
    *,
    glints: Glints | None = None,
    box: TriangleMesh | None = None,
    distances_m: Floats | None = None,
    num_threads: int | None = None,
) -> list[Attribute]:
    """Attributes of the vertices of the content; the first is the initial colouring.

    glints: define the seen vertices. box: defines the depth.
    distances_m: signed distance to the truth, (n_vertices,) [m].
    """
    found: list[Attribute] = []
    if content.expected_error_m is not None:
        found.append(expected_error(content.expected_error_m))
    if distances_m is not None:
        found.append(_error(1e3 * np.asarray(distances_m)))
    seen = seen_vertices(content, glints)
    if content.evidence is not None:
        found.append(_evidence(content.evidence))
    elif seen is not None:
        found.append(
            Attribute(
                label="seen by the radar",
                values=seen.astype(np.float64),
                classes=("not seen", "seen"),
                colours=(RED, SKY),
                note="Not seen: no echo came from there; the surface is guessed.",
            )
        )
    if box is not None and box.faces.shape[0]:
        labels, n_parts = face_labels(box.faces)
        pieces = [box.with_faces(box.faces[labels == piece]) for piece in range(n_parts)]
        # The piece of the largest extent: without the inner sides of the walls.
        outside = max(pieces, key=lambda piece: float(np.prod(np.ptp(piece.vertices, axis=0))))
        depth = -1e3 * signed_distances(outside, content.vertices, num_threads=num_threads)
        limits = (float(np.floor(depth.min())), float(np.ceil(depth.max())))
        note = "From the nearest point of the box's outside."
        found.append(
            Attribute(
                label="depth in the box",
                values=depth,
                unit="mm",
                limits=limits if limits[1] > limits[0] else (limits[0], limits[0] + 1.0),
                colour_map="cividis",
                digits=1,
                note=note,
            )
        )
    parts = _parts(content)
    return [*found, *parts]


def expected_error(error_m: Floats) -> Attribute:
    """Attribute of the expected error of vertices, (n_vertices,) [m]."""
    return Attribute(
        label="expected error",
        values=1e3 * error_m,
        unit="mm",
        limits=(0.0, 1e3 * worst_shown_m(error_m)),
        colours=ERROR_COLOURS,
        note="One standard deviation of the distance to the true surface.",
    )


def _evidence(evidence: Bytes) -> Attribute:
    return Attribute(
        label="rests on",
        values=evidence.astype(np.float64),
        classes=tuple(map(str, Evidence)),
        colours=_EVIDENCE_COLOURS,
        note=(
            "Seen: echoes came from there. Outline: the edge of a shadow on the box's walls. "
            "Not seen: neither; the surface is guessed."
        ),
    )


def _error(error_mm: Floats) -> Attribute:
    """Signed distance to the truth [mm], on a scale that covers 98 % of it."""
    spread = float(np.quantile(np.abs(error_mm), 0.98)) if error_mm.size else 1.0
    high = next((step for step in (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0) if step >= spread), 50.0)
    return Attribute(
        label="distance to the truth",
        values=error_mm,
        unit="mm",
        limits=(-high, high),
        colour_map="RdBu_r",
        sides=("inside it", "outside it"),
        note="Blue lies inside the true surface, red outside.",
    )


def _parts(content: TriangleMesh) -> list[Attribute]:
    """Attribute of connected parts, the largest first; empty for a single part."""
    labels, n_parts = face_labels(content.faces)
    if n_parts < 2:
        return []
    areas = np.bincount(labels, face_areas(content.corners), minlength=n_parts)
    rank = np.empty(n_parts, dtype=np.int64)
    rank[np.argsort(-areas, kind="stable")] = np.arange(n_parts)
    of_vertex = np.zeros(content.vertices.shape[0])
    of_vertex[content.faces] = rank[labels][:, None]
    shares = 100.0 * np.sort(areas)[::-1] / areas.sum()
    names = tuple(f"part {n} ({share:.0f} % of the area)" for n, share in enumerate(shares, 1))
    return [Attribute(label="part", values=of_vertex, classes=names, colours=PART_COLOURS)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Other:
    """A further surface of a view."""

    label: str
    colour: str
    opacity: float
    mesh: TriangleMesh
    """Triangles [m]."""
    is_reference: bool = False
    """What the content is compared with, on the other side of the wiper."""
    is_visible: bool = True
    """Whether the view begins with it; two surfaces at the same position show in patches."""
    groups: Ints | None = None
    """Group of each vertex, if the view can move groups apart, (n_vertices,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Apart:
    """How far each group of vertices moves in the exploded view."""

    groups: Ints
    """Group of each vertex of the content, (n_vertices,)."""
    offsets_m: Floats
    """Largest displacement of each group, (n_groups, 3) [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Around:
    """What a view shows beside the content."""

    box: TriangleMesh | None = None
    truth: TriangleMesh | None = None
    others: Sequence[Other] = ()
    glints: Glints | None = None
    planes_m: Floats | None = None
    """Corners of the planes of antennas, (n_planes, 4, 3) [m]."""
    faces: Sequence[BoxFace] = ()
    """Of the box that the scan shows, in place of `box` at first."""
    volumes: Sequence[Volume] = ()
    """Shown as slices."""


def view_scene(
    content: TriangleMesh,
    attributes: Sequence[Attribute] = (),
    around: Around | None = None,
    *,
    name: str = "view",
    apart: Apart | None = None,
) -> dict[str, Any]:
    """Scene of the 3D view, lengths in millimetres, arrays in base64.

    content: surface [m]; thinned to MAX_CONTENT_FACES triangles, with a note.
    attributes: of its vertices. around: what is shown beside it. name: of saved pictures.
    apart: groups of its vertices for the exploded view.
    """
    around = around or Around()
    box, truth, glints, planes_m = around.box, around.truth, around.glints, around.planes_m
    thin, kept, note = _thin_with_note(content, MAX_CONTENT_FACES, "content")
    shown = _mesh(thin, "content", _CONTENT_COLOUR, note=note)
    if thin.faces.shape[0]:
        shade = MeshPainter(thin).ambient
        shown["shade"] = encode_integers(np.round(255.0 * np.clip(shade, 0.0, 1.0)).astype("<u1"))
    shown["attributes"] = [_attribute(attribute, kept) for attribute in attributes]
    shown["groups"] = _groups(apart.groups if apart else None, kept)
    meshes = [shown]
    if truth is not None and truth.faces.shape[0]:
        thin, _, note = _thin_with_note(truth, _MAX_TRUTH_FACES, "truth")
        options = {"visible": False, "opacity": _TRUTH_OPACITY, "note": note, "reference": True}
        meshes.append(_mesh(thin, "truth", TRUTH_COLOUR, **options))
    for other in around.others:
        thin, kept, note = _thin_with_note(other.mesh, _MAX_TRUTH_FACES, other.label)
        options = {"opacity": other.opacity, "note": note, "reference": other.is_reference}
        options["visible"] = other.is_visible
        options["groups"] = _groups(other.groups, kept)
        meshes.append(_mesh(thin, other.label, other.colour, **options))
    if box is not None and box.faces.shape[0]:
        thin, _, note = _thin_with_note(box, _MAX_BOX_FACES, "box")
        options = {"opacity": _BOX_OPACITY, "walls": True, "edges": True, "note": note}
        options |= {"visible": not around.faces}
        meshes.append(_mesh(thin, "box", _BOX_COLOUR, **options))
    scene: dict[str, Any] = {"format": "geraf2-view", "version": 1, "name": name, "meshes": meshes}
    if apart is not None:
        scene["apart"] = np.round(1e3 * apart.offsets_m, 2).tolist()
    if glints is not None and len(glints):
        scene["glints"] = _glints(glints)
    if planes_m is not None and len(planes_m):
        scene["planes"] = {
            "label": "antenna planes",
            "colour": BLUE,
            "visible": False,
            "opacity": _PLANE_OPACITY,
            "corners": np.round(1e3 * planes_m, 2).tolist(),
        }
    if around.faces:
        scene["faces"] = _faces(around.faces)
    scene["volumes"] = [_volume(volume) for volume in around.volumes]
    return scene


def scene_json(scene: dict[str, Any]) -> str:
    """JSON for use inside a script element."""
    return json.dumps(scene, separators=(",", ":")).replace("<", "\\u003c")


def thin_mesh(vertices: Floats, faces: Ints, max_faces: int) -> tuple[Ints, Ints]:
    """Reduce triangles for a view: vertices of a cell become the one nearest to their mean.

    The error is that of chords of the length of a cell.

    Returns the kept vertices as indices, (n_kept,), and faces between them, at most `max_faces`.
    """
    if len(faces) <= max_faces:
        return np.arange(len(vertices)), faces
    low, corners = vertices.min(axis=0), vertices[faces]
    cell = float(np.sqrt(2.0 * face_areas(corners).sum() / max_faces))
    while True:
        cells = np.floor((vertices - low) / cell).astype(np.int64)
        _, cluster = np.unique(cells, axis=0, return_inverse=True)
        cluster = cluster.reshape(-1)
        joined = cluster[faces]
        a, b, c = joined.T
        joined = joined[(a != b) & (b != c) & (c != a)]
        if len(joined) <= max_faces:
            break
        cell *= max(1.03, float(np.sqrt(len(joined) / max_faces)))
    counts = np.bincount(cluster)
    means = [np.bincount(cluster, vertices[:, d]) / counts for d in range(3)]
    off = np.linalg.norm(vertices - np.stack(means, axis=1)[cluster], axis=1)
    order = np.lexsort((off, cluster))
    nearest = order[np.r_[True, np.diff(cluster[order]) > 0]]
    used, renumbered = np.unique(joined, return_inverse=True)
    return nearest[used], renumbered.reshape(joined.shape)


def _thin_with_note(mesh: TriangleMesh, max_faces: int, of: str) -> tuple[TriangleMesh, Ints, str]:
    kept, faces = thin_mesh(mesh.vertices, mesh.faces, max_faces)
    if len(faces) == len(mesh.faces):
        return mesh, kept, ""
    note = f"Shown are {len(faces):,} of the {len(mesh.faces):,} triangles of the {of}."
    return TriangleMesh(vertices=mesh.vertices[kept], faces=faces), kept, note


def _groups(groups: Ints | None, kept: Ints) -> dict[str, str] | None:
    return None if groups is None else encode_integers(groups[kept].astype("<u2"))


def encode_integers(values: NDArray[Any]) -> dict[str, str]:
    """Return whole numbers in base64, with their type."""
    data = base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
    return {"type": values.dtype.str[1:], "data": data}


def quantise(values: Array, dtype: str) -> dict[str, Any]:
    """Return columns of values, each quantised from its minimum to its maximum in `dtype`."""
    columns = np.asarray(values, dtype=np.float64)
    columns = columns.reshape(len(values), -1) if len(values) else columns.reshape(0, 3)
    low = columns.min(axis=0) if len(columns) else np.zeros(columns.shape[1])
    span = (columns.max(axis=0) if len(columns) else low) - low
    step = np.where(span > 0, span, 1.0) / np.iinfo(dtype).max
    whole = np.round((columns - low) / step).astype(dtype)
    return {"low": low.tolist(), "step": step.tolist(), "values": encode_integers(whole)}


def _mesh(mesh: TriangleMesh, label: str, colour: str, **options: Any) -> dict[str, Any]:
    n_vertices = mesh.vertices.shape[0]
    indices = mesh.faces.reshape(-1).astype("<u2" if n_vertices <= 1 << 16 else "<u4")
    is_closed = bool(len(mesh.faces) and closed_edges(mesh.faces).mean() > 0.999)
    return {
        "label": label,
        "colour": colour,
        "visible": True,
        "opacity": 1.0,
        "closed": is_closed,
        "attributes": [],
        "positions": quantise(1e3 * mesh.vertices, "<u2"),
        "indices": encode_integers(indices),
        **options,
    }


def _attribute(attribute: Attribute, kept: Ints) -> dict[str, Any]:
    values = np.asarray(attribute.values, dtype=np.float64)[kept]
    if attribute.classes:
        n_classes = len(attribute.classes)
        whole = values.astype("<u1" if n_classes <= 256 else "<u2")
        stored = {"low": [0.0], "step": [1.0], "values": encode_integers(whole)}
    else:
        stored = quantise(values, "<u2")
    return {
        **{name: getattr(attribute, name) for name in ("label", "unit", "digits", "sides", "note")},
        "range": list(attribute.limits),
        "classes": attribute.classes or None,
        "colours": attribute.colours or _scale_colours(attribute.colour_map),
        "values": stored,
    }


def _scale_colours(name: str) -> tuple[str, ...]:
    mpl = load_matplotlib()
    from matplotlib.colors import to_hex  # noqa: PLC0415 - as above

    return tuple(to_hex(colour) for colour in mpl.colormaps[name](np.linspace(0, 1, _N_COLOURS)))


def _faces(faces: Sequence[BoxFace]) -> dict[str, Any]:
    """Faces of the box, coloured like expected errors."""
    seen = [f"{f.name} ± {1e3 * f.sigma_m:.1f} mm" for f in faces if f.sigma_m is not None]
    unseen = [face.name for face in faces if face.sigma_m is None]
    note = f"Faces of the box, one standard deviation: {', '.join(seen)}."
    return {
        "label": "box by radar",
        "colour": ERROR_COLOURS[0],
        "colours": ERROR_COLOURS,
        "range": [0.0, 1e3 * WORST_SHOWN_M],
        "visible": True,
        "opacity": _BOX_OPACITY,
        "corners": [np.round(1e3 * face.corners_m, 2).tolist() for face in faces],
        "values": [None if f.sigma_m is None else round(1e3 * f.sigma_m, 3) for f in faces],
        "note": note + f" Dashed, not seen: {', '.join(unseen)}." * bool(unseen),
    }


def _volume(volume: Volume) -> dict[str, Any]:
    """Volume with 256 levels between its limits."""
    values, origin_m, spacing_m = coarsen(volume)
    low, high = volume.limits
    levels = np.round(255.0 * np.clip((values - low) / (high - low), 0.0, 1.0)).astype("<u1")
    return {
        "label": volume.label,
        "unit": volume.unit,
        "range": [low, high],
        "opaque": volume.is_signed,
        "colours": _scale_colours(volume.colour_map),
        "origin": np.round(1e3 * origin_m, 3).tolist(),
        "spacing": 1e3 * spacing_m,
        "shape": list(values.shape),
        "values": encode_integers(levels),
    }


def _glints(glints: Glints) -> dict[str, Any]:
    strongest = np.argsort(-glints.strengths, kind="stable")[:_MAX_GLINTS]
    shown = glints.select(strongest)
    relative = shown.strengths / max(float(shown.strengths[0]), 1e-300)
    decibels = 20.0 * np.log10(np.maximum(relative, 1e-10))
    return {
        "label": "glints",
        "colour": GLINT_COLOUR,
        "visible": False,
        "opacity": 1.0,
        "radius": 1e3 * _GLINT_RADIUS_M,
        "positions": quantise(1e3 * shown.positions, "<u2"),
        "normals": quantise(shown.normals, "<u1"),
        "values": quantise(np.maximum(decibels, -_GLINT_RANGE_DB), "<u1"),
        "poses": encode_integers(np.clip(shown.poses, 0, 65_535).astype("<u2")),
        "reach": 1e3 * SEEN_REACH_M,
        "cosine": float(np.cos(SEEN_ANGLE_RAD)),
        "range": [-_GLINT_RANGE_DB, 0.0],
        "colours": _scale_colours("viridis"),
        "note": f"Shown are the {len(shown):,} strongest of {len(glints):,} glints."
        * (len(shown) < len(glints)),
    }
