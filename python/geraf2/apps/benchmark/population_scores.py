"""Scores of one scene of the population."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geraf2.evaluation import evaluate_mesh
from geraf2.evaluation.mesh_metrics import FINE_SAMPLES
from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.io.mesh import TriangleMesh

THRESHOLDS_M = (0.005, 0.003, 0.002)


def population_scores(
    mesh: TriangleMesh,
    truth: TriangleMesh,
    seed: int,
    *,
    stated: Mapping[str, Any] | None = None,
    num_threads: int | None = None,
) -> dict[str, float]:
    """Scores of a reconstructed surface by name; lengths in millimetres.

    mesh: the content, with expected errors where the preset has them.
    truth: the true surface, closed.
    seed: of the points that are drawn.
    stated: numbers of the stage `mesh`, with the intervals of volume and extents.
    """
    metrics = evaluate_mesh(
        mesh,
        truth,
        n_samples=FINE_SAMPLES,
        seed=seed,
        thresholds_m=THRESHOLDS_M,
        num_threads=num_threads,
    )
    scores = metrics.headline()
    if metrics.expected_error is not None:
        scores["within_one"] = metrics.expected_error.within_one
        scores["within_two"] = metrics.expected_error.within_two
        scores["rank"] = metrics.expected_error.rank_correlation
    return scores | covered_sizes(truth, stated or {})


def covered_sizes(truth: TriangleMesh, stated: Mapping[str, Any]) -> dict[str, float]:
    """Whether stated 95 % intervals hold the true volume, and the share of extents that they hold.

    {} without intervals.
    """
    if "volume_95_percent_cm3" not in stated:
        return {}
    low, high = stated["volume_95_percent_cm3"]
    volume = 1e6 * enclosed_volume_m3(truth.vertices, truth.faces)
    sides = 1e3 * np.ptp(truth.vertices, axis=0)
    ends = np.asarray(stated["extents_95_percent_mm"])
    return {
        "volume_covered": float(low <= volume <= high),
        "extents_covered": float(np.mean((ends[:, 0] <= sides) & (sides <= ends[:, 1]))),
    }
