"""Level of a trained surface from the depth of its glints.

A spot of light of a smooth surface, a glint, is as wide and as deep as what the radar resolves, but
where it is brightest along the line of sight is known to a fraction of a millimetre. L_MF says
little of that: it compares whole maps, and is as well off with a spot that is a little too deep as
with one that is a little too wide. So the zero level is moved once, after the training, by the one
number that brings rendered glints to the depth of the measured ones.
"""

from typing import NamedTuple

import numpy as np

from geraf2._types import Floats

SEED = 3
"""Of the windows and rays: the same for every training."""
INV_S = 800.0
"""Sharpness with which glints are rendered [1/m]: 2.6 / (s^2 r) of a ball of 46 mm is 0.1 mm."""
N_DRAWS = 4
"""Of a plane's rays, over which the power of its glint is averaged."""
DEPTHS_M = np.arange(-0.03, 0.0305, 0.001)
"""Along the line of sight, from the glint; less than a range cell to either side."""
PLACES_AT_ONCE = 4096
_N_OF_PEAK = 3
# The median of fewer says nothing.
_LEAST_PLANES = 3


class GlintShift(NamedTuple):
    """By how much a surface lies in front of the depth of its glints."""

    outside_m: float
    """Median over planes [m], positive where the surface lies outside; 0 with too few of them."""
    quartiles_m: tuple[float, float]
    n_planes: int
    """In which a glint was found."""

    @property
    def inward_m(self) -> float:
        """How far the surface is moved inward [m].

        Outward by the median. Inward only as far as three quarters of the planes ask for: thin
        parts that are moved away do not come back.
        """
        return self.outside_m if self.outside_m < 0.0 else max(self.quartiles_m[0], 0.0)


def line_of_sight(glint: Floats, window: Floats) -> Floats:
    """Places at DEPTHS_M behind a glint (3,), seen from the middle of a window (3,), (n, 3) [m]."""
    sight = (glint - window) / np.linalg.norm(glint - window)
    return np.asarray(glint + DEPTHS_M[:, None] * sight)


def depth_difference(rendered: Floats, measured: Floats) -> float | None:
    """How far the rendered peak lies behind the measured one, both powers at DEPTHS_M [m].

    The measured peak next to the middle, and the rendered one next to that; None without either.
    """
    true = _peak(measured, 0.0)
    found = None if true is None else _peak(rendered, true)
    return None if true is None or found is None else found - true


def _peak(powers: Floats, beside_m: float) -> float | None:
    """Depth of the peak next to a depth [m]: of the parabola through seven samples."""
    inner = powers[1:-1]
    tops = 1 + np.flatnonzero((inner > powers[:-2]) & (inner >= powers[2:]))
    if not tops.size:
        return None
    top = int(tops[np.abs(DEPTHS_M[tops] - beside_m).argmin()])
    near = slice(max(top - _N_OF_PEAK, 0), top + _N_OF_PEAK + 1)
    curve = np.polyfit(DEPTHS_M[near] - DEPTHS_M[top], powers[near], 2)
    if not curve[0] < 0.0:
        return float(DEPTHS_M[top])
    step = float(np.clip(-0.5 * curve[1] / curve[0], -1e-3 * _N_OF_PEAK, 1e-3 * _N_OF_PEAK))
    return float(DEPTHS_M[top]) + step


def shift_of(differences: list[float]) -> GlintShift:
    """Median of the depths by which glints are rendered behind the measured ones [m]."""
    if len(differences) < _LEAST_PLANES:
        return GlintShift(0.0, (0.0, 0.0), len(differences))
    low, middle, high = (float(q) for q in np.quantile(differences, (0.25, 0.5, 0.75)))
    return GlintShift(-middle, (-high, -low), len(differences))
