"""What to scan in so many minutes: planes, lines, spacings, and what may be expected of them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from geraf2._bounds import Bounded, Seconds
from geraf2._types import Bools, Floats
from geraf2.apps.planning.expected import ExpectedAccuracy, expect_accuracy
from geraf2.errors import UserError
from geraf2.freespace.specular import inner_points, received_normals, seen_share, sphere_points
from geraf2.io.scan_file import ScanFile, ScanLine, SweptArray, SweptPlane
from geraf2.scene.aperture import Aperture
from geraf2.scene.arrays import column, find_array
from geraf2.scene.plan import ScanPlan, nyquist_spacing_m, plane_at

Order = Literal["tdm", "ddm"]

BLUR_WAVELENGTHS = 0.25
"""Largest motion of the radar while samples of one position are added, over the wavelength. At
30 degrees off the looking direction, where a box's edge is seen, the phase then turns by 90 degrees
and the sum loses 1 dB."""
COARSEST = 1.2
"""Largest spacing over Nyquist's (docs/conventions.md) for which an accuracy is predicted: 4 mm for
the benchmark's box. At 8 mm grating lobes fill it (F1 at 5 mm 0.35 to 0.63 from 21 planes)."""
_SPACINGS_M = (0.001, 0.002, 0.0025, 0.003, 0.0035, 0.004, 0.005, 0.006, 0.008)
_RINGS = (3, 4, 5, 6, 8, 9, 10, 12, 14, 16, 18, 20, 24, 30, 36)
_ALONE = (7, 11, 13, 15, 17)  # without raised planes
_RAISED = (0, 3, 4, 5, 6, 8, 10, 12)
_RAISED_DEG = (30.0, 35.0, 40.0, 45.0, 50.0)
_LOWEST, _GAIN = 0.85, 1.1
"""A plane may be a line lower, down to this share of its height, where that sees a tenth more: four
planes of 7 lines in the minute that three of 8 take (docs/how-to/scan-in-five-minutes.md). And
planes are raised where they see a tenth more than one ring of as many: where they see no more, they
lost .012 of F1 at 5 mm in the mean of five objects that estimate, and .008 of six that decide
(`bench/python/plan_gain.py OUT --minutes 2`)."""
_N_NORMALS = 1000


@dataclass(frozen=True, kw_only=True)
class Scanner(Bounded):
    """A radar, and what moves it."""

    channels: Annotated[int, Interval(ge=1, le=64)] | None = None
    """Receivers at once, one above the other, as far apart as rows are."""
    array: str | None = None
    """Or a board: iwr1443, iwr1843, awr2243-cascade; its long side stands upright."""
    own: SweptArray | None = None
    """Or antennas of one's own."""
    order: Order = "tdm"
    """Of the board's transmitters: in turns chirp by chirp, or at once, separated by Doppler."""
    chirps_per_s: Annotated[float, Interval(gt=0.0, le=1e7)] = 1000.0
    """Chirps of a transmitter and those of the others together [1/s]."""
    chirps_per_position: Annotated[int, Interval(ge=1, le=100_000)] = 1
    """Of each transmitter, added at one position."""
    speed_m_per_s: Annotated[float, Interval(gt=0.0, le=10.0)] = 0.1
    """Along a line and to the next [m/s]."""
    settle_s: Annotated[float, Interval(ge=0.0, le=1e3)] | None = None
    """Stop at each position, for this time until it stands still [s]; None: it moves on."""
    turn_s: Seconds = 3.0
    """From one plane to the next [s]."""

    def swept_array(self, pitch_m: float) -> SweptArray:
        """Array of the scanner; receivers of `channels` as far apart as the rows [m]."""
        if self.array is not None:
            return find_array(self.array).sweep(order=self.order, chirp_s=1.0 / self.chirps_per_s)
        array = self.own or column(self.channels or 1, pitch_m)
        return replace(array, chirp_s=1.0 / self.chirps_per_s)

    def set_s(self, array: SweptArray) -> float:
        """Time of all chirps of one position [s]."""
        return self.chirps_per_position * len(array.tx_offsets_m) / self.chirps_per_s


