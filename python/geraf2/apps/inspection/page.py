"""`inspection.html`: verdict, parts in 3D with their deviation, and tables."""

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.apps.inspection.bodies import Body, part_of
from geraf2.apps.inspection.material import material_text
from geraf2.apps.inspection.result import Inspection, rotation_vector_deg
from geraf2.io.mesh import TriangleMesh
from geraf2.report import html
from geraf2.report.canvas import TRUTH_COLOUR
from geraf2.report.view3d import PART_COLOURS, Around, Attribute, Other, scene_json, view_scene

_NOT_SEEN_COLOUR, _MODEL_OPACITY = "#8d959c", 0.25
_FALLBACK = "The view in 3D needs JavaScript and WebGL2, which this browser does not offer here."


def inspection_page(
    inspection: Inspection,
    whole: Body,
    values_m: Floats | None,
    numbers: Ints,
    *,
    box: TriangleMesh | None = None,
    title: str = "inspection",
) -> str:
    """HTML document in one file.

    whole: all of the content. values_m: deviation of its vertices [m], NaN where unknown, or None.
    numbers: of the part of each vertex, from 1; 0 of none.
    box: mesh of the box.
    """
    placed = [
        r.model.mesh.moved(r.match.placement.pose)
        for r in inspection.models
        if r.match.placement is not None and r.match.status != "wrong part"
    ]
    # Unseen surface is a separate layer: deviations are known of seen surface only.
    faces, known = whole.mesh.faces, whole.seen[whole.mesh.faces].all(axis=1)
    others = []
    if known.any() and not known.all():
        not_seen = part_of(whole, faces[~known]).mesh
        others.append(Other(label="not seen", colour=_NOT_SEEN_COLOUR, opacity=1.0, mesh=not_seen))
    if placed:
        others.append(
            Other(
                label="CAD models",
                colour=TRUTH_COLOUR,
                opacity=_MODEL_OPACITY,
                mesh=TriangleMesh.joined(placed),
                is_reference=True,
            )
        )
    shown = part_of(whole, faces[known]) if known.any() else whole
    used = np.unique(faces[known]) if known.any() else np.arange(len(whole.seen))
    values = None if values_m is None else values_m[used]
    reflectivity = whole.mesh.reflectivity_db
    attributes = [
        *_attributes(shown, values, inspection.tolerance_m),
        *_of_parts(numbers[used], None if reflectivity is None else reflectivity[used]),
    ]
    if values is None:  # the list is of parts: so is the first colouring
        attributes = [*attributes[1:], attributes[0]]
    scene = view_scene(shown.mesh, attributes, Around(box=box, others=others), name="inspection")
    return html.rendered(
        "inspection.html",
        title=title,
        found=inspection,
        view=scene_json(scene),
        fallback=_FALLBACK,
        turn=rotation_vector_deg,
        degrees=np.rad2deg,
        material_text=material_text,
    )


def _of_parts(numbers: Ints, reflectivity_db: Floats | None) -> list[Attribute]:
    """Vertex attributes: the part, and the reflectivity where it is known."""
    names = ("no part", *(f"part {k}" for k in range(1, int(numbers.max(initial=0)) + 1)))
    colours = tuple(PART_COLOURS[k % len(PART_COLOURS)] for k in range(len(names) - 1))
    found = [
        Attribute(
            label="part",
            values=numbers.astype(np.float64),
            classes=names,
            colours=(_NOT_SEEN_COLOUR, *colours),
        )
    ]
    if reflectivity_db is not None:
        low, high = -20.0, 0.0
        found.append(
            Attribute(
                label="reflectivity against metal",
                values=np.nan_to_num(reflectivity_db, nan=low),
                unit="dB",
                limits=(low, high),
                digits=0,
                note="Of single returns; -20 dB where none came from.",
            )
        )
    return found


def _attributes(body: Body, values_m: Floats | None, tolerance_m: float) -> list[Attribute]:
    """Vertex attributes: the deviation, where known, and the expected error."""
    found: list[Attribute] = []
    if values_m is not None:
        high = 1e3 * 3.0 * tolerance_m
        found.append(
            Attribute(
                label="deviation from the model",
                values=1e3 * np.nan_to_num(values_m),
                unit="mm",
                limits=(-high, high),
                colour_map="RdBu_r",
                sides=("too little", "too much"),
                note="Only where an echo came from. Blue lies inside the model, red outside.",
            )
        )
    high = max(1.0, float(np.ceil(1e3 * np.quantile(body.sigma_m, 0.98))))
    error = Attribute(
        label="expected error",
        values=1e3 * body.sigma_m,
        unit="mm",
        limits=(0.0, high),
        colour_map="cividis",
    )
    return [*found, error]
