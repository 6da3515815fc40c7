"""Level of a trained surface from the depth of its glints.

A glint, the specular return of a smooth surface, has the width and depth of a resolution cell, but
the depth of its peak is known to a fraction of a millimetre. L_MF compares whole maps and is not
sensitive to that depth. After the training the zero level is therefore moved by the one distance
that brings rendered glints to the depth of the measured ones.
"""

import itertools
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from geraf2._types import Floats
from geraf2.fields import SdfGrid
from geraf2.learned.fields import LearnedSdfGrid, SdfField
from geraf2.learned.plane_draws import PlaneDraw, PlaneDraws
from geraf2.learned.plane_loss import PlaneLoss
from geraf2.learned.resources import PlaneThreads

SEED = 3
"""Seed of the windows and rays: the same for every training."""
INV_S = 800.0
"""Sharpness with which glints are rendered [1/m]: 2.6 / (s^2 r) of a ball of 46 mm is 0.1 mm."""
N_ROUNDS = 3
"""Rounds of measuring and moving: the rendered depth depends on the surface."""
N_WINDOWS = 4
"""Windows of antennas of a plane; each gives one glint."""
N_DRAWS = 2
"""Draws of a window's rays, over which the power of its glint is averaged."""
MAX_INWARD = 0.375
"""Largest displacement inward, in voxels of the trained field."""
INWARD_SHARE = 0.5
"""Largest displacement inward of a part, over its depth."""
MIN_SLOPE = 0.5
"""Least slope of the depth along a path inward: 1 near the surface, about 0 in the middle."""
BESIDE_M = 0.02
"""Largest distance of a glint from the surface [m]: half a range cell."""
DEPTHS_M = np.arange(-0.03, 0.0305, 0.001)
"""Depths along the line of sight from the glint; less than a range cell to either side."""
POINTS_AT_ONCE = 4096
_N_OF_PEAK = 3
_MIN_GLINTS = 3


class GlintShift(NamedTuple):
    """Displacement of a surface to the depth of its glints."""

    inward_m: float = 0.0
    """Displacement inward [m], outward where negative."""
    outside_m: tuple[float, ...] = ()
    """Median error of the glints' depth in each round, positive outside [m]; 0 with too few."""
    n_glints: int = 0
    """Number of glints in the last round."""

    def after(self, differences: list[float], max_m: float) -> "GlintShift":
        """Displacement after one more round.

        differences: depths of rendered glints behind the measured ones [m].
        max_m: largest displacement inward [m].
        """
        n = len(differences)
        outside_m = 0.0 - float(np.median(differences)) if n >= _MIN_GLINTS else 0.0
        inward_m = min(self.inward_m + outside_m, max_m)
        return GlintShift(inward_m, (*self.outside_m, outside_m), n)


def moved(sdf: SdfGrid, inward_m: float, depths: NDArray[np.float32]) -> SdfGrid:
    """Distance with its zero level moved inward, or outward where negative [m].

    A part is moved inward by at most half of its depth, so that thin parts remain.

    depths: of the part that each voxel belongs to, from :func:`part_depths` [m].
    """
    by = np.minimum(np.float32(inward_m), np.float32(INWARD_SHARE) * depths)
    return SdfGrid(grid=sdf.grid, values=sdf.values + by)


def part_depths(sdf: SdfGrid) -> NDArray[np.float32]:
    """Depth of the part that each voxel belongs to, 0 where nothing is inside [m].

    From each voxel a path of steepest ascent of the depth -f leads from neighbour to neighbour,
    while the slope is above one half. It ends in the middle of a leg, neck or body; the depth there
    is the depth of the part.
    """
    depth = -sdf.values
    around = np.pad(depth, 1, constant_values=-np.inf)
    steepest = np.full(depth.shape, MIN_SLOPE, dtype=np.float32)
    ascent = np.zeros(depth.shape, dtype=np.int64)  # to the deeper neighbour, in the flat array
    for step in itertools.product((-1, 0, 1), repeat=3):
        beside = tuple(slice(1 + k, 1 + k + n) for k, n in zip(step, depth.shape, strict=True))
        length_m = sdf.grid.spacing_m * max(float(np.linalg.norm(step)), 1.0)
        slope = (around[beside] - depth) / np.float32(length_m)
        is_steeper = slope > steepest
        steepest[is_steeper] = slope[is_steeper]
        ascent[is_steeper] = (step[0] * depth.shape[1] + step[1]) * depth.shape[2] + step[2]
    ends = np.arange(depth.size) + ascent.ravel()
    while ((further := ends[ends]) != ends).any():
        ends = further
    depths: NDArray[np.float32] = depth.ravel()[ends].reshape(depth.shape)
    return depths.clip(min=0.0)