def require_speed(scanner: Scanner, spacing_m: float, wavelength_m: float) -> None:
    """Raise UserError where the radar moves too far while it records one position.

    Transmitters that take turns have positions of their own; chirps that are added share one.
    """
    if scanner.settle_s is not None:
        return
    array = scanner.swept_array(spacing_m)
    set_s = scanner.set_s(array)
    added_s = set_s
    if scanner.chirps_per_position == 1 and array.order == "tdm":
        added_s = 1.0 / scanner.chirps_per_s
    for seconds, limit_m, name in (
        (added_s, BLUR_WAVELENGTHS * wavelength_m, f"{BLUR_WAVELENGTHS:g} wavelengths of blur"),
        (set_s, spacing_m, f"the spacing of {1e3 * spacing_m:g} mm"),
    ):
        if scanner.speed_m_per_s * seconds > limit_m * (1.0 + 1e-9):
            raise UserError(
                what=f"the arm moves {1e3 * scanner.speed_m_per_s * seconds:.2g} mm while the "
                f"chirps of one position are recorded, more than {name}",
                where="--speed-m-per-s",
                expected=f"at most {limit_m / seconds:.3g} m/s",
                got=f"{scanner.speed_m_per_s:g} m/s",
                hint="more --chirps-per-s, fewer --chirps-per-position, or stop with --settle-s",
            )


@dataclass(frozen=True, kw_only=True)
class Design:
    """Rings of planes: around the box, raised, and one above."""

    n_around: int
    n_raised: int
    raised_deg: float
    """Elevation of the raised planes [degrees]."""
    above: bool
    spacing_m: float
    aperture_m: tuple[float, float]
    """Width and height of each [m]."""

    @property
    def n_planes(self) -> int:
        """Of all kinds."""
        return self.n_around + self.n_raised + self.above

    def ring(self) -> "Design":
        """One ring of as many planes."""
        return replace(self, n_around=self.n_planes, n_raised=0, raised_deg=0.0, above=False)

    def __str__(self) -> str:
        parts = [f"{self.n_around} around the box"] if self.n_around else []
        if self.n_raised:
            parts.append(f"{self.n_raised} at {self.raised_deg:g} degrees of elevation")
        if self.above:
            parts.append("1 above")
        return ", ".join(parts)

    def planes(self, standoff_m: float, height_m: float = 0.0) -> list[Aperture]:
        """Rectangles of the antennas, which look at this height on the frame's z axis."""
        half, kinds = 0.5 * np.asarray(self.aperture_m), (0.0, self.raised_deg, 90.0)
        counts = (self.n_around, self.n_raised, int(self.above))
        return [
            plane
            for elevation_deg, n in zip(kinds, counts, strict=True)
            for plane in ring_planes(elevation_deg, n, standoff_m, half, height_m)
        ]


@dataclass(frozen=True, kw_only=True)
class TimedPlan:
    """A scan, how long it takes, and what may be expected of it."""

    design: Design
    scan: ScanFile
    seconds: float
    """With the motion to the first position of each plane [s]."""
    planes: list[Aperture]
    """Rectangles that are swept."""
    seen_share: float
    """Of all normals, in which a surface is seen."""
    expected: ExpectedAccuracy | None
    """None where the spacing is too coarse."""
    ring_share: float
    """Of all normals, what one ring of as many planes around the box sees."""


