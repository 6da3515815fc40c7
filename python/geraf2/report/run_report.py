"""Report of a run folder: pictures, sections and page."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import AnyPath, Array, Floats
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.evaluation import sample_surface
from geraf2.evaluation.mesh_metrics import DEFAULT_THRESHOLDS_M
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io import run_folder
from geraf2.io.array_layouts import read_arrays
from geraf2.io.atomic import write_json_atomic, write_npz_atomic, write_text_atomic
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.planes import load_planes
from geraf2.io.run_folder import RunFolder, StageRecord
from geraf2.io.text import read_text
from geraf2.io.verdict import Verdict, not_determined
from geraf2.report import figures as draw
from geraf2.report import html, run_sections, view3d
from geraf2.report.answer import Answer, answer_of
from geraf2.report.outlines import shadow_pictures
from geraf2.report.run_sections import Section, read_log, read_object
from geraf2.report.stored_scores import read_metrics, read_psnr
from geraf2.report.view_layers import box_faces, heat_map, read_heat_map, signed_distance
from geraf2.scene import Grid
from geraf2.surfaces.isosurface import signed_distances

LOS_VIEWS = "los/views.png"
_NO_VIEW = (
    "The view in 3D needs JavaScript and WebGL2, which this browser does not offer here; "
    "the pictures show the same surface."
)
_TRUTH = {"vertices": "float n 3", "faces": "index:n m 3", "distances_m": "float k"}
_MAX_RENDERED = 6  # planes whose heat maps the page shows
_MAX_IMAGE_BYTES = 2**26  # of a heat map that the page reads for its slices
_MAX_TRUTH_FACES = 30_000  # of the copy for reports without the truth


@dataclass(frozen=True, kw_only=True, eq=False)
class RunArtefacts:
    """Files of a run folder; None where the run has none."""

    sdf: SdfGrid | None
    """`sdf.npz`."""
    glints: Glints | None
    """`glints.npz`."""
    content: TriangleMesh | None
    """`mesh_content.ply`."""
    box: TriangleMesh | None
    """`mesh_box.ply`."""
    metrics: dict[str, Any]
    """`metrics.json`, empty if absent or of another mesh."""
    config_text: str | None
    """`config.toml`."""
    warnings: tuple[str, ...]
    """Warnings and errors since the last start."""
    stages: Mapping[str, StageRecord]
    """Steps that are done."""
    files: Mapping[str, str]
    """Hash of each file."""
    folder: Path
    """The folder."""
    silhouettes: Silhouettes | None = None
    """`silhouettes.npz`."""
    planes_m: Floats | None = None
    """Corners of the planes of antennas, `planes.json`, (n_planes, 4, 3) [m]."""
    scene: tuple[str, str] = ("", "")
    """Name and digest of the scene."""
    verdict: Verdict | None = None
    """How far the result can be trusted."""
    numbers: Mapping[str, Mapping[str, Any]]
    """Results of each stage, without those that the verdict withdraws."""

    @property
    def surface(self) -> TriangleMesh | None:
        """Content, if it has triangles."""
        return self.content if self.content is not None and self.content.faces.shape[0] else None


def read_run(run_dir: AnyPath) -> RunArtefacts:
    """Read the artefacts of a run folder; UserError if the folder or a file in it is broken."""
    folder = Path(run_dir)
    run = RunFolder.read(folder)
    sdf, glints = run.find_file(run_folder.SDF_NAME), run.find_file(run_folder.GLINTS_NAME)
    content, box = run.find_file(run_folder.CONTENT_NAME), run.find_file(run_folder.BOX_NAME)
    shadows, config = run.find_file(run_folder.SILHOUETTES_NAME), folder / run_folder.CONFIG_NAME
    return RunArtefacts(
        sdf=SdfGrid.load(sdf) if sdf else None,
        glints=Glints.load(glints) if glints else None,
        content=read_mesh(content) if content else None,
        box=read_mesh(box) if box else None,
        metrics=read_metrics(folder / run_folder.METRICS_NAME, content),
        config_text=read_text(config) if config.is_file() else None,
        warnings=tuple(run.warnings),
        stages=run.stages,
        files=run.files,
        folder=folder,
        silhouettes=Silhouettes.load(shadows) if shadows else None,
        planes_m=load_planes(folder / run_folder.PLANES_NAME).corners_m,
        scene=(run.scene_name, run.scene_digest),
        verdict=run.verdict,
        numbers=run.numbers,
    )


def write_report(
    run_dir: AnyPath,
    *,
    name: str | None = None,
    truth: TriangleMesh | None = None,
    heatmap: tuple[Array, Grid] | None = None,
    provenance: Mapping[str, str] | None = None,
    num_threads: int | None = None,
) -> Path:
    """Draw the pictures of a run and write `report.html`, one file with everything it shows.

    run_dir: run folder; its files are used where they exist.
    name: of the folder in the title; by its path when None.
    truth: true surface, drawn beside the reconstruction. Without it, earlier pictures with the
        truth of `metrics.json` are kept.
    heatmap: matched-filter volume and its grid; by default an existing `figures/projections.png` is
        shown.
    provenance: origin of the data, name to text; stored in `provenance.json` for later reports.

    Returns the path of the report. The pictures are also in `figures/` as PNG.
    """
    folder = Path(run_dir)
    run = read_run(folder)
    figures = folder / run_folder.FIGURES_FOLDER
    if provenance:
        write_json_atomic(
            folder / run_folder.PROVENANCE_NAME, {k: str(v) for k, v in provenance.items()}
        )
    known = provenance or read_object(folder / run_folder.PROVENANCE_NAME, "the provenance")
    log = read_log(folder)
    kept = _kept_pictures(run, figures) if truth is None else frozenset()
    copy = _truth_copy(run, truth, bool(kept), num_threads)
    view = None
    if run.surface is not None:
        view = view3d.scene_json(_view(run, copy, heatmap, num_threads))
    pictures = _draw(run, figures, kept, truth, heatmap, num_threads)
    answer = answer_of(run.content, run.glints, run.numbers, run.metrics, run.verdict)
    sections = [
        Section("answer", "What was found", kind="answer", note=_NO_VIEW),
        *run_sections.ruled_out(run.numbers.get("mesh", {})),
        *pictures,
        *_evaluation(run, answer),
        *_renderings(folder),
        *_histories(log, figures),
        *run_sections.tables(run.stages, run.metrics, run.surface),
        *run_sections.provenance(folder, run.scene, run.files, known, log),
        *run_sections.settings(run.config_text, run.stages),
        *run_sections.definitions(run.stages, run.surface),
    ]
    # Notes of calibration are in its section, not among the warnings.
    notes = {f"calibrated {text}" for text in run.numbers.get("calibration", {}).get("applied", ())}
    page = html.render_template(
        "run.html",
        title=f"What is in the box: {name or run_folder.place_of(folder)}",
        verdict=run.verdict,
        meta=run_sections.meta(run.scene[0], run.config_text, log),
        sections=sections,
        answer=answer,
        warnings=[line for line in dict.fromkeys(run.warnings) if line not in notes],
        view=view,
    )
    write_text_atomic(folder / run_folder.REPORT_NAME, page)
    return folder / run_folder.REPORT_NAME


def run_view(run_dir: AnyPath) -> str | None:
    """Page with only the 3D view of a run's report; None without a surface."""
    folder = Path(run_dir)
    run = read_run(folder)
    if run.surface is None:
        return None
    scene = _view(run, _known_truth(run), with_field=True)
    return html.render_template(
        "view_page.html",
        title=run_folder.place_of(folder),
        views=[("", view3d.scene_json(scene), run.verdict)],
        fallback=_NO_VIEW.split(";", maxsplit=1)[0] + ".",
        is_tall=False,
    )


