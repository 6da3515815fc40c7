"""The report of a run folder: draws what is there, says what is not."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geraf2 import __version__
from geraf2._types import AnyPath, Array
from geraf2.errors import UserError
from geraf2.evaluation import MeshMetrics, sample_surface
from geraf2.evaluation.mesh_metrics import DEFAULT_THRESHOLDS_M
from geraf2.fields import SdfGrid
from geraf2.glints.glint_set import Glints
from geraf2.glints.silhouettes import Silhouettes
from geraf2.io.atomic import write_json_atomic, write_text_atomic
from geraf2.io.digests import file_digest
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.run_folder import (
    BOX_NAME,
    CONFIG_NAME,
    CONTENT_NAME,
    ERRORS_NAME,
    FIGURES_FOLDER,
    GLINTS_NAME,
    METRICS_NAME,
    PROVENANCE_NAME,
    REPORT_NAME,
    SDF_NAME,
    SILHOUETTES_NAME,
    TRUTH_PICTURES,
    RunFolder,
    StageRecord,
)
from geraf2.report import html
from geraf2.report.figures import error_curves, glint_overview, mesh_views, projections, sdf_slices
from geraf2.report.material import material_note
from geraf2.report.outlines import shadow_pictures
from geraf2.scene import Grid
from geraf2.surfaces.confidence import ConfidenceConfig, surface_evidence
from geraf2.surfaces.isosurface import signed_distances, surface_report

LOS_VIEWS = "los/views.png"


@dataclass(frozen=True, kw_only=True, eq=False)
class RunArtefacts:
    """What lies in a run folder; None where a stage has not run."""

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
    """Stages that are done."""
    silhouettes: Silhouettes | None = None
    """`silhouettes.npz`."""

    @property
    def unexplained(self) -> tuple[float, ...]:
        """Share of the heat maps that the surface does not explain, before and after each round."""
        fit = self.stages.get("heatmaps")
        return () if fit is None else tuple(fit.numbers.get("unexplained", ()))


def read_run(run_dir: AnyPath) -> RunArtefacts:
    """Read the artefacts of a run folder; UserError if the folder or a file in it is broken."""
    folder = Path(run_dir)
    run = RunFolder.read(folder)
    sdf, glints = run.written(SDF_NAME), run.written(GLINTS_NAME)
    content, box = run.written(CONTENT_NAME), run.written(BOX_NAME)
    shadows, config = run.written(SILHOUETTES_NAME), folder / CONFIG_NAME
    metrics = _read_object(folder / METRICS_NAME, "the metrics")
    of_this_mesh = content is not None and metrics.get("mesh_digest") == file_digest(content)
    return RunArtefacts(
        sdf=SdfGrid.load(sdf) if sdf else None,
        glints=Glints.load(glints) if glints else None,
        content=read_mesh(content) if content else None,
        box=read_mesh(box) if box else None,
        metrics=metrics if of_this_mesh else {},
        config_text=config.read_text(encoding="utf-8") if config.is_file() else None,
        warnings=tuple(run.warnings),
        stages=run.stages,
        silhouettes=Silhouettes.load(shadows) if shadows else None,
    )


def write_report(
    run_dir: AnyPath,
    *,
    truth: TriangleMesh | None = None,
    heatmap: tuple[Array, Grid] | None = None,
    title: str | None = None,
    provenance: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
    num_threads: int | None = None,
) -> Path:
    """Draw the pictures of a run and write `report.html`, which holds everything it shows.

    run_dir: run folder; what its stages wrote, `metrics.json` and `config.toml`, each if it is
        there.
    truth: true surface, drawn beside the reconstruction. Without it, pictures with the truth of the
        scores in `metrics.json` stay as they are.
    heatmap: matched-filter volume and its grid; without it `figures/projections.png` of an earlier
        stage is shown if it is there.
    title: heading; by default the folder's name.
    provenance: where the data came from, name to text; kept in `provenance.json`, so that a report
        drawn again without it still shows it.
    warnings: further warnings, shown first.

    Returns the report. The pictures also lie in `figures/` as PNG.
    """
    folder = Path(run_dir)
    run = read_run(folder)
    figures = folder / FIGURES_FOLDER
    pictures = _draw(run, figures, truth, heatmap, num_threads)
    body = [html.warning(text) for text in dict.fromkeys([*warnings, *run.warnings])]
    body += _headline(run)
    body += material_note(run.stages)
    body += pictures
    if "scores" in run.metrics:
        body.append("<h2>Distance to the truth</h2>")
        body += html.metrics_section(run.metrics)
    body += _numbers(run)
    if provenance:
        write_json_atomic(folder / PROVENANCE_NAME, {k: str(v) for k, v in provenance.items()})
    known = provenance or _read_object(folder / PROVENANCE_NAME, "the provenance")
    rows = [("report drawn by", f"geraf2 {__version__}")]
    rows += [(name, str(text)) for name, text in known.items()]
    body += ["<h2>Provenance</h2>", html.table("", ("", ""), rows, text=True)]
    body += _definitions(run)
    if run.config_text is not None:
        body += ["<h2>Configuration</h2>", html.preformatted(run.config_text)]
    report = folder / REPORT_NAME
    heading = title if title is not None else f"geraf2: {folder.resolve().name}"
    write_text_atomic(report, html.page(heading, body))
    return report


def _draw(
    run: RunArtefacts,
    figures: Path,
    truth: TriangleMesh | None,
    heatmap: tuple[Array, Grid] | None,
    num_threads: int | None,
) -> list[str]:
    """Sections with pictures, in the order of reading."""
    sections: list[str] = []
    kept = _kept_pictures(run, figures) if truth is None else frozenset()
    content = run.content if run.content is not None and run.content.faces.shape[0] else None
    if content is not None:
        if "mesh.png" not in kept:
            _draw_mesh(content, truth, figures / "mesh.png", num_threads)
        shown = truth is not None or "mesh.png" in kept
        beside = ", beside the truth, and its distance from it" if shown else ""
        caption = f"The content from four sides, coloured by confidence{beside}; no perspective."
        sections += ["<h2>Surface</h2>", html.picture(figures / "mesh.png", caption)]
    if content is not None and truth is not None:
        _draw_errors(content, truth, figures / ERRORS_NAME, num_threads)
    if content is not None and (truth is not None or kept):
        caption = "Share of surface samples nearer to the other surface than a distance (exact)."
        sections.append(html.picture(figures / ERRORS_NAME, caption, max_width_px=620))
    if run.sdf is not None:
        if "slices.png" not in kept:
            sdf_slices(run.sdf, figures / "slices.png", glints=run.glints, truth=truth, box=run.box)
        caption = "Signed distance on three cuts through the middle of the content."
        sections += ["<h2>Signed distance</h2>", html.picture(figures / "slices.png", caption)]
    if run.glints is not None and len(run.glints):
        glint_overview(run.glints, figures / "glints.png", box=run.box)
        caption = "Every glint: place, strength, and the scan plane that saw it."
        sections += ["<h2>Glints</h2>", html.picture(figures / "glints.png", caption)]
    if run.silhouettes is not None and len(run.silhouettes):
        if "shadows.png" not in kept:
            shadow_pictures(run.silhouettes, content, figures / "shadows.png", truth=truth)
        caption = "What the content leaves of the far walls' flash; no echo shows tops and bottoms."
        sections += ["<h2>Shadows</h2>", html.picture(figures / "shadows.png", caption)]
    if "los" in run.stages and (figures.parent / LOS_VIEWS).is_file():
        caption = "Photos of the box, the surface trained from them, and its outward normals."
        sections += ["<h2>Line of sight</h2>", html.picture(figures.parent / LOS_VIEWS, caption)]
    if heatmap is not None:
        projections(heatmap[0], heatmap[1], figures / "projections.png", box=run.box)
    if (figures / "projections.png").is_file():
        caption = "Largest magnitude of the matched-filter image along each axis."
        sections += ["<h2>Heat map</h2>", html.picture(figures / "projections.png", caption)]
    return sections


def _kept_pictures(run: RunArtefacts, figures: Path) -> frozenset[str]:
    """Pictures that show the truth of the run's scores: none is drawn again without the truth."""
    if "scores" not in run.metrics:
        (figures / ERRORS_NAME).unlink(missing_ok=True)  # of another mesh
    if not (figures / ERRORS_NAME).is_file():
        return frozenset()
    return frozenset(name for name in TRUTH_PICTURES if (figures / name).is_file())