def swept_planes(
    planes: list[Aperture], spacing_m: float, scanner: Scanner
) -> tuple[ScanFile, float]:
    """Lines over planes, one after the other, back and forth; and the time that they take [s].

    A line lies along the horizontal of its plane; with one above the other the array covers the
    height, each line as much above the one before as the array is high, and a row.
    """
    array = scanner.swept_array(spacing_m)
    extent_m = _height_m(array)
    stop_s = 0.0 if scanner.settle_s is None else scanner.settle_s + scanner.set_s(array)
    clock_s, swept = 0.0, []
    for number, plane in enumerate(planes):
        width, height = 2.0 * plane.half_m
        n_positions = int(width / spacing_m + 1e-9) + 1
        length_m, step_m = (n_positions - 1) * spacing_m, extent_m + spacing_m
        n_lines = max(0, int((height - extent_m) / step_m + 0.5 - 1e-9)) + 1
        line_s = length_m / scanner.speed_m_per_s + n_positions * stop_s
        lines = []
        for k in range(n_lines):
            left, right = (
                plane.middle_m
                + side * 0.5 * length_m * plane.axes[1]
                + (k - 0.5 * (n_lines - 1)) * step_m * plane.axes[2]
                for side in (-1.0, 1.0)
            )
            start, end = (left, right) if k % 2 == 0 else (right, left)
            lines.append(
                ScanLine(
                    start_m=_triple(start),
                    end_m=_triple(end),
                    n_positions=n_positions,
                    start_s=clock_s,
                    speed_m_per_s=length_m / line_s if length_m > 0 else scanner.speed_m_per_s,
                )
            )
            clock_s = lines[-1].end_s + step_m / scanner.speed_m_per_s
        clock_s += scanner.turn_s
        angle = float(np.rad2deg(np.arctan2(plane.axes[1][0], -plane.axes[1][1])))
        swept.append(
            SweptPlane(
                name=f"{number}_{angle:z.0f}",
                axes=(_triple(plane.axes[0]), _triple(plane.axes[1]), _triple(plane.axes[2])),
                lines=tuple(lines),
                angle_deg=angle,
            )
        )
    scan = ScanFile(
        planes=tuple(swept),
        array=array,
        motion="continuous" if scanner.settle_s is None else "stop-and-go",
        spacing_m=spacing_m,
    )
    return scan, clock_s


def _height_m(array: SweptArray) -> float:
    """Height that the phase centres of an array span [m]."""
    up = [0.5 * (t[2] + r[2]) for t in array.tx_offsets_m for r in array.rx_offsets_m]
    return max(up) - min(up)


def _triple(vector: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 9) + 0.0 for value in vector)
    return x, y, z


def find_best_plan(
    base: ScanPlan,
    scanner: Scanner,
    seconds: float,
    *,
    max_elevation_deg: float = 90.0,
    spacing_m: float | None = None,
) -> TimedPlan:
    """Plan that sees the largest share of normals in the time; UserError where none fits into it.

    Of plans alike the quicker one counts, and one ring where raised planes see hardly more.

    base: box, standoff, height, and the sides of a plane.
    seconds: what the scan may take. max_elevation_deg: what the arm reaches.
    spacing_m: tried alone, instead of 2 to 8 mm.
    """
    box_m, standoff_m, height_m = base.box_m, base.standoff_m, base.height_m
    wavelength_m = base.waveform.center_wavelength_m
    fastest, best = np.inf, None
    coarsest_m = COARSEST * nyquist_spacing_m(box_m, standoff_m, wavelength_m)
    spacings = tuple(s for s in _SPACINGS_M if s <= coarsest_m) or _SPACINGS_M[:1]
    if spacing_m is not None:
        spacings = (spacing_m,)
    for spacing in spacings:
        try:
            require_speed(scanner, spacing, wavelength_m)
        except UserError:
            if spacing == spacings[-1]:
                raise
            continue
        for sides, weight in _heights(base.aperture_m, spacing, scanner):
            sight = _sight(box_m, standoff_m, sides)
            first = plane_at(0.0, 0.0, standoff_m, 0.5 * np.asarray(sides))
            _, plane_s = swept_planes([first], spacing, scanner)
            for design in _designs(spacing, sides, max_elevation_deg):
                total_s = plane_s * design.n_planes - scanner.turn_s
                fastest = min(fastest, total_s)
                if total_s > seconds:
                    continue
                share = sight.share(design)
                if best is not None and (weight * share, -total_s) <= (best[0], -best[1]):
                    continue
                alone = design.ring()
                if design == alone or share >= _GAIN * sight.share(alone):
                    best = (weight * share, total_s, design, share)
    if best is None:
        raise UserError(
            what="no plan can be reached in the time",
            where="--minutes",
            expected=f"at least {np.ceil(fastest / 0.6) / 100.0:g} minutes for {_RINGS[0]} planes",
            got=f"{seconds / 60.0:g}",
            hint="more channels, a faster arm or a smaller --aperture",
        )
    _, total_s, design, share = best
    planes = design.planes(standoff_m, height_m)
    scan, _ = swept_planes(planes, design.spacing_m, scanner)
    ring = design.ring().planes(standoff_m)
    return TimedPlan(
        design=design,
        scan=scan,
        seconds=total_s,
        planes=planes,
        seen_share=share,
        expected=expect_accuracy(planes, np.array([0.0, 0.0, height_m]), share)
        if design.spacing_m <= coarsest_m
        else None,
        ring_share=seen_share(ring, np.zeros(3), np.asarray(box_m)),
    )


