"""What the planes of a scan can receive before anything is reconstructed: heights, normals, gaps.

A smooth surface sends its echo back along its normal, so that a plane of antennas receives a
surface only where the normal, prolonged, meets its aperture. A vertical face has a horizontal
normal: it is received only at the heights at which antennas stand.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats
from geraf2.freespace.specular import seen_share
from geraf2.scene.aperture import Aperture
from geraf2.scene.checks import Finding, warning
from geraf2.scene.summary import CaptureSummary

_MIN_BLIND_M = 0.01
"""Heights out of sight that matter: less is within the thickness of a floor of board [m]."""
_MAX_GAP_DEG = 60.0
"""Azimuths without antennas that leave a side of the content unseen: one of six [degrees]."""
_MIN_SHARE = 0.05
"""Share of normals below which most of a surface is guessed: three planes around see 0.05."""
_UNKNOWN_M = 0.2
"""Side of the region for the share of normals where none is known [m]."""
_MIN_SPREAD = 0.01
"""Looking directions that differ by less than about 6 degrees do not determine the vertical."""
_FLAT_COSINE = 0.98
"""A plane that looks down within 11 degrees of the vertical receives no vertical face."""
_STEEP_DEG = 60.0
"""A plane raised by more receives surfaces from above and closes no gap between azimuths."""
_BELOW, _ABOVE, _BETWEEN = "below all antennas", "above all antennas", "between the antennas"


@dataclass(frozen=True, kw_only=True)
class Blind:
    """Heights of the region at which no antenna stands."""

    low_m: float
    high_m: float
    where: str
    """"below all antennas", "above all antennas" or "between the antennas"."""
    tilts_deg: tuple[float, float] | None
    """Least and largest elevation of normals that are received from the middle of these heights;
    None between antennas, where both upward and downward ones are [degrees]."""

    @property
    def span_m(self) -> float:
        """How much of the height is out of sight [m]."""
        return self.high_m - self.low_m


@dataclass(frozen=True, kw_only=True)
class ScanCoverage:
    """What the planes of a scan receive of surfaces in a region."""

    center_m: tuple[float, float, float]
    """Middle of the region."""
    size_m: tuple[float, float, float] | None
    """Sides of the region; None where none is known: then `blind` is empty."""
    n_planes: int
    standoff_m: float
    """Median distance of the planes from the middle [m]."""
    heights_m: tuple[tuple[float, float], ...]
    """Intervals of z at which antennas stand, and from which vertical faces are received [m]."""
    blind: tuple[Blind, ...]
    """The rest of the region's height, where it is more than 10 mm; empty where all planes look in
    one direction, which does not determine the vertical."""
    seen_share: float
    """Of all normals, those that some plane receives; mean over the middle of the region."""
    tilts_deg: tuple[float, float]
    """Least and largest elevation of normals that are received from the middle [degrees]."""
    gaps_deg: tuple[tuple[float, float], ...]
    """Azimuths from which no antenna looks at the middle, as (from, to), the widest first."""

    @property
    def largest_gap_deg(self) -> float:
        """Width of the widest range of azimuths without antennas [degrees]."""
        return max((end - start for start, end in self.gaps_deg), default=0.0)

    def findings(self) -> tuple[Finding, ...]:
        """Return what the scan cannot see, each with a number and what to do about it."""
        return tuple(self._find())

    def _find(self) -> Iterator[Finding]:
        for one in self.blind:
            yield self._blind_finding(one)
        if self.n_planes > 1 and self.largest_gap_deg > _MAX_GAP_DEG:
            start, end = self.gaps_deg[0]
            yield warning(
                f"no antenna looks at the content from azimuths of {start:z.0f} to {end:z.0f} "
                f"degrees: surfaces that face there send no echo back",
                "add planes there",
            )
        elif self.seen_share < _MIN_SHARE:
            yield warning(
                f"the {self.n_planes} planes receive {100.0 * self.seen_share:.1f} % of all "
                "normals: most of a surface would be guessed",
                "add planes, or make them wider and higher",
            )

    def _blind_finding(self, one: Blind) -> Finding:
        only, move = "", "scan the heights between with more rows"
        if one.where != _BETWEEN:
            below = one.where == _BELOW
            if one.tilts_deg is not None:
                low, high = sorted(abs(tilt) for tilt in one.tilts_deg)
                only = (
                    f", only those whose normals point {'up' if below else 'down'} by {low:.0f} to "
                    f"{high:.0f} degrees"
                )
            middle = 0.5 * (one.low_m + one.high_m)
            tilt = np.rad2deg(np.arctan2(middle - self.center_m[2], self.standoff_m))
            move = f"{'lower' if below else 'raise'} the radar by {1e3 * one.span_m:.0f} mm"
            if sum(other.where != _BETWEEN for other in self.blind) > 1:  # it cannot do both
                move = f"scan {1e3 * one.span_m:.0f} mm more at the {'foot' if below else 'top'}"
            move += f", or add planes at an elevation of {tilt:z.0f} degrees"
        return warning(
            f"content between z = {1e3 * one.low_m:z.0f} and {1e3 * one.high_m:z.0f} mm lies "
            f"{one.where}: surfaces there that face sideways send no echo back{only}",
            move,
        )

    def numbers(self) -> dict[str, object]:
        """For `--json`."""
        return {
            "region_center_m": self.center_m,
            "region_size_m": self.size_m,
            "n_planes": self.n_planes,
            "heights_of_antennas_m": self.heights_m,
            "heights_out_of_sight_m": [(one.low_m, one.high_m) for one in self.blind],
            "normals_seen_share": round(self.seen_share, 4),
            "tilts_seen_deg": [round(tilt, 1) for tilt in self.tilts_deg],
            "azimuth_gaps_deg": [[round(end, 1) for end in gap] for gap in self.gaps_deg],
        }


def scan_coverage(
    planes: Sequence[Aperture],
    center_m: Sequence[float] | Floats,
    size_m: Sequence[float] | None = None,
) -> ScanCoverage:
    """Find what planes receive of surfaces in a region.

    planes: of the scan, at least one. center_m: middle of the region, (3,) [m].
    size_m: sides of the region in which the content lies, of the inside of the box (3,) [m]; None
        where nothing is known about it.
    """
    center = np.asarray(center_m, dtype=np.float64)
    x, y, z = (float(value) for value in center)
    upright = [plane for plane in planes if abs(plane.axes[0][2]) < _FLAT_COSINE]
    heights = _union((_span(plane.corners_m[:, 2]) for plane in upright), _MIN_BLIND_M)
    looking = np.stack([plane.axes[0] for plane in planes])
    spread = np.linalg.eigvalsh(np.eye(3) - looking.T @ looking / len(planes))[0]
    around, blind = spread > _MIN_SPREAD, []
    if size_m is not None and around and heights:
        reach = 0.5 * size_m[2]
        for low, high in _rest(heights, z - reach, z + reach):
            at = np.array([x, y, 0.5 * (low + high)])
            where = _BELOW if high <= heights[0][0] else _BETWEEN
            where = _ABOVE if low >= heights[-1][1] else where
            tilts = None if where == _BETWEEN else _elevations_deg(planes, at)
            blind.append(Blind(low_m=low, high_m=high, where=where, tilts_deg=tilts))
    known = None if size_m is None else (float(size_m[0]), float(size_m[1]), float(size_m[2]))
    sides = np.full(3, _UNKNOWN_M) if known is None else np.array(known)
    return ScanCoverage(
        center_m=(x, y, z),
        size_m=known,
        n_planes=len(planes),
        standoff_m=float(np.median([np.linalg.norm(p.middle_m - center) for p in planes])),
        heights_m=heights,
        blind=tuple(one for one in blind if one.span_m > _MIN_BLIND_M),
        seen_share=seen_share(planes, center, sides),
        tilts_deg=_elevations_deg(planes, center),
        gaps_deg=_gaps_deg(planes, center) if around else (),
    )


def summary_coverage(summary: CaptureSummary, box_m: Floats | None = None) -> ScanCoverage | None:
    """Find what the planes of a capture receive of content in its box; None of a single plane.

    box_m: vertices of the outside of the box, (n, 3) [m]; the capture's walls when None, and
        without these nothing is known about heights.
    """
    if summary.is_plane or summary.focus is None:
        return None
    if summary.walls:
        outer, inner = summary.walls[0], summary.walls[-1]
        return scan_coverage(summary.planes, outer.center_m, inner.inner_size_m)
    if box_m is not None and len(box_m):
        low, high = box_m.min(axis=0), box_m.max(axis=0)
        return scan_coverage(summary.planes, 0.5 * (low + high), high - low)
    return scan_coverage(summary.planes, summary.focus)


def _span(values: Floats) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _union(
    spans: Iterable[tuple[float, float]], bridge: float = 0.0
) -> tuple[tuple[float, float], ...]:
    """Union of intervals in rising order; those nearer than `bridge` become one."""
    merged: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if merged and low <= merged[-1][1] + bridge:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return tuple(merged)


def _rest(
    covered: Iterable[tuple[float, float]], start: float, end: float
) -> Iterator[tuple[float, float]]:
    """Yield the parts from start to end that no interval of a union covers."""
    for low, high in covered:
        if start < min(low, end):
            yield start, min(low, end)
        start = max(start, high)
    if start < end:
        yield start, end


def _elevations_deg(planes: Sequence[Aperture], point: Floats) -> tuple[float, float]:
    """Least and largest elevation at which a point sees the middle lines of planes [degrees]."""
    ends = np.concatenate([plane.points_at(_UP_DOWN) for plane in planes]) - point
    return _span(np.rad2deg(np.arctan2(ends[:, 2], np.hypot(ends[:, 0], ends[:, 1]))))


_UP_DOWN = np.array([(0.0, -1.0), (0.0, 1.0)])
_LEFT_RIGHT = np.array([(-1.0, 0.0), (1.0, 0.0)])


def _gaps_deg(planes: Sequence[Aperture], point: Floats) -> tuple[tuple[float, float], ...]:
    """Azimuths from which no plane looks at a point, as (from, to) [degrees], the widest first."""
    spans = []
    for plane in planes:
        x, y, z = plane.middle_m - point
        if np.hypot(x, y) <= abs(z) / np.tan(np.deg2rad(_STEEP_DEG)):
            continue
        middle = float(np.rad2deg(np.arctan2(y, x)))
        ends = plane.points_at(_LEFT_RIGHT) - point
        off = np.rad2deg(np.arctan2(ends[:, 1], ends[:, 0])) - middle
        half = float(np.abs((off + 180.0) % 360.0 - 180.0).max())
        spans.append((middle - half, middle + half))
    if not spans:
        return ((0.0, 360.0),)
    turned = [(low + turn, high + turn) for low, high in spans for turn in (-360.0, 0.0, 360.0)]
    first = min(low for low, _ in spans)
    gaps = list(_rest(_union(turned), first, first + 360.0))
    return tuple(sorted(gaps, key=lambda gap: gap[0] - gap[1]))
