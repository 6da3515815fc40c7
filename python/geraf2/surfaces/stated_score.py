"""F1 at 5 mm that a surface is stated to have, from its expected errors, without the truth.

    F(s) = sum_v A_v P(|d_v| < tau) / sum_v A_v,   d_v ~ N(0, (s e_v)^2),   log s ~ N(0, sigma^2)

F(1) is the share of the area that is expected within tau of the true surface: the median of the
score. The expected errors of a scan are all too large or too small by a factor s in common, for
which a scan has no measure. F falls with s, so quantiles of s are quantiles of the score.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf, ndtr

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import TriangleMesh

THRESHOLD_M = 0.005
"""Distance tau of the score that is stated [m]."""
SIGMA = 0.48
"""Standard deviation of log s: 11 scenes of the population, seeds below 100, 3 to 30 planes each
(`bench/python/live.py fit`)."""
# Half width of the 90 % interval in standard deviations.
_NINETY = 1.645
# Values of log s between which F is interpolated.
_LOG_SCALES = np.linspace(-3.0, 3.0, 61)


@dataclass(frozen=True, kw_only=True, eq=False)
class StatedScore:
    """Stated distribution of the score of a surface."""

    shares: Floats
    """F(s) at 61 values of log s from -3 to 3; falling, 0 to 1."""
    sigma: float = SIGMA

    @property
    def median(self) -> float:
        """Score that is as often exceeded as not, 0 to 1."""
        return self._at(0.0)

    @property
    def interval(self) -> tuple[float, float]:
        """90 % interval, 0 to 1."""
        return self._at(_NINETY * self.sigma), self._at(-_NINETY * self.sigma)

    def odds(self, score: float) -> float:
        """Return the probability that the score is at least this."""
        return float(ndtr(self.log_scale(score) / self.sigma))

    def log_scale(self, score: float) -> float:
        """Return log s at which F(s) is this score, from -3 to 3."""
        return float(np.interp(score, self.shares[::-1], _LOG_SCALES[::-1]))

    def _at(self, log_scale: float) -> float:
        return float(np.interp(log_scale, _LOG_SCALES, self.shares))


def stated_f1(mesh: TriangleMesh, threshold_m: float = THRESHOLD_M) -> StatedScore:
    """State the F1 at 5 mm of a surface with expected errors; UserError without them."""
    if mesh.expected_error_m is None:
        raise UserError(what="the surface does not state its expected error")
    areas = vertex_areas(mesh.vertices, mesh.faces)
    # Areas by expected error, in steps of 2 %: as exact as needed, and fast for any mesh.
    error_m = np.maximum(mesh.expected_error_m, 1e-6)
    steps, own = np.unique(np.rint(50.0 * np.log(error_m)), return_inverse=True)
    shares = np.bincount(own, weights=areas) / areas.sum()
    deviations = threshold_m / (np.sqrt(2.0) * np.exp(steps / 50.0))
    return StatedScore(shares=erf(deviations * np.exp(-_LOG_SCALES)[:, None]) @ shares)
