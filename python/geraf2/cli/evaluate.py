"""`geraf2 evaluate`: how far a run is from the truth."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from geraf2.cli._console import Positional, Threads, progress_bar, require_threads, rows, say, warn
from geraf2.errors import UserError
from geraf2.evaluation import MeshMetrics, evaluate_mesh, write_metrics
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.run_folder import (
    CONFIG_NAME,
    CONTENT_NAME,
    ERRORS_NAME,
    FIGURES_FOLDER,
    METRICS_NAME,
    REPORT_NAME,
    RunFolder,
    mesh_digest,
)


@dataclass(frozen=True, kw_only=True)
class Config:
    """Compare the reconstructed content with the truth; nothing is aligned, scaled or cropped."""

    out: Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Run folder of `geraf2 reconstruct`."""
    truth: Path
    """Mesh of the true surface, metres, capture frame (PLY, OBJ, STL, GLB)."""
    n_samples: int = 10000
    """Points drawn from each surface."""
    seed: int | None = None
    """Seed of these points; the run's own when not given."""
    threads: Threads = None
    """Threads to use; all when not given."""


def main(config: Config) -> int:
    """Run the command."""
    num_threads = require_threads(config.threads)
    run = RunFolder.read(config.out)
    truth = read_mesh(config.truth)
    seed = _run_seed(run.path) if config.seed is None else config.seed
    metrics = evaluate_run(run, truth, config.n_samples, seed, num_threads)
    print_metrics(metrics)
    say()
    for name, text in metrics.describe().items():
        say(f"{name}: {text}")
    say()
    say(f"metrics  {run.path / METRICS_NAME}")
    say(f"report   {run.path / REPORT_NAME}")
    return 0


def evaluate_run(
    run: RunFolder, truth: TriangleMesh, n_samples: int, seed: int, num_threads: int | None
) -> MeshMetrics:
    """Measure a run against the truth, write metrics.json, and draw the report again."""
    from geraf2.report import write_report  # noqa: PLC0415 - matplotlib takes 0.5 s

    if n_samples < 1:
        raise UserError(what="--n-samples must be at least 1", got=n_samples)
    if seed < 0:
        raise UserError(what="--seed must not be negative", got=seed)
    content = run.path / CONTENT_NAME
    if not content.is_file():
        raise UserError(
            what=f"the run has no {CONTENT_NAME} yet",
            where=run.path,
            hint="finish it with 'geraf2 reconstruct --resume'",
        )
    of_mesh = mesh_digest(run.path)
    mesh = read_mesh(content)
    _warn_of_unit(mesh, truth)
    with progress_bar("evaluating"):
        metrics = evaluate_mesh(
            mesh, truth, n_samples=n_samples, seed=seed, num_threads=num_threads
        )
    (run.path / FIGURES_FOLDER / ERRORS_NAME).unlink(missing_ok=True)  # of an earlier truth
    write_metrics(metrics, run.path / METRICS_NAME, extra=of_mesh)
    scores = {f"f1_{1e3 * s.threshold_m:g}mm": round(s.f1, 4) for s in metrics.scores}
    run.log("evaluate", level="info", chamfer_1e3_m2=metrics.chamfer_1e3_m2, **scores)
    with progress_bar("drawing the report"):
        write_report(run.path, truth=truth, num_threads=num_threads)
    return metrics


def print_metrics(metrics: MeshMetrics) -> None:
    """Print the figures that matter."""
    rows(
        [
            *(
                (
                    f"F1 {1e3 * score.threshold_m:g} mm",
                    f"{score.f1:.4f}  (precision {score.precision:.4f}, recall {score.recall:.4f})",
                )
                for score in metrics.scores
            ),
            ("Chamfer", f"{metrics.chamfer_1e3_m2:.5f} 1e-3 m^2"),
            (
                "both ways",
                f"median {1e3 * metrics.both_ways.median_m:.2f} mm, "
                f"95 % below {1e3 * metrics.both_ways.p95_m:.2f} mm",
            ),
            (
                "truth itself",
                f"Chamfer {metrics.floor_chamfer_1e3_m2:.5f} 1e-3 m^2, "
                f"median {1e3 * metrics.floor_median_m:.2f} mm",
            ),
        ]
    )


def _warn_of_unit(mesh: TriangleMesh, truth: TriangleMesh) -> None:
    extents = [
        float((m.vertices.max(axis=0) - m.vertices.min(axis=0)).max()) for m in (mesh, truth)
    ]
    if extents[1] > 20 * extents[0] or extents[0] > 20 * extents[1]:
        warn(
            f"the truth is {extents[1]:.3g} m long, the mesh {extents[0]:.3g} m: "
            "is the truth in metres?"
        )


def _run_seed(folder: Path) -> int:
    path = folder / CONFIG_NAME
    if not path.is_file():
        return 0
    try:
        seed = tomllib.loads(path.read_text(encoding="utf-8")).get("seed", 0)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(what=f"is not valid TOML: {error}", where=path) from None
    return seed if isinstance(seed, int) and seed >= 0 else 0