def run_scene(folder: Path) -> dict[str, Any] | None:
    """Scene of the 3D view of a run, with slices of its field; None where it holds nothing yet."""
    run = read_run(folder)
    if run.surface is None and run.glints is None and run.sdf is None and run.box is None:
        return None
    return _view(run, _known_truth(run), with_field=True)


def _known_truth(run: RunArtefacts) -> tuple[TriangleMesh, Floats] | None:
    path = run.folder / run_folder.TRUTH_COPY
    is_known = "scores" in run.metrics and path.is_file() and run.surface is not None
    return stored_truth(path) if is_known else None


def _view(
    run: RunArtefacts,
    copy: tuple[TriangleMesh, Floats] | None,
    heatmap: tuple[Array, Grid] | None = None,
    num_threads: int | None = None,
    *,
    with_field: bool = False,
) -> dict[str, Any]:
    """Scene of the 3D view, with slices of the heat map where there is one."""
    attributes = []
    if run.surface is not None:
        attributes = view3d.content_attributes(
            run.surface,
            glints=run.glints,
            box=run.box,
            distances_m=None if copy is None else copy[1],
            num_threads=num_threads,
        )
    volumes = [] if heatmap is None else [heat_map(*heatmap)]
    stored = run.folder / run_folder.IMAGE_NAME
    if not volumes and stored.is_file() and stored.stat().st_size < _MAX_IMAGE_BYTES:
        volumes = [read_heat_map(stored)]
    if with_field and run.sdf is not None:
        volumes.append(signed_distance(run.sdf))
    around = view3d.Around(
        box=run.box,
        truth=None if copy is None else copy[0],
        glints=run.glints,
        planes_m=run.planes_m,
        faces=box_faces(run.numbers.get("box", {})),
        volumes=volumes,
    )
    content = run.surface or view3d.NOTHING
    return view3d.view_scene(content, attributes, around, name=run.scene[0] or "view")


