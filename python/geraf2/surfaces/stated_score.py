"""F1 score that a surface is stated to have, from its expected errors, without the truth.

    s = sum_v A_v P(|d_v| < tau) / sum_v A_v,   d_v ~ N(0, e_v^2)

is the share of the area that is expected within tau of the true surface. The score grows with it,
g(F1) = a + b g(s) + N(0, sigma^2) with g(x) = log(x / (1 - x)): constants of the simulated
population of objects (`bench/python/live.py fit`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf, expit, logit
from scipy.stats import norm

from geraf2._types import Floats
from geraf2._validation import require_each, require_positive
from geraf2.errors import UserError
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import TriangleMesh

THRESHOLD_M = 0.005
"""Distance tau of the score that is stated [m]."""
# Shares and scores are kept this far from 0 and 1, whose logarithms are infinite.
_LEAST = 0.005


@dataclass(frozen=True, kw_only=True)
class ScoreModel:
    """Score of a surface against the share of it that is expected within tau."""

    offset: float = 0.0
    """a, of `bench/python/live.py fit`."""
    slope: float = 1.0
    """b."""
    sigma: float = 1.0
    """Standard deviation of the score about it, on the scale g."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, "slope", "sigma")

    @staticmethod
    def scale(share: Floats | float) -> Floats:
        """Scale g on which the model is linear."""
        return np.asarray(logit(np.clip(share, _LEAST, 1.0 - _LEAST)))


@dataclass(frozen=True, kw_only=True)
class StatedScore:
    """What a surface is stated to score."""

    middle: float
    """Median on the scale of the model."""
    sigma: float
    """Standard deviation on it."""

    @property
    def mean(self) -> float:
        """Median of the score, 0 to 1."""
        return float(expit(self.middle))

    @property
    def low(self) -> float:
        """Lower end of the 90 % interval."""
        return float(expit(self.middle - 1.645 * self.sigma))

    @property
    def high(self) -> float:
        """Upper end of the 90 % interval."""
        return float(expit(self.middle + 1.645 * self.sigma))

    def odds(self, score: float) -> float:
        """Return the probability that the score is at least this."""
        return float(norm.sf((float(ScoreModel.scale(score)) - self.middle) / self.sigma))


def kept_share(mesh: TriangleMesh, threshold_m: float = THRESHOLD_M) -> float:
    """Share of a surface's area that is expected within a distance of the truth, 0 to 1."""
    if mesh.expected_error_m is None:
        raise UserError(what="the surface does not state its expected error")
    areas = vertex_areas(mesh.vertices, mesh.faces)
    deviations = threshold_m / np.maximum(np.sqrt(2.0) * mesh.expected_error_m, 1e-12)
    return float((areas * erf(deviations)).sum() / areas.sum())


def stated_f1(kept: float, model: ScoreModel | None = None) -> StatedScore:
    """State the F1 at 5 mm of a surface with this share, from :func:`kept_share`."""
    model = model or ScoreModel()
    middle = model.offset + model.slope * float(ScoreModel.scale(kept))
    return StatedScore(middle=middle, sigma=model.sigma)
