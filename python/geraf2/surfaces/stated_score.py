"""F1 at 5 mm that a surface is stated to have, from its expected errors, without the truth.

    s = sum_v A_v P(|d_v| < tau) / sum_v A_v,   d_v ~ N(0, e_v^2)

is the share of the area that is expected within tau of the true surface. It is the median of the
score, log(F1 / (1 - F1)) ~ N(log(s / (1 - s)), sigma^2): a fitted offset and slope were -0.03 and
0.93 (`bench/python/live.py fit`). One sigma for all scenes is rough: of two other scenes with a box
in sight, the 90 % interval held 59 % of the surfaces; most of the others were better than stated.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf, expit, logit, ndtr

from geraf2.errors import UserError
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import TriangleMesh

THRESHOLD_M = 0.005
"""Distance tau of the score that is stated [m]."""
SIGMA = 0.49
"""Standard deviation of log(F1 / (1 - F1)) about that of the stated share: 7 scenes of the
population, seeds below 100, and 5 of the benchmark, 2 to 22 planes each."""
# Half width of the 90 % interval in standard deviations.
_NINETY = 1.645
# Shares and scores are kept this far from 0 and 1, whose logarithms are infinite.
_LEAST = 0.005


@dataclass(frozen=True, kw_only=True)
class StatedScore:
    """Stated distribution of the score of a surface."""

    median: float
    """0 to 1."""
    sigma: float = SIGMA

    @property
    def interval(self) -> tuple[float, float]:
        """90 % interval, 0 to 1."""
        half = _NINETY * self.sigma
        return float(expit(log_odds(self.median) - half)), float(
            expit(log_odds(self.median) + half)
        )

    def odds(self, score: float) -> float:
        """Return the probability that the score is at least this."""
        return float(ndtr((log_odds(self.median) - log_odds(score)) / self.sigma))


def log_odds(share: float) -> float:
    """Return log(x / (1 - x)) of a share, which is kept off 0 and 1."""
    return float(logit(np.clip(share, _LEAST, 1.0 - _LEAST)))


def kept_share(mesh: TriangleMesh, threshold_m: float = THRESHOLD_M) -> float:
    """Share of a surface's area that is expected within a distance of the truth, 0 to 1."""
    if mesh.expected_error_m is None:
        raise UserError(what="the surface does not state its expected error")
    areas = vertex_areas(mesh.vertices, mesh.faces)
    deviations = threshold_m / np.maximum(np.sqrt(2.0) * mesh.expected_error_m, 1e-12)
    return float((areas * erf(deviations)).sum() / areas.sum())


def stated_f1(mesh: TriangleMesh) -> StatedScore:
    """State the F1 at 5 mm of a surface with expected errors; UserError without them."""
    return StatedScore(median=kept_share(mesh))