def _draw_mesh(
    content: TriangleMesh, truth: TriangleMesh | None, path: Path, num_threads: int | None
) -> None:
    distances = None
    if truth is not None:
        distances = signed_distances(truth, content.vertices, num_threads=num_threads)
    mesh_views(content, path, truth=truth, distances_m=distances, num_threads=num_threads)


def _draw_errors(
    content: TriangleMesh, truth: TriangleMesh, path: Path, num_threads: int | None
) -> None:
    rng = np.random.default_rng(0)
    on_content, on_truth = (sample_surface(mesh, 5000, rng) for mesh in (content, truth))
    error_curves(
        {
            "mesh to truth": signed_distances(truth, on_content, num_threads=num_threads),
            "truth to mesh": signed_distances(content, on_truth, num_threads=num_threads),
        },
        path,
        thresholds_m=DEFAULT_THRESHOLDS_M,
    )


def _headline(run: RunArtefacts) -> list[str]:
    items: list[tuple[str, str]] = []
    if "scores" in run.metrics:
        items += [
            (f"F1 {1e3 * score['threshold_m']:g} mm", f"{score['f1']:.3f}")
            for score in run.metrics["scores"]
        ]
        items.append(("Chamfer [1e-3 m²]", f"{run.metrics['chamfer_1e3_m2']:.4f}"))
        items.append(("median error", f"{html.millimetres(_median_m(run.metrics))} mm"))
    if run.glints is not None:
        items.append(("glints", str(len(run.glints))))
    if run.content is not None:
        if run.content.faces.shape[0]:
            size = np.ptp(run.content.vertices, axis=0) * 1e3
            items.append(("size x, y, z", " x ".join(f"{s:.0f}" for s in size) + " mm"))
        if run.glints is not None:
            unseen = surface_evidence(run.content, run.glints).unseen_area_fraction
            items.append(("never seen", f"{100 * unseen:.0f} % of the area"))
    if not items:
        return ['<p class="note">Nothing has been reconstructed in this folder yet.</p>']
    return [html.facts(items)]


