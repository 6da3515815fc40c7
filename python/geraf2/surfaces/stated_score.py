"""F1 at 5 mm that a surface is stated to have, without the truth.

If the run is right, the score is the share of the area that lies within tau of the true surface,

    F(s) = sum_v A_v P(|d_v| < tau) / sum_v A_v,   d_v ~ N(0, (s e_v)^2),   log s ~ N(mu, sigma^2),

with the area A_v [m^2] and the expected error e_v [m] of vertex v, given that it is at least 0.5.
The factor s is common to the expected errors of a scan, which has no measure of it. With the
probability of failure of the verdict the run is wrong: the score is then 0 in a third of the cases,
else uniform below 0.5.
"""

import numpy as np
from scipy.special import erf, ndtr

from geraf2._types import Floats
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import TriangleMesh
from geraf2.io.verdict import Verdict, not_determined

THRESHOLD_M = 0.005
"""Distance tau of the score [m]."""
FAILED_BELOW = 0.5
"""Score below which a run is wrong, as the verdict has it."""
LOG_SCALE, SIGMA = -0.1, 0.55
"""Mean mu and standard deviation of log s: of 23 runs of `fast` with a score above 0.5, on four
captures, seven random bodies and twelve ordinary objects."""
ELSEWHERE = 1.0 / 3.0
"""Share of wrong runs whose score is 0, because their content lies elsewhere: 22 of 63 of these."""
_QUANTILES = (0.05, 0.5, 0.95)
_LOG_SCALES = np.linspace(-3.0, 3.0, 241)


def stated_f1(mesh: TriangleMesh, failure: float) -> tuple[float, float, float]:
    """Lower end of the 90 % interval of the score, its median and upper end, 0 to 1.

    mesh: with expected errors and at least one face. failure: probability that the run is wrong.
    """
    scores = np.linspace(0.0, 1.0, 1001)
    right = _share_below(mesh, scores)
    at = right[scores.searchsorted(FAILED_BELOW)]
    # Where no factor s gives a score above 0.5, that is the best there is.
    is_above = np.where(scores < FAILED_BELOW, 0.0, 1.0)
    right = np.clip((right - at) / (1.0 - at), 0.0, 1.0) if at < 1.0 else is_above
    wrong = ELSEWHERE + (1.0 - ELSEWHERE) * np.minimum(scores / FAILED_BELOW, 1.0)
    below = failure * wrong + (1.0 - failure) * right
    low, middle, high = (float(scores[below.searchsorted(q)]) for q in _QUANTILES)
    return low, middle, high


def score_of(mesh: TriangleMesh, verdict: Verdict | None) -> tuple[float, float, float] | None:
    """Stated score of a run; None of one that is not judged, or not to be trusted."""
    if verdict is None or not_determined(verdict):
        return None
    if mesh.expected_error_m is None or not len(mesh.faces):
        return None
    return stated_f1(mesh, verdict.probability_of_failure)


def score_text(score: tuple[float, float, float]) -> str:
    """Stated score in words."""
    low, middle, high = score
    return f"{middle:.2f} at 5 mm ({low:.2f} to {high:.2f} with 90 %)"


def _share_below(mesh: TriangleMesh, scores: Floats) -> Floats:
    """Probability that a run that is right has at most each score, (n_scores,)."""
    assert mesh.expected_error_m is not None
    areas = vertex_areas(mesh.vertices, mesh.faces)
    # Areas by expected error, in steps of 2 %: as exact as needed, and fast for any mesh.
    error_m = np.maximum(mesh.expected_error_m, 1e-6)
    steps, own = np.unique(np.rint(50.0 * np.log(error_m)), return_inverse=True)
    shares = np.bincount(own, weights=areas) / areas.sum()
    deviations = THRESHOLD_M / (np.sqrt(2.0) * np.exp(steps / 50.0))
    f = erf(deviations * np.exp(-_LOG_SCALES)[:, None]) @ shares  # falls with s
    log_scale = np.interp(scores, f[::-1], _LOG_SCALES[::-1])
    return np.asarray(np.where(scores < f[0], ndtr((LOG_SCALE - log_scale) / SIGMA), 1.0))
