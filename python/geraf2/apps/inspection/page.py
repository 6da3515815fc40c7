"""`inspection.html`: the answer, the parts in 3D with their deviation, and the numbers."""

from collections.abc import Sequence

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.apps.inspection.bodies import Body, BodyReport, Measured, part_of
from geraf2.apps.inspection.deviation import Region
from geraf2.apps.inspection.result import PASS, Inspection, ModelReport, rotation_vector_deg
from geraf2.geometry.transforms import apply_rigid
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
    """Whole document in one file.

    whole: all of the content. values_m: deviation of its vertices, NaN where none is
    known, or None.
    box: around it.
    """
    placed = [
        (apply_rigid(r.match.placement.pose, r.model.mesh.vertices), r.model.mesh.faces)
        for r in inspection.models
        if r.match.placement is not None and r.match.status != "wrong part"
    ]
    # Where nothing was seen the surface is a layer of its own: a deviation is of what was seen.
    faces, known = whole.mesh.faces, whole.seen[whole.mesh.faces].all(axis=1)
    others = []
    if known.any() and not known.all():
        others.append(("only filled", _FILLED_COLOUR, 1.0, part_of(whole, faces[~known]).mesh))
    if placed:
        others.append(("CAD models", TRUTH_COLOUR, _MODEL_OPACITY, _joined(placed)))
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
        tables=[html.safe(text) for text in _tables(inspection)],
        scene=inspection.scene[0],
    )


def _attributes(body: Body, values_m: Floats | None, tolerance_m: float) -> list[Attribute]:
    """List the deviation, where a model is, and the expected error."""
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


def _joined(meshes: Sequence[tuple[Floats, Ints]]) -> TriangleMesh:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return TriangleMesh(
        vertices=np.concatenate([vertices for vertices, _ in meshes]),
        faces=np.concatenate([f + at for (_, f), at in zip(meshes, starts[:-1], strict=True)]),
    )


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


def _tables(inspection: Inspection) -> list[str]:
    made = [_part_table(inspection.parts)]
    if inspection.models:
        made.append(_model_table(inspection.models))
    for report in inspection.models:
        if report.deviation is not None and report.deviation.regions:
            caption = f"Where {report.model.name} is out of tolerance"
            made.append(_region_table(caption, report.deviation.regions))
    if inspection.comparison is not None and inspection.comparison.regions:
        made.append(_region_table("What changed", inspection.comparison.regions))
    return made


def _part_table(parts: Sequence[BodyReport]) -> str:
    head = ("part", "middle x, y, z [mm]", "lengths along its own axes [mm]", "volume [cm³]")
    rows = [
        (
            str(number),
            ", ".join(
                _number(1e3 * value, 1e3 * sigma)
                for value, sigma in zip(part.center_m, part.center_sigma_m, strict=True)
            ),
            " x ".join(_pm(length, 1e3) for length in part.dimensions_m),
            _pm(part.volume_m3, 1e6),
            _pm(part.area_m2, 1e4),
            f"{100 * part.seen_fraction:.0f}",
        )
        for number, part in enumerate(parts, 1)
    ]
    return html.table("Parts; ± holds 95 %", (*head, "area [cm²]", "seen [%]"), rows)


def _model_table(models: Sequence[ModelReport]) -> str:
    rows = []
    for report in models:
        match, placement, deviation = report.match, report.match.placement, report.deviation
        cells = [report.model.name, match.status, f"{match.score:.2f}", *["n/a"] * 5]
        if placement is not None:
            cells[3] = ", ".join(
                _number(1e3 * v, 1e3 * s)
                for v, s in zip(placement.middle_m, placement.position_sigma_m, strict=True)
            )
            cells[4] = ", ".join(
                _number(v, np.rad2deg(s))
                for v, s in zip(
                    rotation_vector_deg(placement.pose), placement.rotation_sigma_rad, strict=True
                )
            )
        if deviation is not None:
            cells[5] = f"{1e3 * deviation.rms_m:.2f}"
            cells[6] = f"{100 * deviation.within_fraction:.0f}"
            cells[7] = f"{100 * deviation.seen_fraction:.0f}"
        rows.append(cells)
    head = ("model", "status", "score", "middle x, y, z [mm]", "turn x, y, z [degrees]")
    rest = ("rms deviation [mm]", "within tolerance [%]", "seen [%]")
    return html.table("Models", (*head, *rest), rows)


def _region_table(caption: str, regions: Sequence[Region]) -> str:
    rows = [
        (
            r.what,
            _number(1e3 * r.deviation_m, 1e3 * r.sigma_m, "+.1f"),
            f"{1e6 * r.area_m2:.0f}",
            ", ".join(f"{1e3 * v:.0f}" for v in r.center_m),
        )
        for r in regions
    ]
    return html.table(caption, ("what", "deviation [mm]", "area [mm²]", "at x, y, z [mm]"), rows)


def _pm(measured: Measured, scale: float) -> str:
    return _number(scale * measured.value, scale * measured.sigma)


def _number(value: float, sigma: float, form: str = ".1f") -> str:
    """Value with what holds 95 %, on one line."""
    return f"{value:{form}}\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}{1.96 * sigma:.1f}"
