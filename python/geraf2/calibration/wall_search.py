"""Walls of a box that is no cuboid, each with a normal of its own, from peaks of a scan.

Corners may be off a right angle, and walls may lean (docs/math/calibration.md#box-from-the-scan).
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from geraf2._types import Floats, Ints
from geraf2.calibration.box_search import (
    FLASH_NATS,
    LEVEL_RANGE_DB,
    LEVEL_STEP_DB,
    LOWEST_PAIR_DB,
    MAX_ANGLE_RAD,
    MAX_SHIFT_M,
    MIN_COUNT,
    N_LEVELS,
    OFFSET_SIGMA_M,
    OFFSET_STEP_M,
    BoxSearch,
    Counts,
    Flashes,
    Hypothesis,
    RoughFaces,
    shift_penalty,
    shifted,
)
from geraf2.records import Waveform

# Largest angle between a wall and the side of a cuboid, about the vertical and against it [rad].
_MAX_TURN_RAD, _MAX_LEAN_RAD = 0.4, 0.24
# Number of normals with most flashes that are tried: four walls, content and grating lobes.
_N_NORMALS = 24
# Least number of walls: content has two faces at some angle more often.
_MIN_WALLS = 3
# Rounds of a normal's mean.
_N_ROUNDS = 3
# Flashes that a free wall costs, by the number of its distinct normals.
_FREEDOM = float(np.log(_MAX_TURN_RAD * _MAX_LEAN_RAD / MAX_ANGLE_RAD**2)) / FLASH_NATS


class _Choice(NamedTuple):
    found: Hypothesis
    walls: Ints
    """Indices of the walls' normals."""


def find_walls(
    flashes: Flashes, up: Floats, reach_m: float, waveform: Waveform
) -> RoughFaces | None:
    """Box of four walls at any angles with most flashes, at one level and one delay.

    up: the box's vertical, (3,). reach_m: distance of the planes [m].
    Returns None with fewer than three walls.
    """
    search = BoxSearch(flashes, up, reach_m, waveform)
    normals = _dense_normals(search)
    counts = [flashes.counts(normal, search.n_offsets) for normal in normals]
    azimuth = np.arctan2(normals @ search.second, normals @ search.first)
    best = max(
        (_best_walls(search, counts, azimuth, pair) for pair in search.pairs),
        key=lambda choice: choice.found.score,
    )
    tries = *normals[best.walls], -up, up
    planes = [_plane(search, normal, best.found) for normal in tries]
    if np.isfinite([offset for _, offset in planes[:-2]]).sum() < _MIN_WALLS:
        return None
    return _box([plane for plane in planes if np.isfinite(plane[1])], search, best.found)


def _best_walls(
    search: BoxSearch, counts: list[tuple[Counts, Counts]], azimuth: Floats, pair: int
) -> _Choice:
    """Best normals of four walls, level and delay. counts: of each normal."""
    start, most = search.unmoved if pair else 0, round(MAX_SHIFT_M / OFFSET_STEP_M)
    shifts = [start + s for s in range(-most, most + 1, 2)]

    def scores(sides: list[tuple[Counts, Counts]]) -> Floats:
        """Count of each side, delay and level, (n, n_shifts, n_levels)."""
        found = []
        for near, far in sides:
            n, f = near.score(pair), far.score(pair)
            found.append([(shifted(n, s) + shifted(f, -s)).max(axis=0) for s in shifts])
        return np.array(found)

    score, ends = scores(counts), scores(search.upright).sum(axis=0)
    ends -= np.array([shift_penalty(s - start) for s in shifts])[:, None]
    ends[:, : search.lowest_level(pair)] = -np.inf
    best = _Choice(Hypothesis(0.0, 0.0, 0, 0, 0), np.zeros(0, dtype=np.int64))
    for number, turn in enumerate(azimuth):
        off = azimuth - turn - 0.5 * np.pi * np.arange(4)[:, None]
        alike = np.abs(np.angle(np.exp(1j * off))) < _MAX_TURN_RAD
        alike[0] = np.arange(len(azimuth)) == number
        sides = np.where(alike[..., None, None], score, 0.0).max(axis=1)
        total = ends + np.maximum(sides - _FREEDOM, 0.0).sum(axis=0)
        row, level = divmod(int(total.argmax()), N_LEVELS)
        if total[row, level] > best.found.score:
            seen = sides[:, row, level] > MIN_COUNT
            walls = np.where(alike, score[:, row, level], -1.0).argmax(axis=1)[seen]
            found = Hypothesis(float(total[row, level]), turn, shifts[row], pair, level)
            best = _Choice(found, walls)
    return best


