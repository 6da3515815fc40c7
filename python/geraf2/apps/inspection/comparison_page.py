"""`comparison.html` and `.glb`: what changed in a packed box, in colours on its content."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from geraf2._types import Bools, Ints
from geraf2.apps.inspection.comparison import Change, Comparison, Scanned, middle_of
from geraf2.apps.inspection.scan_evidence import owners_of
from geraf2.geometry.triangles import used_vertices
from geraf2.io.atomic import write_bytes_atomic, write_json_atomic, write_text_atomic
from geraf2.io.mesh import TriangleMesh
from geraf2.io.run_folder import COMPARISON_NAME
from geraf2.io.trimesh_formats import glb_bytes
from geraf2.report import html
from geraf2.report.canvas import GLINT_COLOUR, RED, SKY, TRUTH_COLOUR
from geraf2.report.view3d import (
    NO_WEBGL,
    Around,
    Attribute,
    Other,
    rgb,
    scene_json,
    view_scene,
)

_KINDS = {
    "no change found": "#b9c0c7",
    "appeared": TRUTH_COLOUR,
    "vanished": RED,
    "moved": GLINT_COLOUR,
    "swapped": "#CC79A7",
}
"""Classes of the map with their colours, by number."""
_BEFORE_OPACITY = 0.25
_NEAR_M = 0.006
"""Least radius of the marked surface around a change [m]: of a screw head with its rim."""


def write_comparison(
    found: Comparison,
    here: Scanned,
    before: Scanned,
    box: TriangleMesh | None,
    out: Path,
    title: str,
) -> None:
    """Write `comparison.json`, `.html` and `.glb` into a folder.

    here, before: both scans, in the frame of the run. box: its mesh.
    """
    mesh, marks = here.whole.mesh, marks_of(found.changes, here)
    gone = _vanished_surface(found.changes, before)
    colours = list(_KINDS.values())
    others = [
        Other(label="vanished", colour=RED, opacity=1.0, mesh=gone),
        Other(
            label="reference",
            colour=SKY,
            opacity=_BEFORE_OPACITY,
            mesh=before.whole.mesh,
            is_reference=True,
            is_visible=False,
        ),
    ]
    classes = Attribute(
        label="change",
        values=marks.astype(np.float64),
        classes=tuple(_KINDS),
        colours=tuple(colours),
        note="Of the run; what vanished is a surface of its own, from the reference."
        if found.changed is not None
        else "Whether anything changed is not determined.",
    )
    scene = view_scene(
        mesh, [classes], Around(box=box, others=others if len(gone.faces) else others[1:])
    )
    page = html.render_template(
        "comparison.html",
        title=title,
        found=found,
        view=scene_json(scene),
        fallback=NO_WEBGL,
        colours=_KINDS,
    )
    both = TriangleMesh.joined([mesh, gone])
    of_gone = np.full(len(gone.vertices), list(_KINDS).index("vanished"))
    numbers = np.concatenate([marks, of_gone])
    srgb = np.array([rgb(colour) for colour in colours])[numbers]
    columns = {"change": numbers.astype(np.float64)}
    out.mkdir(parents=True, exist_ok=True)
    write_json_atomic(out / f"{COMPARISON_NAME}.json", found.to_dict())
    write_text_atomic(out / f"{COMPARISON_NAME}.html", page)
    write_bytes_atomic(
        out / f"{COMPARISON_NAME}.glb", glb_bytes(both.vertices, both.faces, srgb, columns, {})
    )


def marks_of(changes: Sequence[Change], scan: Scanned) -> Ints:
    """Class of each vertex of a scan's content by the changes on it, the likeliest on top."""
    marks = np.zeros(len(scan.whole.mesh.vertices), dtype=np.int64)
    for change in reversed(changes):
        if change.what != "vanished":
            marks[_find_marked(change, scan)] = list(_KINDS).index(change.what)
    return marks


def _find_marked(change: Change, scan: Scanned) -> Bools:
    """Vertices of the content that a change is on: those of its part, or near its middle."""
    vertices = scan.whole.mesh.vertices
    if not change.is_body:
        gap = np.linalg.norm(vertices - change.center_m, axis=1)
        return np.asarray(gap < max(_NEAR_M, 0.5 * change.size_m))
    gaps = [float(np.linalg.norm(middle_of(body) - change.center_m)) for body in scan.bodies]
    return np.asarray(owners_of(vertices, scan.bodies) == int(np.argmin(gaps)))


def _vanished_surface(changes: Sequence[Change], before: Scanned) -> TriangleMesh:
    """Surface of the earlier scan that is no longer there."""
    gone = [replace(c, what="swapped") for c in changes if c.what in ("vanished", "swapped")]
    marked, mesh = marks_of(gone, before) > 0, before.whole.mesh
    used, faces = used_vertices(mesh.faces[marked[mesh.faces].any(axis=1)])
    return TriangleMesh(vertices=mesh.vertices[used], faces=faces)
