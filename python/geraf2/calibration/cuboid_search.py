"""Search for the cuboid whose walls explain most flashes of a scan, and for the delay.

Hypotheses are compared by how many sub-apertures have their flashes
(docs/math/calibration.md#box-from-the-scan).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from geraf2._types import Floats
from geraf2.calibration.box_search import (
    LEVEL_STEP_DB,
    LOWEST_DB,
    LOWEST_PAIR_DB,
    MAX_SHIFT,
    MIN_SIDE_M,
    N_LEVELS,
    NATS,
    OFFSET_STEP_M,
    Counts,
    Flashes,
    RoughFaces,
    shifted,
)
from geraf2.echoes.wall_delay import (
    DEGREES_OF_FREEDOM,
    DELAY_SIGMA_M,
    PAIR_SHARES,
    pair_distance_m,
)
from geraf2.errors import UserError
from geraf2.scene import LosPrior, Waveform

# Steps of the yaw in the first search and around its best.
_YAW_STEPS_RAD = np.deg2rad([1.5, 0.25])
_COARSE_YAWS_RAD = np.arange(-0.25 * np.pi, 0.25 * np.pi, _YAW_STEPS_RAD[0])
# An expected yaw is preferred within this angle, if it has this share of the highest score.
_LIKE_RAD, _LIKE_SHARE = np.deg2rad(4.0), 0.7
# Other yaws are tried, at most so many, if they have this share of the highest score.
_RIVAL_SHARE, _MAX_RIVALS = 0.9, 3
MAX_PATH_M = 0.6
"""Longest instrument delay of radar boards and their cables, on the two-way path [m]."""
# Log odds against a rare error, a wrong record of a delay or of a box, of which one in 100 has it.
_RARE_NATS = float(np.log(100.0))
# Error of a given box's faces, by a tape measure and by its place on the turntable [m].
_GIVEN_SIGMA_M = 0.005
# Least count of a wall, and least share of the largest count on its side.
_MIN_COUNT, _MIN_SHARE = 1.0, 0.5


def shift_penalty(cells: int) -> float:
    """Flashes that an error of the delay costs by its Student-t. cells: the error, in offsets."""
    scaled = cells * OFFSET_STEP_M / DELAY_SIGMA_M
    nats = 0.5 * (DEGREES_OF_FREEDOM + 1.0) * np.log1p(scaled**2 / DEGREES_OF_FREEDOM)
    return float(nats / NATS)


class Hypothesis(NamedTuple):
    """Score of a cuboid, for the best level and delay at a yaw."""

    score: float
    yaw_rad: float
    shift: int
    """Error of the delay, in cells of the offset."""
    pair: int
    """Half the distance of a wall's two echoes, in cells."""
    level: int


