"""Cut a stream of parcels apart by their own echoes.

In the frame of the belt a parcel rests, and an array lies in front of it when its x is
the parcel's. There the walls reflect squarely: the power of all arrays together rises by some 10 dB
between the parcel's front and its back. Frames count by their recorded travel, so a belt that stops
repeats frames, which are dropped.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from geraf2._types import Bools, Floats
from geraf2.errors import UserError
from geraf2.io.belt_file import BeltRecord, BeltStation
from geraf2.records import Pose

_STEP_M = 0.004
# Power above that of an empty belt, and below the parcel's largest, at its edges [dB].
_ABOVE_EMPTY_DB, _BELOW_TOP_DB = 6.0, 9.0
# Width of the running median [m]: a flash of content is narrower.
_MEDIAN_M = 0.05
# Gaps that are closed, and shortest parcel [m].
_GAP_M, _SHORTEST_M = 0.03, 0.04
# Largest deviation of a channel from its position in the record [m].
_SAME_POSITION_M = 1e-3
# Smallest step that counts as motion, share of the nominal one; largest gap, steps; largest step
# back, steps: an encoder's error is far smaller.
_MIN_STEP, _MAX_GAP, _MAX_BACK = 0.25, 8.0, 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """Frames of one plane."""

    array: str
    plane: int
    """Index of the plane in the stream."""
    x_m: Floats
    """Position of the array in the frame of the belt, (n_frames,) [m]."""
    kept: Bools
    """Whether the belt moved since the frame before, (n_frames,)."""
    power: Floats
    """Mean power, (n_frames,)."""


def frame_travel(
    pose: Pose, array: BeltStation, record: BeltRecord, last_m: float | None
) -> tuple[Floats, Bools]:
    """`x_m` and `kept` of a plane's frames; UserError where positions contradict the record.

    last_m: of the frame before [m]; None for the first plane of an array.
    """
    n = array.n_channels
    if pose.n_antennas == 0 or pose.n_antennas % n:
        raise UserError(
            what="has parts of frames",
            where=f"plane {pose.name}",
            expected=f"a multiple of the {n} channels of array {array.name}",
            got=pose.n_antennas,
        )
    positions = pose.phase_centers.reshape(-1, n, 3)
    nominal = array.phase_centers_m
    off = np.abs(positions[..., 1:] - nominal[:, 1:]).max()
    x = positions[..., 0].mean(axis=1) - (nominal[:, 0].mean() - array.station_m)
    late = np.array(array.delays_s) * record.speed_m_per_s
    rows = positions[..., 0] - x[:, None] - (nominal[:, 0] - array.station_m) + (late - late.mean())
    off = max(float(off), float(np.abs(rows).max()))
    if off > _SAME_POSITION_M:
        raise UserError(
            what=f"antennas lie elsewhere than those of array {array.name}",
            where=f"plane {pose.name}",
            expected=f"at most {1e3 * _SAME_POSITION_M:g} mm from belt.json",
            got=f"{1e3 * off:.1f} mm",
            hint="correct the positions in belt.json, or record the plane with its array's name",
        )
    step = record.speed_m_per_s * record.frame_s
    before = x[0] + step if last_m is None else last_m
    # The array moves against x in the frame of the belt.
    farthest = np.minimum.accumulate(np.concatenate([[before], x]))
    back = float((x - farthest[:-1]).max())
    if back > _MAX_BACK * step:
        raise UserError(
            what="the recorded travel goes back",
            where=f"plane {pose.name}",
            expected="frames in the order of time",
            got=f"{1e3 * back:.1f} mm back",
        )
    return x, farthest[:-1] - x > _MIN_STEP * step


@dataclass(frozen=True, kw_only=True)
class Span:
    """One parcel of the stream, or why there is none."""

    number: int
    start_m: float
    """Lower end of the parcel in the frame of the belt [m]."""
    end_m: float
    low_m: float
    """Lower end of the frames that belong to it [m]."""
    high_m: float
    planes: tuple[int, ...] = ()
    """Planes that hold these frames."""
    problem: str = ""

    @property
    def middle_m(self) -> float:
        """Middle of the parcel [m]."""
        return 0.5 * (self.start_m + self.end_m)


@dataclass
class Cutter:
    """Finds parcels in frames as they come; the result does not depend on when they came."""

    record: BeltRecord
    longest_m: float
    """Longest parcel; a longer one is several that touch [m]."""
    frames: list[Frames] = field(default_factory=list)
    n_found: int = 0
    _last: dict[str, float] = field(default_factory=dict)
    _done_m: float = np.inf

    def add(self, pose: Pose, plane: int) -> int:
        """Add a plane; returns the number of frames at which the belt stood still."""
        array = self.record.of_plane(pose.name)
        x, kept = frame_travel(pose, array, self.record, self._last.get(array.name))
        if kept.any():
            self._last[array.name] = float(x[kept][-1])
        power = np.square(np.abs(pose.signal)).reshape(len(x), -1).mean(axis=1)
        self.frames.append(Frames(array=array.name, plane=plane, x_m=x, kept=kept, power=power))
        return int((~kept).sum())

    def pop_parcels(self, *, is_last: bool = False) -> Iterator[Span]:
        """Yield parcels, in the order of the belt, whose frames have all come.

        is_last: no more frames will come.
        """
        if (len(self._last) < len(self.record.arrays) and not is_last) or not self._last:
            return
        seen_to = max(self._last.values())
        half = 0.5 * self.record.travel_m
        spans = self._spans()
        for k, (start, end) in enumerate(spans):
            if end > self._done_m:
                continue
            middle = 0.5 * (start + end)
            above = spans[k - 1][0] if k else np.inf
            below = spans[k + 1][1] if k + 1 < len(spans) else -np.inf
            high = min(middle + half, 0.5 * (end + above))
            low = max(middle - half, 0.5 * (start + below))
            # Later frames change nothing once the neighbour behind has come.
            if not is_last and seen_to > start - 3.0 * half - self.longest_m:
                return
            self._done_m = start
            self.n_found += 1
            yield self._span(start, end, low, high)
        self._forget(self._done_m + 2.0 * half + self.longest_m)

    def _span(self, start: float, end: float, low: float, high: float) -> Span:
        own = [f for f in self.frames if ((f.x_m >= low) & (f.x_m <= high) & f.kept).any()]
        return Span(
            number=self.n_found,
            start_m=round(start, 6),
            end_m=round(end, 6),
            low_m=round(low, 6),
            high_m=round(high, 6),
            planes=tuple(sorted(f.plane for f in own)),
            problem=self._problem(own, start, end, low, high),
        )

    def _problem(self, own: list[Frames], start: float, end: float, low: float, high: float) -> str:
        if end - start > self.longest_m:
            return (
                f"{end - start:.2f} m long, expected at most {self.longest_m:g} m: parcels touch, "
                "or the belt stopped without an encoder"
            )
        step = self.record.speed_m_per_s * self.record.frame_s
        for array in self.record.arrays:
            parts = [f.x_m[f.kept] for f in own if f.array == array.name]
            x = np.sort(np.concatenate([np.zeros(0), *parts]))
            x = np.concatenate([[low], x[(x >= low) & (x <= high)], [high]])
            inner = x[(x > start) & (x < end)]
            gap = float(np.diff(x).max())
            if not len(inner) or gap > max(_MAX_GAP * step, 0.25 * (high - low)):
                return f"frames of array {array.name} are missing over {gap:.2f} m of travel"
        return ""

    def _profile(self) -> tuple[Floats, Floats]:
        """Positions and mean level over all arrays [dB]; NaN where an array has no frame."""
        edges = [(f.x_m.min(), f.x_m.max()) for f in self.frames]
        low = _STEP_M * np.floor(min(e[0] for e in edges) / _STEP_M)
        n = int((max(e[1] for e in edges) - low) / _STEP_M) + 1
        levels = []
        for array in self.record.arrays:
            total, count = np.zeros(n), np.zeros(n)
            for f in (f for f in self.frames if f.array == array.name):
                cell = ((f.x_m[f.kept] - low) / _STEP_M).astype(np.int64)
                np.add.at(total, cell, f.power[f.kept])
                np.add.at(count, cell, 1.0)
            known = np.flatnonzero(count)
            if len(known):
                level = 10.0 * np.log10(np.maximum(total[known] / count[known], 1e-300))
                levels.append(np.interp(np.arange(n), known, level))
        return low + _STEP_M * (np.arange(n) + 0.5), np.mean(levels, axis=0)

    def _spans(self) -> list[tuple[float, float]]:
        """Return the ends of all parcels in the frames at hand, the first first."""
        if not self.frames:
            return []
        x, level = self._profile()
        smooth = median_filter(level, max(1, round(_MEDIAN_M / _STEP_M)), mode="nearest")
        wide = max(1, round(self.record.travel_m / _STEP_M))
        top = maximum_filter1d(smooth, wide, mode="nearest")
        empty = minimum_filter1d(smooth, 2 * wide + 1, mode="nearest")
        inside = (smooth > top - _BELOW_TOP_DB) & (smooth > empty + _ABOVE_EMPTY_DB)
        ends = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
        found: list[tuple[float, float]] = []
        for first, last in ends.reshape(-1, 2):
            start, end = x[first] - 0.5 * _STEP_M, x[last - 1] + 0.5 * _STEP_M
            if found and start - found[-1][1] < _GAP_M:
                found[-1] = (found[-1][0], end)
            else:
                found.append((start, end))
        return [pair for pair in found if pair[1] - pair[0] >= _SHORTEST_M][::-1]

    def _forget(self, beyond_m: float) -> None:
        """Drop frames of parcels that are done."""
        self.frames = [f for f in self.frames if f.x_m.min() < beyond_m]
