"""`inspection.html`: verdict, parts in 3D with their deviation, and tables."""

import numpy as np

from geraf2._types import Floats
from geraf2.apps.inspection.bodies import Body, part_of
from geraf2.apps.inspection.result import PASS, Inspection, rotation_vector_deg
from geraf2.io.mesh import TriangleMesh
from geraf2.report import html
from geraf2.report.canvas import TRUTH_COLOUR
from geraf2.report.view3d import Attribute, scene_json, view_scene

_FILLED_COLOUR, _MODEL_OPACITY = "#8d959c", 0.25
_FALLBACK = "The view in 3D needs JavaScript and WebGL2, which this browser does not offer here."


def inspection_page(
    inspection: Inspection,
    whole: Body,
    values_m: Floats | None,
    *,
    box: TriangleMesh | None = None,
    title: str = "inspection",
) -> str:
    """HTML document in one file.

    whole: all of the content. values_m: deviation of its vertices [m], NaN where unknown, or None.
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
        others.append(("only filled", _FILLED_COLOUR, 1.0, part_of(whole, faces[~known]).mesh))
    if placed:
        others.append(("CAD models", TRUTH_COLOUR, _MODEL_OPACITY, TriangleMesh.joined(placed)))
    shown = part_of(whole, faces[known]) if known.any() else whole
    used = np.unique(faces[known]) if known.any() else np.arange(len(whole.seen))
    values = None if values_m is None else values_m[used]
    attributes = _attributes(shown, values, inspection.tolerance_m)
    scene = view_scene(shown.mesh, attributes, box=box, name="inspection", others=others)
    return html.rendered(
        "inspection.html",
        title=title,
        passed=inspection.verdict == PASS,
        lead=_lead(inspection),
        failures=inspection.failures,
        notes=inspection.notes,
        tiles=_tiles(inspection),
        view=html.safe(scene_json(scene)),
        view_id="viewer",
        fallback=_FALLBACK,
        scripts=html.scripts(),
        found=inspection,
        turn=rotation_vector_deg,
        degrees=np.rad2deg,
        scene=inspection.scene[0],
    )


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


def _lead(inspection: Inspection) -> str:
    n = len(inspection.parts)
    parts = "One part" if n == 1 else f"{n} parts"
    if not inspection.models and not inspection.failures:
        return f"{parts} found."
    state = "Pass" if inspection.verdict == PASS else "Fail"
    present = sum(report.match.status == "present" for report in inspection.models)
    of = f", {present} of {len(inspection.models)} models present" if inspection.models else ""
    return f"{state}: {parts.lower()}{of}."


def _tiles(inspection: Inspection) -> list[tuple[str, str]]:
    tiles = [("parts", str(len(inspection.parts)))]
    if inspection.models:
        tiles.append(("tolerance", f"{1e3 * inspection.tolerance_m:g} mm"))
    deviations = [r.deviation for r in inspection.models if r.deviation is not None]
    if deviations:
        tiles.append(
            ("seen of the models", f"{100 * min(d.seen_fraction for d in deviations):.0f} %")
        )
        tiles.append(("rms deviation", f"{1e3 * max(d.rms_m for d in deviations):.2f} mm"))
    return tiles