class BoxSearch:
    """Search for the cuboid with most flashes at one level and one delay.

    reach_m: distance of the planes, beyond which no wall lies [m].
    up: the box's vertical, an axis of the frame, (3,).
    margin: cells by which an error of the delay may exceed that of a recorded one.
    """

    def __init__(
        self, flashes: Flashes, up: Floats, reach_m: float, waveform: Waveform, margin: int = 0
    ) -> None:
        self.flashes, self.up, self.margin = flashes, up, margin
        self.reach_m, self.waveform = reach_m, waveform
        self.first = np.abs(np.roll(up, 1))
        self.second = np.cross(up, self.first)
        self.n_offsets = max(int(reach_m / OFFSET_STEP_M), 2)
        pair_m = pair_distance_m(waveform)
        shares = [round(share * pair_m / OFFSET_STEP_M) for share in PAIR_SHARES]
        self.pairs = sorted({0, *shares})
        # A pair of echoes lies around the middle of the faces.
        self.unmoved = -round(flashes.loss_shift_m / OFFSET_STEP_M)
        self.upright = [flashes.counts(normal, self.n_offsets, margin) for normal in (-up, up)]

    def axes(self, yaw_rad: float) -> Floats:
        """Axes of a box, (3, 3)."""
        x = np.cos(yaw_rad) * self.first + np.sin(yaw_rad) * self.second
        return np.stack([x, np.cross(self.up, x), self.up])

    def sides(self, yaw_rad: float) -> list[tuple[Counts, Counts]]:
        """Flashes of the faces against and along each axis."""
        x, y, _ = self.axes(yaw_rad)
        upright = [-x, x, -y, y]
        return [self.flashes.counts(n, self.n_offsets, self.margin) for n in upright] + self.upright

    def lowest_level(self, pair: int) -> int:
        """Index of the lowest level of walls. pair: half the distance of two echoes, in cells."""
        return N_LEVELS + int((LOWEST_PAIR_DB if pair else LOWEST_DB) / LEVEL_STEP_DB)

    def scores(
        self,
        sides: list[tuple[Counts, Counts]],
        pair: int,
        penalties: Mapping[int, float],
        around_m: Floats | None = None,
    ) -> Floats:
        """Score of each error of the delay, by level, (n_shifts, n_levels).

        penalties: by the error, in cells of the offset.
        around_m: offsets that the sides of a given box have, (6,) [m].
        """
        start, margin = self.unmoved if pair else 0, self.margin
        most = max(abs(shift) for shift in penalties)
        low = max(margin + round(0.5 * MIN_SIDE_M / OFFSET_STEP_M), most)
        high = self.n_offsets + min(margin, 2 * margin - most)
        shifts, levels = np.array(list(penalties))[:, None], slice(self.lowest_level(pair), None)
        total = np.full((len(shifts), N_LEVELS), -np.inf)
        total[:, levels] = -np.array(list(penalties.values()))[:, None]
        for side, (near, far) in enumerate(sides):
            n, f = shifted(near.score(pair), start), shifted(far.score(pair), -start)
            first, last, off = low, high, np.zeros(1)
            if around_m is not None:
                given = around_m[side] / OFFSET_STEP_M + margin
                reach = 3.0 * _GIVEN_SIGMA_M / OFFSET_STEP_M
                first, last = np.clip([int(given - reach), int(given + reach)], low, high - 1)
                off = (np.arange(first, last) + 0.5 - given) * OFFSET_STEP_M
            away = 0.5 * (off / _GIVEN_SIGMA_M) ** 2 / NATS
            at = np.arange(first, last)
            both = n[:, levels].T.take(at - shifts, axis=1)
            both += f[:, levels].T.take(at + shifts, axis=1)
            both -= away
            total[:, levels] += both.max(axis=-1, initial=0.0).T
        return total

    def bound(self, yaw_rad: float, pairs: Iterable[int] = (0,)) -> float:
        """Largest score at a yaw if near and far walls had delays of their own."""
        kinds, largest = [kind for side in self.sides(yaw_rad) for kind in side], 0.0
        for pair in pairs:
            both = np.sum([kind.largest(pair) for kind in kinds], axis=0)
            largest = max(largest, float(both[self.lowest_level(pair) :].max()))
        return largest

    def best(self, yaws: Floats, shifts: Sequence[int], least: float = 1.0) -> list[Hypothesis]:
        """Best hypothesis at each yaw; of score -inf where it is below a share of the highest.

        shifts: of the delay, in cells of the offset.
        least: the share.
        """
        penalties = {shift: shift_penalty(shift) for shift in shifts}
        found = [Hypothesis(-np.inf, yaw, 0, 0, 0) for yaw in yaws.tolist()]
        bounds = [self.bound(yaw, self.pairs) for yaw in yaws]
        for number in np.argsort(bounds)[::-1]:
            if bounds[number] < least * max(found).score:
                break
            yaw = float(yaws[number])
            sides, tries = self.sides(yaw), []
            for pair in self.pairs:
                total = self.scores(sides, pair, penalties)
                level = int(total.max(axis=0).argmax())
                share = np.exp(NATS * (total[:, level] - total.max()))
                # The mean, since without far walls nothing but the record tells the delay.
                shift = round(float(share @ shifts / share.sum()))
                shift += self.unmoved if pair else 0
                tries.append(Hypothesis(float(total.max()), yaw, shift, pair, level))
            found[number] = max(tries)
        return found

    @cached_property
    def coarse(self) -> list[Hypothesis]:
        """Best hypothesis with about the recorded delay at each yaw of the first search."""
        return self.best(_COARSE_YAWS_RAD, range(-MAX_SHIFT, MAX_SHIFT + 1, 2), _LIKE_SHARE)

    @property
    def rivals(self) -> list[Hypothesis]:
        """Hypotheses of the first search with nearly the highest score, the best first."""
        score = np.array([each.score for each in self.coarse])
        is_peak = (score >= np.roll(score, 1)) & (score >= np.roll(score, -1))
        is_peak &= score >= _RIVAL_SHARE * score.max()
        found = (self.coarse[k] for k in np.flatnonzero(is_peak))
        return sorted(found, reverse=True)[:_MAX_RIVALS]

    def faces(self, found: Hypothesis) -> Floats:
        """Outermost plane of each side with enough flashes, (3, 2) [m]; NaN without."""
        offsets = [self._outermost(side, found) for side in self.sides(found.yaw_rad)]
        return np.array(offsets).reshape(3, 2)

    def _outermost(self, side: tuple[Counts, Counts], found: Hypothesis) -> float:
        """Outermost offset of a side with enough flashes [m]; NaN without.

        side: near and far flashes of its normal.
        """
        near, far = (counts.score(found.pair) for counts in side)
        score = shifted(near, found.shift) + shifted(far, -found.shift)
        count = score[:, found.level]
        count[: round(0.5 * MIN_SIDE_M / OFFSET_STEP_M)] = 0.0
        least = max(_MIN_COUNT, _MIN_SHARE * float(count.max()))
        rises, falls = np.diff(count, prepend=0.0) > 0.0, np.diff(count, append=0.0) <= 0.0
        peaks = np.flatnonzero(rises & falls & (count >= least))
        return (peaks[-1] + 0.5) * OFFSET_STEP_M if len(peaks) else np.nan