def _heights(
    aperture_m: tuple[float, float], spacing_m: float, scanner: Scanner
) -> Iterator[tuple[tuple[float, float], float]]:
    """Width and height of planes to try, and what their share counts: as asked, and a line less."""
    yield aperture_m, 1.0
    width, height = aperture_m
    lower = height - (_height_m(scanner.swept_array(spacing_m)) + spacing_m)
    if lower >= _LOWEST * height:
        yield (width, lower), 1.0 / _GAIN


def _designs(
    spacing_m: float, aperture_m: tuple[float, float], max_elevation_deg: float
) -> Iterator[Design]:
    raised_deg = [deg for deg in _RAISED_DEG if deg <= max_elevation_deg]
    rings = [*product(_RINGS, _RAISED, (False, True)), *product(_ALONE, (0,), (False,))]
    for n_around, n_raised, above in rings:
        if n_around < n_raised or (n_raised and not raised_deg):  # only such were measured
            continue
        if above and max_elevation_deg < 90.0:
            continue
        for deg in raised_deg if n_raised else (0.0,):
            yield Design(
                n_around=n_around,
                n_raised=n_raised,
                raised_deg=deg,
                above=above,
                spacing_m=spacing_m,
                aperture_m=aperture_m,
            )


class _Sight:
    """What designs see, from what each of their rings sees."""

    def __init__(
        self,
        box_m: tuple[float, float, float],
        standoff_m: float,
        aperture_m: tuple[float, float],
    ) -> None:
        self._standoff_m, self._half = standoff_m, 0.5 * np.asarray(aperture_m)
        self._points = inner_points(np.zeros(3), np.asarray(box_m))
        self._normals = sphere_points(_N_NORMALS)
        self._seen: dict[tuple[float, int], Bools] = {}

    def share(self, design: Design) -> float:
        """Share of all normals in which a surface is seen."""
        seen = (
            self._ring(0.0, design.n_around)
            | self._ring(design.raised_deg, design.n_raised)
            | self._ring(90.0, int(design.above))
        )
        return float(seen.mean())

    def _ring(self, elevation_deg: float, n: int) -> Bools:
        key = (elevation_deg, n)
        if key not in self._seen:
            planes = ring_planes(elevation_deg, n, self._standoff_m, self._half)
            self._seen[key] = np.array(
                [received_normals(planes, self._normals, p).any(axis=1) for p in self._points]
            )
        return self._seen[key]


_sight = lru_cache(maxsize=128)(_Sight)
"""One for all spacings, times and channels with planes of the same sides."""


def ring_planes(
    elevation_deg: float, n: int, standoff_m: float, half_m: Floats, height_m: float = 0.0
) -> list[Aperture]:
    """Planes at one elevation [degrees]; raised ones stand between those around the box."""
    first = 0.5 * (0.0 < elevation_deg < 90.0)
    azimuths = 2.0 * np.pi * (np.arange(n) + first) / max(1, n)
    elevation = np.deg2rad(elevation_deg)
    return [plane_at(azimuth, elevation, standoff_m, half_m, height_m) for azimuth in azimuths]