def _truth_copy(
    run: RunArtefacts, truth: TriangleMesh | None, scores_kept: bool, num_threads: int | None
) -> tuple[TriangleMesh, Floats] | None:
    """Thinned truth for the view, and distance of each vertex of the content to it [m]."""
    path = run.folder / run_folder.TRUTH_COPY
    if run.surface is None:
        return None
    if truth is not None and truth.faces.shape[0]:
        distances = signed_distances(truth, run.surface.vertices, num_threads=num_threads)
        kept, faces = view3d.thin_mesh(truth.vertices, truth.faces, _MAX_TRUTH_FACES)
        thin = TriangleMesh(vertices=truth.vertices[kept], faces=faces)
        arrays = {"vertices": thin.vertices, "faces": faces, "distances_m": distances}
        write_npz_atomic(path, arrays)
        return thin, distances
    if not (scores_kept and path.is_file()):
        path.unlink(missing_ok=True)
        return None
    return stored_truth(path)


def stored_truth(path: Path) -> tuple[TriangleMesh, Floats]:
    """Thinned truth that an earlier report kept, and the distances to it [m]."""
    stored = read_arrays(path, _TRUTH)
    return TriangleMesh(vertices=stored["vertices"], faces=stored["faces"]), stored["distances_m"]


def _draw(
    run: RunArtefacts,
    figures: Path,
    kept: frozenset[str],
    truth: TriangleMesh | None,
    heatmap: tuple[Array, Grid] | None,
    num_threads: int | None,
) -> list[Section]:
    """Sections with pictures, in order."""
    sections: list[Section] = []

    def add(*about: Any) -> None:
        sections.append(_pictured(*about))

    content = run.surface
    if content is not None:
        if "mesh.png" not in kept:
            _draw_mesh(content, truth, figures / "mesh.png", num_threads)
        shown = truth is not None or "mesh.png" in kept
        beside = ", beside the truth, and its distance from it" if shown else ""
        colour = "grey: the mesh has no expected errors"
        if content.expected_error_m is not None:
            colour = "coloured by expected error, one standard deviation"
            colour += ", which does not hold here" if not_determined(run.verdict) else ""
        note = f"The content from four sides, {colour}{beside}; no perspective."
        add("surface", "Surface", figures / "mesh.png", note)
    if content is not None and truth is not None:
        _draw_errors(content, truth, figures / run_folder.ERRORS_NAME, num_threads)
    if run.sdf is not None:
        if "slices.png" not in kept:
            draw.sdf_slices(
                run.sdf, figures / "slices.png", glints=run.glints, truth=truth, box=run.box
            )
        note = "Three cuts through the middle of the content: the black line is its surface."
        add("slices", "Signed distance", figures / "slices.png", note)
    if run.glints is not None and len(run.glints):
        draw.glint_overview(run.glints, figures / "glints.png", box=run.box)
        note = "Points that sent an echo straight back: position, strength and plane of antennas."
        add("glints", "Glints", figures / "glints.png", note)
    if run.silhouettes is not None and len(run.silhouettes):
        if "shadows.png" not in kept:
            shadow_pictures(run.silhouettes, content, figures / "shadows.png", truth=truth)
        note = "Echo of the far walls behind the content; no echo shows tops and bottoms."
        add("shadows", "Shadows", figures / "shadows.png", note)
    if "los" in run.stages and (figures.parent / LOS_VIEWS).is_file():
        note = "Photos of the box, the surface trained from them, and its outward normals."
        add("line-of-sight", "Line of sight", figures.parent / LOS_VIEWS, note)
    if heatmap is not None:
        draw.projections(heatmap[0], heatmap[1], figures / "projections.png", box=run.box)
    if (figures / "projections.png").is_file():
        note = "Largest magnitude of the matched-filter image along each axis."
        add("heat-map", "Heat map", figures / "projections.png", note)
    return sections


