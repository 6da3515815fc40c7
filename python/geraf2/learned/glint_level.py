"""Level of a trained surface from the depth of its glints.

A spot of light of a smooth surface, a glint, is as wide and as deep as what the radar resolves, but
where it is brightest along the line of sight is known to a fraction of a millimetre. L_MF says
little of that: it compares whole maps, and is as well off with a spot that is a little too deep as
with one that is a little too wide. So the zero level is moved, after the training, by the one
number that brings rendered glints to the depth of the measured ones.
"""

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
MOST_INWARD = 0.375
"""By how much a surface is moved inward at most, in voxels of the trained field."""
INWARD_SHARE = 0.5
"""Of the depth of a part: inward it is moved by that at most."""
LEAST_SLOPE = 0.5
"""Of a distance towards the inside of a part: 1 beside its surface, about 0 in its middle."""
BESIDE_M = 0.02
"""How far from the surface a glint may be [m]: half a range cell."""
DEPTHS_M = np.arange(-0.03, 0.0305, 0.001)
"""Along the line of sight, from the glint; less than a range cell to either side."""
PLACES_AT_ONCE = 4096
_N_OF_PEAK = 3
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

    def after(self, differences: list[float], most_m: float) -> "GlintShift":
        """Look once more.

        differences: by how much glints are rendered behind the measured ones [m].
        most_m: inward the surface is moved by that at most [m].
        """
        n = len(differences)
        outside_m = 0.0 - float(np.median(differences)) if n >= _LEAST_GLINTS else 0.0
        inward_m = min(self.inward_m + outside_m, most_m)
        return GlintShift(inward_m, (*self.looks_m, outside_m), n)


def moved(sdf: SdfGrid, inward_m: float, depths: NDArray[np.float32]) -> SdfGrid:
    """Move the zero level inward, or outward where negative [m].

    Inward a part is moved by half of its depth at most, as what is thin would vanish.

    depths: of the part that each voxel belongs to, from :func:`part_depths` [m].
    """
    by = np.minimum(np.float32(inward_m), np.float32(INWARD_SHARE) * depths)
    return SdfGrid(grid=sdf.grid, values=sdf.values + by)


def part_depths(sdf: SdfGrid) -> NDArray[np.float32]:
    """Depth of the part that each voxel belongs to, 0 where nothing is inside [m].

    From each voxel the way goes to the neighbour to which the depth -f grows most, on and on, as
    long as it grows by half of what the way is long. It ends in the middle of a leg, of a neck or
    of a body: how deep that lies is the depth of the part.
    """
    depth = -sdf.values
    around = np.pad(depth, 1, constant_values=-np.inf)
    steepest = np.full(depth.shape, LEAST_SLOPE, dtype=np.float32)
    way = np.zeros(depth.shape, dtype=np.int64)  # to the deeper neighbour, in the flat array
    for step in itertools.product((-1, 0, 1), repeat=3):
        beside = tuple(slice(1 + k, 1 + k + n) for k, n in zip(step, depth.shape, strict=True))
        length_m = sdf.grid.spacing_m * max(float(np.linalg.norm(step)), 1.0)
        slope = (around[beside] - depth) / np.float32(length_m)
        is_steeper = slope > steepest
        steepest[is_steeper] = slope[is_steeper]
        way[is_steeper] = (step[0] * depth.shape[1] + step[1]) * depth.shape[2] + step[2]
    ends = np.arange(depth.size) + way.ravel()
    while ((further := ends[ends]) != ends).any():
        ends = further
    depths: NDArray[np.float32] = depth.ravel()[ends].reshape(depth.shape)
    return depths.clip(min=0.0)


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
