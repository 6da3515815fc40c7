"""True directions of grating lobes, from how ranges change between sub-apertures.

Antennas d apart cannot distinguish the direction cosines u and u + wavelength / (2 d): an echo from
beyond half of that period has a grating lobe within. From one sub-aperture to the next, a distance
b along the raster, the range of an echo changes by -b u of its true direction
(docs/math/images.md#direction-aliases). Peaks that no range confirms are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.imaging.peaks import PeakSet, directions_at
from geraf2.scene import Pose

_REACH_M = 0.045
"""Between sub-apertures that are compared: two steps."""
_OFF_M = 7e-4
"""Standard deviation of a range against the one that direction and range of the other give: 0.4 to
1.2 mm of range, and 2 to 6 degrees of direction over half of 2 cm."""
_FARTHEST_RANGE_M = 0.03
"""Ranges change by less over the reach, up to a cosine of 0.65."""
_TURN = 0.08
"""Change of the cosine along the other axis at most."""
_STRENGTH_DB = 10.0
_VOTES = 1.5
"""Sum of weights, each 1 where ranges fit exactly, that moves an echo."""
_MORE_VOTES = 2.0
"""And by so much more than those for its apparent direction."""
_MOST_PERIODS = 2
_LARGEST_COSINE = 0.9
_COARSE = 1.5
"""Spacing over Nyquist's above which lobes are as many as echoes; below, votes of single echoes
cost more than they bring."""
_NEIGHBOR_M = 0.025
"""Then echoes of a plane this near to each other vote together."""
_LEAST_SPAN_M = 0.03
"""Between the outermost sub-apertures: of fewer than three along an axis few have a neighbour."""
_CONFIRMED = 0.2
"""Votes for the direction of an echo that is believed: one pair whose ranges fit within 1.3 mm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sorted:
    """Peaks in the directions that their ranges support."""

    peaks: PeakSet
    n_moved: int
    """Peaks whose image shows another direction."""
    n_dropped: int
    """Peaks that no range confirms, which are left out."""


def without_grating_lobes(peaks: PeakSet, poses: Sequence[Pose], bounds: Floats) -> Sorted:
    """Peaks with grating lobes moved to their true direction; those without support are left out.

    peaks: of any planes of `poses`.
    bounds: lowest and highest corner of the box, (2, 3) [m]. An axis with a period that holds its
        longest side has no grating lobe within. Of one that holds two thirds of it, spacing below
        1.5 times Nyquist's, peaks are only left out: those that their neighbours place elsewhere
        in it.
    """
    planes, directions = peaks.planes, peaks.directions.copy()
    believed, n_moved = np.ones(len(peaks), dtype=bool), 0
    for number in np.unique(planes):
        own = np.flatnonzero(planes == number)
        believed[own], moved = _sorted_plane(peaks.select(own), poses[number], bounds)
        directions[own] = np.where(np.isnan(moved), directions[own], moved)
        n_moved += int((believed[own] & ~np.isnan(moved[:, 0])).sum())
    found = replace(peaks, directions=directions).select(believed)
    return Sorted(peaks=found, n_moved=n_moved, n_dropped=len(peaks) - len(found))


def _sorted_plane(peaks: PeakSet, pose: Pose, bounds: Floats) -> tuple[Bools, Floats]:
    """Which peaks of a plane are confirmed, (n,), and true directions of grating lobes, (n, 3).

    NaN where the image shows the true direction.
    """
    axes = pose.axes
    cosines = peaks.directions @ axes[1:].T
    places = peaks.subaperture_places[peaks.subapertures]
    width_m = float(np.ptp(bounds, axis=0).max())
    far_m = float((bounds.mean(axis=0) - pose.phase_centers.mean(axis=0)) @ axes[0])
    shifts, believed = np.zeros((len(places), 2)), np.ones(len(places), dtype=bool)
    for axis, period in enumerate(peaks.periods[peaks.subapertures[0]]):
        if period * far_m >= width_m:
            continue
        if len(places) < 2 or np.ptp(places[:, axis]) < _LEAST_SPAN_M:
            continue
        votes = votes_for_periods(places, cosines, peaks.ranges_m, peaks.magnitudes, axis, period)
        if _COARSE * period * far_m >= width_m:
            n = outvoted(peaks.points, votes)
            along = np.eye(2)[axis] * (n * period)[:, None]
            there = peaks.centers + peaks.ranges_m[:, None] * directions_at(cosines + along, axes)
            inside = ((there > bounds[0]) & (there < bounds[1])).all(axis=1)
            believed &= (n == 0) | ~inside
            continue
        n, own = periods_off(votes)
        shifts[:, axis] = n * period
        believed &= own >= _CONFIRMED
    moved = np.asarray((shifts != 0.0).any(axis=1))
    cosines = cosines + shifts
    believed &= (cosines**2).sum(axis=1) < _LARGEST_COSINE**2
    return believed, np.where(moved[:, None], directions_at(cosines, axes), np.nan)


