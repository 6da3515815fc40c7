"""`geraf2 evaluate`: scores of a run against the truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg, SampleCount, Seed
from geraf2.cli._console import CONSOLE, keep, rows, threads
from geraf2.cli._fields import Positional
from geraf2.evaluation import MeshMetrics
from geraf2.evaluation.mesh_metrics import SightScore
from geraf2.io.run_folder import METRICS_NAME
from geraf2.io.verdict import confidence
from geraf2.pipeline.commands.evaluate import evaluate
from geraf2.pipeline.reconstruction import load_run
from geraf2.surfaces.isosurface import SurfaceReport
from geraf2.surfaces.samples import size_lines


@dataclass(frozen=True, kw_only=True)
class Config:
    """Compare the reconstructed content with the truth; nothing is aligned, scaled or cropped."""

    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Run folder of `geraf2 reconstruct`."""
    truth: Path
    """Mesh of the true surface, metres, capture frame (PLY, OBJ, STL, GLB)."""
    n_samples: Annotated[SampleCount, Arg(hidden=True)] = 10000
    """Points drawn from each surface."""
    report: bool = False
    """Draw the report again, with the truth in it; done anyway if it has scores already."""
    seed: Annotated[Seed | None, Arg(hidden=True)] = None
    """Seed of these points; the run's own when not given."""


def main(config: Config) -> int:
    """Run the command."""
    metrics = evaluate(
        config.out,
        config.truth,
        n_samples=config.n_samples,
        seed=config.seed,
        report=config.report or (config.out / METRICS_NAME).is_file(),
        num_threads=threads(),
        listener=CONSOLE,
    )
    print_metrics(metrics)
    run = load_run(config.out)
    sizes = size_lines(run.numbers.get("mesh", {}), confidence(run.verdict))
    rows([*sizes, ("metrics", str(config.out / METRICS_NAME))])
    keep(metrics.to_dict())
    return 0


def print_metrics(metrics: MeshMetrics) -> None:
    """Print the scores."""
    scores = [
        (
            f"F1 {1e3 * score.threshold_m:g} mm",
            f"{score.f1:.4f}  (precision {score.precision:.4f}, recall {score.recall:.4f})",
        )
        for score in metrics.scores
    ]
    both, chamfer = metrics.both_ways, metrics.chamfer_1e3_m2
    floor = (metrics.floor_chamfer_1e3_m2, 1e3 * metrics.floor_median_m)
    rows(
        [
            *scores,
            ("Chamfer", f"{chamfer:.5f} 1e-3 m^2"),
            (
                "both directions",
                f"median {1e3 * both.median_m:.2f} mm, 95 % below {1e3 * both.p95_m:.2f} mm",
            ),
            *_sizes(metrics),
            *(_part(part) for part in metrics.by_sight),
            *_forecast(metrics),
            ("pieces, holes", f"{_topology(metrics.mesh)} (truth {_topology(metrics.truth)})"),
            ("truth itself", f"Chamfer {floor[0]:.5f} 1e-3 m^2, median {floor[1]:.2f} mm"),
        ]
    )


def _sizes(metrics: MeshMetrics) -> list[tuple[str, str]]:
    size, offset = metrics.size, metrics.surface_bias_m
    ratio = "not closed" if size.volume_ratio is None else f"{size.volume_ratio:.3f} of the truth's"
    errors = zip("xyz", size.extent_errors_m, strict=True)
    along = ", ".join(f"{axis} {1e3 * error:+z.2f}" for axis, error in errors)
    lines = [("volume", ratio), ("extents", f"{along} mm against the truth's")]
    if offset is not None:
        lines.append(("offset", f"{1e3 * offset:+z.2f} mm along the normal, in the median"))
    return lines


def _topology(surface: SurfaceReport) -> str:
    holes = "not closed" if surface.n_holes is None else surface.n_holes
    return f"{surface.n_components}, {holes}"


def _forecast(metrics: MeshMetrics) -> list[tuple[str, str]]:
    held = metrics.expected_error
    if held is None:
        return []
    parts = ", ".join(
        f"{part.evidence} {100 * part.area_fraction:.0f} % (expected {1e3 * part.expected_m:.2f}, "
        f"true {1e3 * part.median_m:.2f} mm)"
        for part in held.parts
    )
    text = (
        f"{100 * held.within_one:.0f} % of the area within one sigma, {100 * held.within_two:.0f} "
        f"% within two; rank correlation with the true error {held.rank_correlation:.2f}"
    )
    found = [("expected error", text)]
    if (aligned := metrics.expected_error_aligned) is not None:
        text = f"{100 * aligned.within_one:.0f} % within one sigma, "
        text += f"{100 * aligned.within_two:.0f} % within two, rank {aligned.rank_correlation:.2f}"
        found.append(("rigidly aligned", text))
    return [*found, *([("rests on", parts)] if parts else [])]


def _part(part: SightScore) -> tuple[str, str]:
    f1 = ", ".join(f"{1e3 * s.threshold_m:g} mm {s.f1:.4f}" for s in part.scores[1:])
    distances = part.surface_truth_to_mesh
    exact = f"; median {1e3 * distances.median_m:.2f} mm" if distances else ""
    return part.part, f"{100 * part.area_fraction:.0f} % of the truth: F1 {f1}{exact}"