def _dense_normals(search: BoxSearch) -> Floats:
    """Return normals around which most flashes of near and far walls have one offset, (n, 3)."""
    flashes, most = search.flashes, round(_MAX_LEAN_RAD / MAX_ANGLE_RAD)
    azimuth = np.arctan2(flashes.normals @ search.second, flashes.normals @ search.first)
    lean = np.arcsin(np.clip(flashes.normals @ search.up, -1.0, 1.0))
    offset = flashes.offsets_m // OFFSET_STEP_M
    shape = round(2.0 * np.pi / MAX_ANGLE_RAD), 2 * most + 1, search.n_offsets, 2
    turn, tilt = np.rint(azimuth / MAX_ANGLE_RAD) % shape[0], np.rint(lean / MAX_ANGLE_RAD) + most
    cells = np.stack([turn, tilt, offset, flashes.far], axis=1).astype(np.int64)
    used = ((cells >= 0) & (cells < shape)).all(axis=1) & (flashes.levels_db > LOWEST_PAIR_DB)
    flat = np.ravel_multi_index(tuple(cells[used].T), shape)
    count = np.bincount(flat, flashes.weights[used], int(np.prod(shape))).reshape(shape)
    modes = ["wrap", "constant", "constant"]
    widths = 1.0, 1.0, OFFSET_SIGMA_M / OFFSET_STEP_M
    density = gaussian_filter(count, widths, axes=(0, 1, 2), mode=modes).max(axis=2).sum(axis=-1)
    density[density < maximum_filter(density, 3, mode=modes[:2])] = 0.0
    best = np.argsort(density, axis=None)[::-1][:_N_NORMALS]
    turn, tilt = (MAX_ANGLE_RAD * np.array(each) for each in np.unravel_index(best, density.shape))
    tilt -= MAX_ANGLE_RAD * most
    level = np.outer(np.cos(turn), search.first) + np.outer(np.sin(turn), search.second)
    return np.asarray(np.cos(tilt)[:, None] * level + np.outer(np.sin(tilt), search.up))


def _plane(search: BoxSearch, normal: Floats, found: Hypothesis) -> tuple[Floats, float]:
    """Mean normal of a wall's flashes, and its offset [m]; NaN without."""
    flashes, pair_m = search.flashes, OFFSET_STEP_M * found.pair
    moved = flashes.offsets_m + OFFSET_STEP_M * found.shift * np.where(flashes.far, -1.0, 1.0)
    off_db = np.abs(flashes.levels_db - LEVEL_STEP_DB * (found.level + 1 - N_LEVELS))
    for _ in range(_N_ROUNDS):
        offset = search.outermost(flashes.counts(normal, search.n_offsets), found)
        off_m = np.abs(np.abs(moved - offset) - pair_m)
        own = (off_m < 2.0 * OFFSET_SIGMA_M) & (off_db < LEVEL_RANGE_DB)
        own &= flashes.normals @ normal > np.cos(MAX_ANGLE_RAD)
        if own.any():
            normal = flashes.weights[own] @ flashes.normals[own]
            normal /= np.linalg.norm(normal)
    return normal, offset


def _box(planes: list[tuple[Floats, float]], search: BoxSearch, found: Hypothesis) -> RoughFaces:
    """Box of these planes; an unseen wall has the turn and the lean of the opposite one."""
    normals = np.array([normal for normal, _ in planes])
    azimuth = np.arctan2(normals @ search.second, normals @ search.first)
    upright = np.abs(normals @ search.up) < np.sin(_MAX_LEAN_RAD + MAX_ANGLE_RAD)
    axes = search.axes(0.25 * float(np.angle(np.exp(4j * azimuth[upright]).sum())))
    faces, offsets = np.full((3, 2, 3), np.nan), np.full((3, 2), np.nan)
    for normal, offset in planes:
        k = int(np.abs(axes @ normal).argmax())
        side = int(axes[k] @ normal > 0.0)
        faces[k, side], offsets[k, side] = normal, offset
    mirror = 2.0 * np.outer(search.up, search.up) - np.eye(3)
    faces = np.where(np.isnan(faces), faces[:, ::-1] @ mirror, faces)
    faces = np.where(np.isnan(faces), np.stack([-axes, axes], axis=1), faces)
    return search.rough(axes, faces, offsets, found)