def line_of_sight(glint: Floats, window: Floats) -> Floats:
    """Points at DEPTHS_M behind a glint (3,), seen from the middle of a window (3,), (n, 3) [m]."""
    sight = (glint - window) / np.linalg.norm(glint - window)
    return np.asarray(glint + DEPTHS_M[:, None] * sight)


def depth_difference(rendered: Floats, measured: Floats) -> float | None:
    """Depth of the rendered peak behind the measured one, from powers at DEPTHS_M [m].

    Uses the measured peak nearest to the middle and the rendered one nearest to it; None without.
    """
    true = _peak(measured, 0.0)
    found = None if true is None else _peak(rendered, true)
    return None if true is None or found is None else found - true


def _peak(powers: Floats, near_m: float) -> float | None:
    """Depth of the peak nearest to a depth, by a parabola through seven samples [m]."""
    inner = powers[1:-1]
    tops = 1 + np.flatnonzero((inner > powers[:-2]) & (inner >= powers[2:]))
    if not tops.size:
        return None
    top = int(tops[np.abs(DEPTHS_M[tops] - near_m).argmin()])
    near = slice(max(top - _N_OF_PEAK, 0), top + _N_OF_PEAK + 1)
    curve = np.polyfit(DEPTHS_M[near] - DEPTHS_M[top], powers[near], 2)
    if not curve[0] < 0.0:
        return float(DEPTHS_M[top])
    step = float(np.clip(-0.5 * curve[1] / curve[0], -1e-3 * _N_OF_PEAK, 1e-3 * _N_OF_PEAK))
    return float(DEPTHS_M[top]) + step


class GlintDepths:
    """Depths of rendered glints against measured ones, from windows of antennas of each plane.

    draws, loss, threads: of the training.
    """

    def __init__(self, draws: PlaneDraws, loss: PlaneLoss, threads: PlaneThreads) -> None:
        self._draws, self._loss, self._threads = draws, loss, threads

    def find_shift(self, sdf: SdfGrid, depths: NDArray[np.float32], max_m: float) -> GlintShift:
        """Shift that brings the glints of a distance to their measured depth.

        depths: as in :func:`moved` [m].
        max_m: largest shift inward [m].
        """
        points = self._loss.maps.grid.points()[self._draws.within.reshape(-1)]
        points = points[np.abs(sdf.sample(points)) < BESIDE_M]
        shift = GlintShift()
        if not points.size:  # no surface
            return shift
        for _ in range(N_ROUNDS):
            now = moved(sdf, shift.inward_m, depths)
            field = LearnedSdfGrid(self._loss.model.sdf.domain)
            field.regrid(now.grid, torch.from_numpy(now.values))
            find = partial(self._depth, field=field.to(self._draws.device), points=points)
            with self._draws.aside():
                self._draws.generator.manual_seed(SEED)
                found = [
                    depth
                    for plane in self._draws.planes
                    for depth in self._threads.map(find, self._windows(plane))
                ]
            shift = shift.after([depth for depth in found if depth is not None], max_m)
        return shift

    def _windows(self, plane: int) -> list[list[PlaneDraw]]:
        """Windows of antennas of a plane, each with several draws of rays."""
        windows = []
        for _ in range(N_WINDOWS):
            draws = [self._draws.draw(plane) for _ in range(N_DRAWS)]
            windows.append([draw._replace(antennas=draws[0].antennas) for draw in draws])
        return windows

    @torch.no_grad()
    def _depth(self, draws: list[PlaneDraw], field: SdfField, points: Floats) -> float | None:
        """Distance of the rendered glint of a window behind the measured one [m]."""
        first = draws[0]
        signals = [self._loss.render(draw, INV_S, field).signal for draw in draws]
        rendered, measured = self._powers(first, signals[0], points)
        glint = points[int((rendered * measured).argmax())]
        pose = self._draws.capture.poses[first.plane]
        line = line_of_sight(glint, pose.phase_centers[first.antennas].mean(axis=0))
        powers = [self._powers(first, signal, line) for signal in signals]
        return depth_difference(np.sum([p for p, _ in powers], axis=0), powers[0][1])

    def _powers(self, draw: PlaneDraw, signal: Tensor, points: Floats) -> tuple[Floats, Floats]:
        """Powers of the rendered and of the measured map at points (n, 3) [m], (n,) each."""
        parts = np.array_split(points, -(-len(points) // POINTS_AT_ONCE))
        maps = [
            self._loss.heat_maps(draw._replace(targets=torch.from_numpy(part)), signal)
            for part in parts
        ]
        rendered, measured = (
            torch.cat(m).double().square().cpu().numpy() for m in zip(*maps, strict=True)
        )
        return rendered, measured