def rough_faces(search: BoxSearch, like: Floats | None = None) -> Iterator[RoughFaces]:
    """Cuboids around the origin of which most sub-apertures show flashes, the best first.

    The walls of a box have one level, and one error of the delay moves near and far walls apart. A
    flat face of content is seen from few sides, or differs in level.

    like: axes that are preferred if nearly as many flashes agree, (3, 3).
    """
    coarse, fine = _YAW_STEPS_RAD
    rivals = search.rivals
    if like is not None:
        side = like[int(np.abs(like @ search.up).argmin())]
        turn = np.array([each.yaw_rad for each in search.coarse])
        turn -= np.arctan2(side @ search.second, side @ search.first)
        near = np.abs(turn - 0.5 * np.pi * np.rint(turn / (0.5 * np.pi))) < _LIKE_RAD
        alike = max(each for each, is_near in zip(search.coarse, near, strict=True) if is_near)
        if alike.score > _LIKE_SHARE * max(each.score for each in search.coarse):
            rivals.insert(0, alike)
    for rival in rivals:
        yaws = rival.yaw_rad + np.arange(-coarse, coarse + 0.5 * fine, fine)
        best = max(search.best(yaws, range(-MAX_SHIFT, MAX_SHIFT + 1)))
        yield RoughFaces(
            axes=search.axes(best.yaw_rad),
            offsets_m=search.faces(best),
            shift_m=best.shift * OFFSET_STEP_M,
            pair_m=best.pair * OFFSET_STEP_M,
        )


@dataclass(frozen=True, kw_only=True)
class DelayOdds:
    """Instrument delays at which a scan's near and far walls lie on one box."""

    recorded_m: float
    """Recorded delay, on the two-way path [m]."""
    is_recorded: bool
    """Whether it was measured or given."""
    other_m: float
    """Likeliest other one, more than `MAX_SHIFT_M` of range away [m]."""
    odds: float
    """Log-likelihood ratio of the other one against the recorded one [nats]."""
    best_m: float
    """Likeliest of all if the box is one that was given [m]."""
    lead: float
    """Log-likelihood ratio of it against all others [nats]."""
    box_odds: float
    """Log-likelihood ratio of the given box at any delay against the recorded delay [nats]."""

    @property
    def change_m(self) -> float:
        """Change of the recorded delay that is sure [m].

        Raises UserError where the delay is unknown, or contradicts the given box.
        """
        if self.is_recorded and self.odds > 2.0 * _RARE_NATS:
            return self.other_m - self.recorded_m
        if not self.is_recorded and self.lead > _RARE_NATS:
            return self.best_m - self.recorded_m
        if not self.is_recorded:
            raise DelayUnknownError(
                what="the instrument delay was not recorded, and the scan does not show it",
                expected="echoes of opposite walls from both sides, which agree at one delay alone",
                got="echoes that fit any delay, each with another size of the box",
                hint="give the delay as path_bias_m in scene.toml, or, if no box is stated yet, "
                "its outside with --box X Y Z",
            )
        if self.box_odds > _RARE_NATS:
            raise DelayUnknownError(
                what="the recorded delay and the box contradict each other",
                expected=f"walls of the box at a delay of {1e3 * self.recorded_m:.0f} mm of path",
                got=f"walls that fit it at {1e3 * self.best_m:.0f} mm, or a box of another size",
                hint="correct path_bias_m in scene.toml, or the box; leave the box out with "
                "[[walls]], or keep both with --trust-los",
            )
        return 0.0

    def __str__(self) -> str:
        if self.is_recorded:
            return (
                f"the recorded delay of {1e3 * self.recorded_m:.0f} mm of path was corrected to "
                f"{1e3 * self.other_m:.0f} mm, where near and far walls agree (log odds "
                f"{self.odds:.0f}); --calibrate no keeps it"
            )
        return (
            f"the delay was not recorded: with this box it is {1e3 * self.best_m:.0f} mm of path "
            f"(log odds {self.lead:.0f})"
        )


