"""Matched filter with the best possible threshold: an upper bound of the paper's baseline."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, repeat

import numpy as np
from numpy.typing import NDArray

from geraf2.evaluation.mesh_metrics import evaluate_mesh
from geraf2.fields import SdfGrid
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Grid, LosPrior
from geraf2.surfaces.extraction import cropped_content, prior_distance

_COARSE_M = (0.015, 0.005)
"""Thresholds that need no dense samples, of which each level has its scores [m]."""
DEFAULT_LEVELS = tuple(float(v) for v in np.linspace(0.1, 0.9, 17))


@dataclass(frozen=True, kw_only=True)
class OracleScore:
    """Best score over all thresholds, for each metric separately."""

    level: float
    """Threshold of the best F1 at 15 mm, as a share of the largest value inside."""
    f1_15mm: float
    """Best F1 at 15 mm."""
    f1_5mm: float
    """Best F1 at 5 mm over all thresholds."""
    f1_2mm: float
    """F1 at 2 mm at the threshold of the best F1 at 5 mm."""
    chamfer_1e3_m2: float
    """Smallest Chamfer distance over all thresholds [1e-3 m^2]."""


def oracle_matched_filter(
    volume: NDArray[np.floating],
    grid: Grid,
    prior: LosPrior,
    truth: TriangleMesh,
    *,
    crop_m: float,
    levels: Sequence[float] = DEFAULT_LEVELS,
    n_samples: int = 10000,
    seed: int = 0,
    others: Iterable[TriangleMesh] = (),
    num_threads: int | None = None,
) -> OracleScore:
    """Best scores of the isosurfaces of a matched-filter volume, chosen with the truth.

    The baseline of the paper (heat maps summed over the planes, a threshold, a surface) with a
    threshold that needs the truth: a bound, not a method. The surface is the
    isosurface of the volume instead of a Poisson fit to its points.

    volume: sum over planes of |P|, grid.shape, as from :func:`geraf2.imaging.volume.image_volume`.
    truth: surface of the content.
    crop_m: voxels nearer to the prior's surface do not count, as for the method compared [m].
    levels: thresholds to try, as shares of the largest value among the voxels that count.
    n_samples, seed: of the samples of each surface.
    others: further surfaces among which the best scores are taken, of level 0.
    """
    counted = prior_distance(prior, grid, num_threads) < -crop_m
    peak = float(np.where(counted, volume, 0.0).max())
    if not peak > 0.0:
        msg = "volume must be positive somewhere inside the prior"
        raise ValueError(msg)
    score = partial(evaluate_mesh, n_samples=n_samples, seed=seed, num_threads=num_threads)

    def isosurface(level: float) -> TriangleMesh:
        field = SdfGrid(grid=grid, values=(level * peak - volume).astype(np.float32))
        return cropped_content(field, prior, crop_m, num_threads=num_threads)

    surfaces = chain(((level, isosurface(level)) for level in levels), zip(repeat(0.0), others))
    scores = [
        (level, mesh, score(mesh, truth, thresholds_m=_COARSE_M))
        for level, mesh in surfaces
        if mesh.faces.shape[0]
    ]
    if not scores:
        msg = f"volume must cross one of the levels {list(levels)} inside the prior"
        raise ValueError(msg)
    best_level, _, best = max(scores, key=lambda score: score[2].f1(0.015))
    _, sharpest, at_5mm = max(scores, key=lambda score: score[2].f1(0.005))
    fine = score(sharpest, truth)
    return OracleScore(
        level=best_level,
        f1_15mm=best.f1(0.015),
        f1_5mm=at_5mm.f1(0.005),
        f1_2mm=fine.f1(0.002),
        chamfer_1e3_m2=min(metrics.chamfer_1e3_m2 for _, _, metrics in scores),
    )
