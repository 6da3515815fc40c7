"""Level of a trained surface from the depth of its glints.

A spot of light of a smooth surface, a glint, is as wide and as deep as what the radar resolves, but
where it is brightest along the line of sight is known to a fraction of a millimetre. L_MF says
little of that: it compares whole maps, and is as well off with a spot that is a little too deep as
with one that is a little too wide. So the zero level is moved, after the training, by the one
number that brings rendered glints to the depth of the measured ones.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from geraf2._types import Floats
from geraf2.fields import SdfGrid

SEED = 3
"""Of the windows and rays: the same for every training."""
INV_S = 800.0
"""Sharpness with which glints are rendered [1/m]: 2.6 / (s^2 r) of a ball of 46 mm is 0.1 mm."""
N_ROUNDS = 3
"""Looks at the glints: what is moved is rendered differently."""
N_WINDOWS = 4
"""Of antennas of a plane, each with a glint of its own."""
N_DRAWS = 2
"""Of a window's rays, over which the power of its glint is averaged."""
REACH = 1.5
"""Within which the depth of a part is looked for, in voxels of the trained field."""
INWARD_SHARE = 0.25
"""Of the depth of a part, and of that reach: inward a part is moved by that at most."""
BESIDE_M = 0.02
"""How far from the surface a glint may be [m]: half a range cell."""
DEPTHS_M = np.arange(-0.03, 0.0305, 0.001)
"""Along the line of sight, from the glint; less than a range cell to either side."""
PLACES_AT_ONCE = 4096
_N_OF_PEAK = 3
# To either side, in which the depth of a part is looked for.
_MOST_STEPS = 6
# The median of fewer says nothing.
_LEAST_GLINTS = 3


class GlintShift(NamedTuple):
    """By how much a surface is moved to the depth of its glints."""

    inward_m: float = 0.0
    """How far the surface is moved inward [m], outward where negative."""
    looks_m: tuple[float, ...] = ()
    """How far it lay outside at each look, median over glints [m]; 0 with too few of them."""
    n_glints: int = 0
    """That the last look found."""

    def after(self, differences: list[float], reach_m: float) -> "GlintShift":
        """Look once more.

        differences: by how much glints are rendered behind the measured ones [m].
        reach_m: as in :func:`moved`; inward the surface is moved by a quarter of it at most [m].
        """
        n = len(differences)
        outside_m = 0.0 - float(np.median(differences)) if n >= _LEAST_GLINTS else 0.0
        inward_m = min(self.inward_m + outside_m, INWARD_SHARE * reach_m)
        return GlintShift(inward_m, (*self.looks_m, outside_m), n)


def moved(sdf: SdfGrid, inward_m: float, reach_m: float) -> SdfGrid:
    """Move the zero level inward, or outward where negative [m].

    Inward a part is moved by a quarter of its depth at most, as what is thin would vanish. The
    depth of a part is how far inside its deepest place within reach_m lies [m].
    """
    by = np.float32(inward_m)
    if inward_m > 0.0:
        by = np.minimum(by, np.float32(INWARD_SHARE) * _depth(sdf, reach_m))
    return SdfGrid(grid=sdf.grid, values=sdf.values + by)


def _depth(sdf: SdfGrid, reach_m: float) -> NDArray[np.float32]:
    """Depth of the deepest place within reach of each voxel, 0 where all is outside [m]."""
    # Looked for among fewer voxels where they are fine: work grows with the sixth power.
    step = max(-(-round(reach_m / sdf.grid.spacing_m) // _MOST_STEPS), 1)
    values = sdf.values[::step, ::step, ::step]
    spacing_m = step * sdf.grid.spacing_m
    reach = round(reach_m / spacing_m)
    steps = np.mgrid[(slice(-reach, reach + 1),) * 3]
    near = (steps**2).sum(axis=0) <= reach**2
    depth = np.maximum(maximum_filter(-values, footprint=near), np.float32(0.0))
    if step > 1:
        nx, ny, nz = values.shape
        coarse = replace(sdf.grid, spacing_m=spacing_m, shape=(nx, ny, nz))
        fine = SdfGrid(grid=coarse, values=depth).sample(sdf.grid.points())
        depth = fine.reshape(sdf.grid.shape).astype(np.float32)
    return np.asarray(depth)


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