def _median_m(metrics: Mapping[str, Any]) -> float:
    return float(metrics["both_ways"]["median_m"])


def _numbers(run: RunArtefacts) -> list[str]:
    tables: list[str] = []
    if run.content is not None:
        report = surface_report(run.content)
        volume = "not closed" if report.volume_m3 is None else f"{1e6 * report.volume_m3:.1f}"
        rows = [
            ("closed", "yes" if report.is_watertight else "no"),
            ("connected pieces", str(report.n_components)),
            ("triangles", str(report.n_faces)),
            ("area [cm²]", f"{1e4 * report.area_m2:.1f}"),
            ("volume [cm³]", volume),
        ]
        tables.append(html.table("Content", ("", ""), rows))
    if run.unexplained:
        rows = [
            ("start" if n == 0 else f"round {n}", f"{value:.3f}")
            for n, value in enumerate(run.unexplained)
        ]
        tables.append(html.table("Heat maps not explained", ("", ""), rows))
    known = {
        *MeshMetrics.__dataclass_fields__,
        "definitions",
        "mesh_digest",
        "format",
        "format_version",
        "generator",
    }
    other = html.scalar_rows(run.metrics, known)
    if other:
        tables.append(html.table("Further numbers", ("", ""), other))
    if run.stages:
        stages = [
            (name, f"{done.seconds:.1f}", f"{done.peak_memory_mib:.0f}")
            for name, done in run.stages.items()
        ]
        head = ("stage", "time [s]", "peak memory [MiB]")
        tables.append(html.table("Run", head, stages))
    if not tables:
        return []
    return ["<h2>Numbers</h2>", f'<div class="tables">{"".join(tables)}</div>']


def _definitions(run: RunArtefacts) -> list[str]:
    config = ConfidenceConfig()
    entries: dict[str, str] = {}
    if run.unexplained:
        entries["heat maps not explained"] = (
            "amplitude of what the surface's echo leaves of the measured heat maps over theirs, "
            "root mean square over sub-apertures, at places that took no part in the fit; the "
            "surface of the smallest is kept"
        )
    if run.content is not None:
        entries["confidence"] = (
            "1 - exp(-evidence); evidence = sum over glints of (relative strength)^"
            f"{config.strength_exponent:g} exp(-distance^2 / (2 ({1e3 * config.reach_m:g} mm)^2)) "
            "max(0, cos of the angle between the normals): how much was measured there"
        )
        entries["never seen"] = (
            f"no glint within {1e3 * config.seen_reach_m:g} mm whose normal lies within "
            f"{np.rad2deg(config.seen_angle_rad):.0f} degrees: there the surface is only filled"
        )
    entries.update(run.metrics.get("definitions", {}))
    return ["<h2>Definitions</h2>", html.definitions(entries)] if entries else []


def _read_object(path: Path, what: str) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise UserError(
            what=f"cannot read {what}: {error}",
            where=path,
            hint="remove the file or run the stage again",
        ) from error
    if not isinstance(stored, dict):
        raise UserError(
            what=f"cannot read {what}",
            where=path,
            expected="a JSON object",
            got=type(stored).__name__,
        )
    return stored
