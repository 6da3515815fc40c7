"""Files and stages of `geraf2 reconstruct --preset hybrid` that the default does not have."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from geraf2.fields import SdfGrid
from geraf2.glints import Glints
from geraf2.glints.silhouettes import Silhouettes
from geraf2.io.run_folder import SILHOUETTES_NAME, RunFolder
from geraf2.scene import Capture, LosPrior
from geraf2.surfaces.config import HeatmapFitConfig
from geraf2.surfaces.hybrid import HybridConfig, SecondLook

KEPT_NAME = "kept_glints.npz"
RIM_NAME = "rim_glints.npz"
MOVED_NAME = "sdf_moved.npz"  # distance to the moved surface


@dataclass(frozen=True, kw_only=True)
class HeatmapJob:
    """What the fit to heat maps needs."""

    run: RunFolder
    capture: Capture
    prior: LosPrior
    config: HeatmapFitConfig
    start: SdfGrid
    """Field as fitted to glints."""
    evidence: Glints
    """Seen glints: parts of the surface without any are no content."""
    seed: int
    num_threads: int | None


def save_second_look(found: SecondLook, run: RunFolder) -> list[str]:
    """Write both sets of glints and the silhouettes, if looked for; names of the files."""
    found.kept.save(run.path / KEPT_NAME)
    found.rim.save(run.path / RIM_NAME)
    if found.silhouettes is None:
        (run.path / SILHOUETTES_NAME).unlink(missing_ok=True)
        return [KEPT_NAME, RIM_NAME]
    found.silhouettes.save(run.path / SILHOUETTES_NAME)
    return [KEPT_NAME, RIM_NAME, SILHOUETTES_NAME]


def load_second_look(folder: Path, config: HybridConfig) -> SecondLook:
    """Read what `save_second_look` wrote."""
    silhouettes = Silhouettes.load(folder / SILHOUETTES_NAME) if config.shadows else None
    return SecondLook(Glints.load(folder / KEPT_NAME), Glints.load(folder / RIM_NAME), silhouettes)


def move_to_heatmaps(job: HeatmapJob, report: Callable[[float], None]) -> tuple[SdfGrid, list[str]]:
    """Move the content's surface to where its heat maps are the measured ones; write its field."""
    import torch  # noqa: PLC0415 - torch takes a second

    from geraf2.surfaces.extraction import content_surface  # noqa: PLC0415 - scikit-image
    from geraf2.surfaces.heatmap_fit import fit_heatmaps, moved_field  # noqa: PLC0415 - torch

    if job.num_threads is not None:
        torch.set_num_threads(job.num_threads)
    content, _ = content_surface(job.start, job.evidence, job.prior, num_threads=job.num_threads)
    fit = fit_heatmaps(
        content,
        job.capture,
        job.prior,
        job.config,
        seed=job.seed,
        num_threads=job.num_threads,
        progress=report,
    )
    moved = job.start
    if fit.best > 0:
        moved = moved_field(job.start, fit.surface, num_threads=job.num_threads)
    moved.save(job.run.path / MOVED_NAME)
    job.run.log(
        "heat maps", level="info", unexplained=[round(r, 4) for r in fit.residuals], best=fit.best
    )
    return moved, [MOVED_NAME]
