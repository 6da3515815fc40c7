"""`inspection.html`: verdict, parts in 3D with their deviation, and tables."""

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.apps.inspection.bodies import Body, part_of
from geraf2.apps.inspection.material import material_text
from geraf2.apps.inspection.result import Inspection, rotation_vector_deg
from geraf2.echoes.ruled_out import ruled_out_rows
from geraf2.geometry.transforms import triple
from geraf2.io.mesh import TriangleMesh
from geraf2.io.trimesh_formats import glb_bytes
from geraf2.report import html
from geraf2.report.canvas import SKY, TRUTH_COLOUR
from geraf2.report.html import picture_source
from geraf2.report.render import MeshPainter, View
from geraf2.report.view3d import (
    NO_WEBGL,
    PART_COLOURS,
    Apart,
    Around,
    Attribute,
    Other,
    expected_error,
    rgb,
    scene_json,
    thin_mesh,
    view_scene,
)

_NOT_SEEN_COLOUR, _MODEL_OPACITY = "#8d959c", 0.25
_APART = 1.2
"""Largest displacement of a part in the exploded view, as a share of its distance to the middle."""
_PICTURE_PX, _PICTURE_FACES, _N_VIEWS = 84, 3000, 12


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
    shown, used, others = whole, np.arange(len(whole.seen)), _models(inspection)
    faces, known = whole.mesh.faces, whole.seen[whole.mesh.faces].all(axis=1)
    if values_m is not None and known.any() and not known.all():
        # Deviations are known of seen surface only: the rest is a layer of its own.
        shown, used = part_of(whole, faces[known]), np.unique(faces[known])
        not_seen = Other(
            label="not seen",
            colour=_NOT_SEEN_COLOUR,
            opacity=1.0,
            mesh=part_of(whole, faces[~known]).mesh,
            groups=numbers[np.unique(faces[~known])],
        )
        others = [not_seen, *others]
    reflectivity = whole.mesh.reflectivity_db
    attributes = _part_attributes(
        numbers[used], None if reflectivity is None else reflectivity[used]
    )
    if values_m is None:  # the list is of parts: so is the first colouring
        attributes += [
            *_attributes(shown, None, inspection.tolerance_m),
            _seen_attribute(whole.seen),
        ]
    else:
        attributes = [*_attributes(shown, values_m[used], inspection.tolerance_m), *attributes]
    scene = view_scene(
        shown.mesh,
        attributes,
        Around(box=box, others=others),
        name="inspection",
        apart=_displacements(inspection, numbers[used]),
    )
    return html.render_template(
        "inspection.html",
        title=title,
        found=inspection,
        view=scene_json(scene),
        fallback=NO_WEBGL,
        turn=rotation_vector_deg,
        degrees=np.rad2deg,
        material_text=material_text,
        ruled_out=ruled_out_rows(inspection.ruled_out),
        n_views=_N_VIEWS,
        pictures=[_picture(whole, numbers, k) for k in range(1, len(inspection.parts) + 1)],
    )


def parts_glb(whole: Body, numbers: Ints) -> bytes:
    """GLB of the content, each part in its colour of the page.

    numbers: of the part of each vertex, from 1; 0 of none. A column of the file, as is the
    reflectivity [dB], -99 where it is unknown: glTF forbids NaN.
    """
    palette = np.array([rgb(_NOT_SEEN_COLOUR), *(rgb(colour) for colour in PART_COLOURS)])
    index = np.where(numbers > 0, (numbers - 1) % len(PART_COLOURS) + 1, 0)
    columns = {"part": numbers.astype(np.float64)}
    if whole.mesh.reflectivity_db is not None:
        columns["reflectivity_db"] = np.nan_to_num(whole.mesh.reflectivity_db, nan=-99.0)
    return glb_bytes(whole.mesh.vertices, whole.mesh.faces, palette[index], columns, {})


def _models(inspection: Inspection) -> list[Other]:
    """CAD models at their poses, as one surface."""
    placed = [
        (r.model.mesh.moved(r.match.placement.pose), max(r.match.body or 0, -1) + 1)
        for r in inspection.models
        if r.match.placement is not None and r.match.status != "wrong part"
    ]
    if not placed:
        return []
    return [
        Other(
            label="CAD models",
            colour=TRUTH_COLOUR,
            opacity=_MODEL_OPACITY,
            mesh=TriangleMesh.joined([mesh for mesh, _ in placed]),
            is_reference=True,
            groups=np.concatenate([np.full(len(mesh.vertices), k) for mesh, k in placed]),
        )
    ]


def _displacements(inspection: Inspection, numbers: Ints) -> Apart | None:
    """Displacements of the exploded view: parts move away from their middle; None for one part."""
    if len(inspection.parts) < 2:
        return None
    centers = np.array([part.center_m for part in inspection.parts])
    offsets = _APART * (centers - centers.mean(axis=0))
    return Apart(groups=numbers, offsets_m=np.concatenate([np.zeros((1, 3)), offsets]))


def _picture(whole: Body, numbers: Ints, number: int) -> str:
    """Return the data URL of a part from all around: small pictures in a row, in its colour."""
    from PIL import Image  # noqa: PLC0415 - takes 0.1 s

    faces = whole.mesh.faces[(numbers[whole.mesh.faces] == number).all(axis=1)]
    if not len(faces):
        return ""
    mesh = part_of(whole, faces).mesh
    kept, few = thin_mesh(mesh.vertices, mesh.faces, _PICTURE_FACES)
    mesh = TriangleMesh(vertices=mesh.vertices[kept], faces=few)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    views = [
        View(
            azimuth_deg=-50.0 + 360.0 * k / _N_VIEWS,
            elevation_deg=22.0,
            center_m=triple(0.5 * (low + high)),
            half_width_m=0.52 * float(np.linalg.norm(high - low)),
            n_pixels=_PICTURE_PX,
        )
        for k in range(_N_VIEWS)
    ]
    srgb = np.array(rgb(PART_COLOURS[(number - 1) % len(PART_COLOURS)])) / 255.0
    painter, colours = MeshPainter(mesh), np.tile(srgb, (len(mesh.vertices), 1))
    drawn = np.concatenate([painter.render(view, colours) for view in views], axis=1)
    return picture_source(Image.fromarray(np.round(255.0 * drawn).astype(np.uint8), "RGBA"))


def _part_attributes(numbers: Ints, reflectivity_db: Floats | None) -> list[Attribute]:
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


def _seen_attribute(seen: Bools) -> Attribute:
    return Attribute(
        label="seen",
        values=seen.astype(np.float64),
        classes=("not seen", "seen"),
        colours=(_NOT_SEEN_COLOUR, SKY),
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
    return [*found, expected_error(body.sigma_m)]