def _evaluation(run: RunArtefacts, answer: Answer) -> list[Section]:
    """Section of the scores against the truth; empty without scores."""
    if "scores" not in run.metrics:
        return []
    parts = [html.part("facts", answer.scores)]
    curves = run.folder / run_folder.FIGURES_FOLDER / run_folder.ERRORS_NAME
    if curves.is_file():
        parts.append(html.picture(curves, name="evaluation"))
    parts.append(html.part("metrics_tables", run.metrics))
    note = "Errors of this surface against the true one, which the run did not know."
    return [Section("evaluation", "Against the truth", note=note, parts=tuple(parts))]


def _renderings(folder: Path) -> list[Section]:
    """Section of rendered and measured heat maps, where `geraf2 render` was run on this mesh."""
    views = folder / run_folder.VIEWS_FOLDER
    record: dict[str, Any] = {}
    with suppress(UserError):  # a broken record is ignored
        record = read_psnr(views / run_folder.PSNR_NAME, folder / run_folder.CONTENT_NAME)
    if not record:
        return []
    parts = [html.part("rendered_planes", record)]
    for angle in list(record["psnr_db"])[:_MAX_RENDERED]:
        for kind in ("measured", "rendered"):
            path = views / f"angle_{float(angle):05.1f}_{kind}.png"
            if path.is_file():
                text = f"Heat map of the plane at {angle} degrees, {kind}."
                parts.append(html.picture(path, text))
    note = (
        "Heat maps computed from the reconstruction, beside the measured ones: a held-out plane "
        "shows whether the surface explains the data."
    )
    return [Section("rendered", "Rendered heat maps", note=note, parts=tuple(parts))]


def _pictured(name: str, title: str, picture: Path, note: str) -> Section:
    return Section(name, title, note=note, parts=(html.picture(picture, name=name),))


def _histories(log: Sequence[Mapping[str, Any]], figures: Path) -> list[Section]:
    """Sections of the losses of a training, and of a surface that grew with the scan."""
    sections = []
    if losses := run_sections.losses(log):
        draw.loss_curves(losses, figures / "losses.png")
        note = "Terms of the loss over the steps of the training, means since the line before. "
        note = (note + run_sections.level_moved(log)).strip()
        sections.append(_pictured("training", "Training", figures / "losses.png", note))
    if growth := run_sections.growth(log):
        draw.growth_curves(growth, figures / "growth.png")
        note = "Expected error and seen share of the surface after each plane, while the scan was "
        note += "made."
        sections.append(_pictured("growth", "Growth", figures / "growth.png", note))
    return sections


def _kept_pictures(run: RunArtefacts, figures: Path) -> frozenset[str]:
    """Existing pictures with the truth, which are not redrawn without it."""
    if "scores" not in run.metrics:
        (figures / run_folder.ERRORS_NAME).unlink(missing_ok=True)  # of another mesh
    if not (figures / run_folder.ERRORS_NAME).is_file():
        return frozenset()
    return frozenset(name for name in run_folder.TRUTH_PICTURES if (figures / name).is_file())


def _draw_mesh(
    content: TriangleMesh, truth: TriangleMesh | None, path: Path, num_threads: int | None
) -> None:
    distances = None
    if truth is not None:
        distances = signed_distances(truth, content.vertices, num_threads=num_threads)
    draw.mesh_views(content, path, truth=truth, distances_m=distances, num_threads=num_threads)


def _draw_errors(
    content: TriangleMesh, truth: TriangleMesh, path: Path, num_threads: int | None
) -> None:
    rng = np.random.default_rng(0)
    on_content, on_truth = (sample_surface(mesh, 5000, rng) for mesh in (content, truth))
    draw.error_curves(
        {
            "mesh to truth": signed_distances(truth, on_content, num_threads=num_threads),
            "truth to mesh": signed_distances(content, on_truth, num_threads=num_threads),
        },
        path,
        thresholds_m=DEFAULT_THRESHOLDS_M,
    )