def votes_for_periods(
    places: Floats,
    cosines: Floats,
    ranges_m: Floats,
    magnitudes: Floats,
    axis: int,
    period: float,
) -> Floats:
    """Votes that each echo's cosine along an axis is -2 to 2 periods off, (n, 5).

    places: middles of the sub-apertures along both axes, (n, 2) [m].
    cosines: along both axes, (n, 2). ranges_m, magnitudes: (n,).
    axis: 0 or 1. period: of the cosines along it.

    Of echoes i and j of two sub-apertures that lie b apart along the axis
    `R_j - R_i = -b (u_i + u_j) / 2` holds to third order in b for any smooth surface. The nearest
    number of periods counts with `exp(-r^2 / (2 sigma^2))` of what is then left.
    """
    n = len(places)
    i, j = _pairs(places, cosines, ranges_m, axis)
    b = places[j, axis] - places[i, axis]
    step = cosines[j, axis] - cosines[i, axis]
    turns = np.rint(-step / period)  # which bring j next to i
    step = step + turns * period
    level_db = 20.0 * np.log10(np.abs(magnitudes[j] / magnitudes[i]))
    bent = np.abs(step) <= 2.0 * np.abs(b) / np.minimum(ranges_m[i], ranges_m[j]) + 0.02
    fits = bent & (np.abs(level_db) <= _STRENGTH_DB)
    i, j, b, step, turns = (one[fits] for one in (i, j, b, step, turns))
    off = ranges_m[j] - ranges_m[i] + b * (cosines[i, axis] + 0.5 * step)
    number = np.rint(-off / (b * period))
    weight = np.exp(-0.5 * ((off + number * b * period) / _OFF_M) ** 2)
    votes = np.zeros((n, 2 * _MOST_PERIODS + 1))
    for echo, periods in ((i, number), (j, number + turns)):
        column = periods.astype(np.int64) + _MOST_PERIODS
        known = (column >= 0) & (column < votes.shape[1])
        np.add.at(votes, (echo[known], column[known]), weight[known])
    return votes


def periods_off(votes: Floats) -> tuple[Ints, Floats]:
    """How many periods each echo is off, (n,), and the votes for it, (n,).

    votes: of `votes_for_periods`. 0 where those for another are few.
    """
    rows = np.arange(len(votes))
    best = votes.argmax(axis=1)
    most = votes[rows, best]
    sure = (most >= _VOTES) & (most > _MORE_VOTES * votes[:, _MOST_PERIODS])
    chosen = np.where(sure, best, _MOST_PERIODS)
    return chosen - _MOST_PERIODS, votes[rows, chosen]


def outvoted(seen_at: Floats, votes: Floats) -> Ints:
    """By how many periods those around, and they themselves, put echoes elsewhere, (n,); 0: none.

    seen_at: where the image shows them, (n, 3) [m]. votes: of `votes_for_periods`.
    """
    i, j = KDTree(seen_at).query_pairs(_NEIGHBOR_M, output_type="ndarray").astype(np.int64).T
    together = votes.copy()
    np.add.at(together, i, votes[j])
    np.add.at(together, j, votes[i])
    best = together.argmax(axis=1)
    enough = together.max(axis=1) >= _VOTES
    return np.where(enough, best - _MOST_PERIODS, 0)


def _pairs(places: Floats, cosines: Floats, ranges_m: Floats, axis: int) -> tuple[Ints, Ints]:
    """Echoes of sub-apertures beside each other along an axis, each pair once."""
    other = 1 - axis
    scaled = np.column_stack(
        [
            places[:, axis] / _REACH_M,
            places[:, other] / 1e-3,
            ranges_m / _FARTHEST_RANGE_M,
            cosines[:, other] / _TURN,
        ]
    )
    pairs = KDTree(scaled).query_pairs(1.0, p=np.inf, output_type="ndarray").astype(np.int64)
    i, j = pairs.T
    apart = np.abs(places[i, axis] - places[j, axis]) > 1e-3
    return i[apart], j[apart]