class DelayUnknownError(UserError):
    """The instrument delay of a scan is unknown, or contradicts its box."""


def delay_odds(
    search: BoxSearch, box: LosPrior | None = None, *, is_recorded: bool = True
) -> DelayOdds:
    """Compare all delays that the hardware allows by the flashes that one cuboid explains.

    With a wrong delay, the near walls of a box move together and the far ones apart. Near walls
    alone fit any delay; with a given box, they fit one.

    search: of the scan with the recorded delay.
    box: cuboid that is given, in the same frame; wrong once in a hundred.
    """
    recorded_m = search.waveform.path_bias_m
    low = min(int(-0.5 * recorded_m / OFFSET_STEP_M), -MAX_SHIFT)
    high = max(int(0.5 * (MAX_PATH_M - recorded_m) / OFFSET_STEP_M), MAX_SHIFT)
    shifts = np.arange(low + low % 2, high + 1, 2)
    penalties = dict.fromkeys(shifts.tolist(), 0.0)
    wide = BoxSearch(search.flashes, search.up, search.reach_m, search.waveform, max(-low, high))
    # The recorded delay may be wrong, and with it the yaws that fit it.
    yaws = [max(_COARSE_YAWS_RAD, key=wide.bound), *(rival.yaw_rad for rival in search.rivals)]
    if box is not None and box.cuboid is not None:
        side = box.cuboid[0][int(np.abs(box.cuboid[0] @ search.up).argmin())]
        yaws.append(float(np.arctan2(side @ search.second, side @ search.first)))
    near = np.abs(shifts) <= MAX_SHIFT
    free, given = np.max([_delay_scores(wide, yaw, penalties, box) for yaw in yaws], axis=0)
    other = int(np.where(near, -1.0, free).argmax())
    given = np.where(given > 0.0, given + 2.0 * _RARE_NATS / NATS, 0.0)
    total = np.maximum(free, given)
    best = int(total.argmax())
    rest = total[np.abs(shifts - shifts[best]) > MAX_SHIFT].max()
    return DelayOdds(
        recorded_m=recorded_m,
        is_recorded=is_recorded,
        other_m=recorded_m + 2.0 * OFFSET_STEP_M * float(shifts[other]),
        odds=NATS * float(free[other] - free[near].max()),
        best_m=recorded_m + 2.0 * OFFSET_STEP_M * float(shifts[best]),
        lead=NATS * float(total[best] - rest),
        box_odds=NATS * float(given.max() - total[near].max()),
    )


def _delay_scores(
    search: BoxSearch, yaw_rad: float, penalties: Mapping[int, float], box: LosPrior | None
) -> Floats:
    """Best scores of each error of the delay at a yaw, of any box and of a given one, (2, n)."""
    sides, around = search.sides(yaw_rad), _given_offsets(search.axes(yaw_rad), box)
    found = np.zeros((2, len(penalties)))
    for pair in search.pairs:
        for row, own in enumerate((None, around)):
            if row == 0 or own is not None:
                score = search.scores(sides, pair, penalties, own).max(axis=1)
                found[row] = np.maximum(found[row], score)
    return found


def _given_offsets(axes: Floats, box: LosPrior | None) -> Floats | None:
    """Offsets of a given cuboid's sides against and along these axes, (6,) [m].

    None where its sides are not along them.
    """
    if box is None or box.cuboid is None:
        return None
    own, size_m, center_m = box.cuboid
    cosine = np.abs(axes @ own.T)
    if (cosine.max(axis=1) < np.cos(_LIKE_RAD)).any():
        return None
    half = 0.5 * size_m[cosine.argmax(axis=1)]
    middle = axes @ center_m
    return np.stack([half - middle, half + middle], axis=1).ravel()
