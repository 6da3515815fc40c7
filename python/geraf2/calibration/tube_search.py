"""An upright tube or drum of board, from peaks of a scan.

A sub-aperture that faces the axis sees a flash of the near wall, and through the tube one of the
far wall. Both lie in the tangent plane at the distance radius + n . center from the origin, as the
faces of a box, but for every horizontal normal n (docs/math/calibration.md#box-from-the-scan).
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.calibration.box_search import (
    LEVEL_RANGE_DB,
    LEVEL_STEP_DB,
    LOWEST_PAIR_DB,
    MAX_ANGLE_RAD,
    MAX_SHIFT_M,
    MIN_COUNT,
    MIN_SIDE_M,
    N_LEVELS,
    OFFSET_SIGMA_M,
    OFFSET_STEP_M,
    Counts,
    Flashes,
    across,
    shift_penalty,
    shifted,
)
from geraf2.calibration.wall_echoes import OVERLAP
from geraf2.echoes.wall_delay import UNKNOWN_MIDDLES_M

# Largest distance of the axis from the middle of the scan, and steps of its search [m]: an axis
# that is off by the first one is off by less than `MAX_ANGLE_RAD` seen from the antennas.
_OFF_M, _STEPS_M = 0.036, (0.012, 0.004)
# Largest angle between looking direction and the horizontal [rad].
_LEVEL_RAD = 0.2
# Rounds of the fit.
_N_ROUNDS = 5


class TubeFit(NamedTuple):
    """Tube by its flashes."""

    score: float
    """Count of flashes, as that of a box."""
    axes: Floats
    """Unit vectors in rows, the last along the tube, (3, 3)."""
    center_m: Floats
    """Point of the axis, (3,) [m]."""
    radius_m: float
    """Of the outer side."""
    radius_sigma_m: float


class _Guess(NamedTuple):
    score: float
    center: tuple[float, float]
    """Across the vertical [m]."""
    offset: int
    """Radius in cells of the offset."""
    shift: int
    """Error of the delay, in cells."""
    level: int


def find_tube(flashes: Flashes, up: Floats, reach_m: float) -> TubeFit | None:
    """Tube with most flashes; None without echoes of its near and of its far wall.

    up: its axis, to some degrees, (3,). reach_m: distance of the planes [m].
    """
    search = _TubeSearch(flashes, up, reach_m)
    coarse, fine = _STEPS_M
    steps = np.arange(-_OFF_M, _OFF_M + 0.5 * coarse, coarse)
    best = max(search.best((x, y)) for x, y in product(steps, steps))
    if best.score < MIN_COUNT:
        return None
    for step in (fine, 0.25 * fine):
        near = [np.array(best.center) + step * np.array(by) for by in product((-1, 0, 1), repeat=2)]
        best = max(search.best((float(x), float(y))) for x, y in near)
    return search.fit(best)


class _TubeSearch:
    """Flashes of upright walls, relative to an axis."""

    def __init__(self, flashes: Flashes, up: Floats, reach_m: float) -> None:
        self.flashes, self.up = flashes, up
        self.first, self.second = across(up)
        self.n_offsets = max(int(reach_m / OFFSET_STEP_M), 2)
        self.upright = np.flatnonzero(np.abs(flashes.normals @ up) < np.sin(MAX_ANGLE_RAD))
        self.normals = flashes.normals[self.upright]
        self.offsets = flashes.offsets_m[self.upright]
        self.far = flashes.far[self.upright]
        self.centers = flashes.centers[flashes.subapertures[self.upright]]
        self.n_facing = int((np.abs(flashes.ahead @ up) < np.sin(_LEVEL_RAD)).sum())
        most = round(MAX_SHIFT_M / OFFSET_STEP_M)
        self.shifts = range(-most, most + 1, 2)

    def point(self, center: tuple[float, float]) -> Floats:
        return center[0] * self.first + center[1] * self.second

    def radii(self, center: tuple[float, float]) -> tuple[Floats, Floats, Bools]:
        """Radius by each flash, its angle to the axis [rad], and whether it may be one."""
        point = self.point(center)
        away = self.centers - point
        away -= np.outer(away @ self.up, self.up)
        toward = away / np.linalg.norm(away, axis=1, keepdims=True)
        cosine = np.einsum("ij,ij->i", self.normals, toward) * np.where(self.far, -1.0, 1.0)
        radius = self.offsets - self.normals @ point
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        is_one = (angle < MAX_ANGLE_RAD) & (radius > 0.5 * MIN_SIDE_M)
        return radius, angle, is_one & (radius < self.n_offsets * OFFSET_STEP_M)

    def best(self, center: tuple[float, float]) -> _Guess:
        """Best radius, delay and level of a tube around an axis."""
        radius, angle, is_one = self.radii(center)
        near = self._counts(radius, angle, is_one & ~self.far, self.n_facing)
        far = self._counts(radius, angle, is_one & self.far, 0)  # content hides it
        found = [_Guess(0.0, center, 0, 0, 0)]
        lowest = N_LEVELS + int(LOWEST_PAIR_DB / LEVEL_STEP_DB)
        scores = near.score(0), far.score(0)
        for shift in self.shifts:
            total = np.minimum(
                *(shifted(s, by) for s, by in zip(scores, (-shift, shift), strict=True))
            )
            total[:, : max(lowest, 0)] = 0.0
            offset, level = divmod(int(total.argmax()), N_LEVELS)
            score = 2.0 * float(total.max()) - shift_penalty(shift)
            found.append(_Guess(score, center, offset, shift, level))
        return max(found)

    def _counts(self, radius: Floats, angle: Floats, used: Bools, n_facing: int) -> Counts:
        """Flashes of one side of the wall."""
        own = self.upright[used]
        weights = self.flashes.weights[own] * (1.0 - (angle[used] / MAX_ANGLE_RAD) ** 2)
        return Counts(self.flashes.density(own, radius[used], weights, self.n_offsets), n_facing)

    def fit(self, guess: _Guess) -> TubeFit:
        """Tube by least squares, reweighted: centre, lean, radius, and error of the delay."""
        radius, _, is_one = self.radii(guess.center)
        side = np.where(self.far, -1.0, 1.0)
        off = radius - OFFSET_STEP_M * (guess.offset + 0.5 + side * guess.shift)
        level = self.flashes.levels_db[self.upright]
        walls_db = LEVEL_STEP_DB * (guess.level + 1 - N_LEVELS)
        used = is_one & (np.abs(off) < 3.0 * OFFSET_SIGMA_M)
        used &= np.abs(level - walls_db) < LEVEL_RANGE_DB
        own = _nearest(
            np.flatnonzero(used), np.abs(off), self.flashes.subapertures[self.upright], self.far
        )
        horizontal = self.normals[own] @ np.stack([self.first, self.second], axis=1)
        matrix = np.column_stack([horizontal, np.ones(len(own)), side[own]])
        weight, values = np.ones(len(own)), np.zeros(4)
        for _ in range(_N_ROUNDS):
            root = np.sqrt(weight)[:, None]
            values = np.linalg.lstsq(root * matrix, root[:, 0] * self.offsets[own], rcond=None)[0]
            rest = self.offsets[own] - matrix @ values
            scale = max(1.4826 * float(np.median(np.abs(rest))), 1e-4)
            weight = 5.0 / (4.0 + (rest / scale) ** 2)
        covariance = np.linalg.pinv((weight[:, None] * matrix).T @ matrix) * scale**2 * OVERLAP
        sigmas = np.sqrt(np.diag(covariance))
        middles_m = 0.5 * np.hypot(UNKNOWN_MIDDLES_M[0][1], UNKNOWN_MIDDLES_M[1][1])
        # A horizontal normal turns with the axis: n . axis = 0.
        lean = np.linalg.lstsq(horizontal, -self.normals[own] @ self.up, rcond=None)[0]
        axis = self.up + lean[0] * self.first + lean[1] * self.second
        axis /= np.linalg.norm(axis)
        second = np.cross(axis, self.first)
        second /= np.linalg.norm(second)
        return TubeFit(
            score=guess.score,
            axes=np.stack([np.cross(second, axis), second, axis]),
            center_m=self.point((float(values[0]), float(values[1]))),
            radius_m=float(values[2]),
            radius_sigma_m=float(np.hypot(sigmas[2], middles_m)),
        )


def _nearest(index: Ints, off: Floats, subapertures: Ints, far: Bools) -> Ints:
    """Of each sub-aperture the flash of the near and of the far wall with the least deviation."""
    order = index[np.argsort(off[index], kind="stable")]
    key = 2 * subapertures[order] + far[order]
    return order[np.unique(key, return_index=True)[1]]
