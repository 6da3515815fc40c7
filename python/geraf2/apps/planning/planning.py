"""Plan of a scan: suggests settings that were not given and refuses impossible ones."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, MinLen

from geraf2._bounds import Arg, Bounded, Few, Seconds
from geraf2._types import Floats
from geraf2.apps.planning.expected import ExpectedAccuracy, expect_accuracy
from geraf2.apps.planning.scan_time import (
    COARSEST,
    Order,
    Scanner,
    TimedPlan,
    find_best_plan,
    swept_planes,
)
from geraf2.errors import UserError
from geraf2.freespace.specular import seen_share
from geraf2.io.manifest import AntennaManifest, RadarManifest
from geraf2.io.scan_file import ScanFile, SweptArray
from geraf2.io.toml import read_toml
from geraf2.scene import Waveform
from geraf2.scene.aperture import Aperture
from geraf2.scene.arrays import ARRAYS, find_array
from geraf2.scene.plan import (
    PlanePlan,
    ScanPlan,
    nyquist_spacing_m,
    suggested_aperture_m,
    suggested_planes,
    suggested_standoff_m,
)
from geraf2.scene.store import open_capture

Preset = Literal["awr1843", "iwr6843"]

# Typical chirps of 3.6 GHz, decimated to 32 samples.
_PRESETS: dict[str, Waveform] = {
    name: Waveform(
        start_frequency_hz=start_hz,
        chirp_slope_hz_per_s=70.15e12,
        sample_rate_hz=625e3,
        n_samples=32,
        path_bias_m=0.15,
    )
    for name, start_hz in (("awr1843", 77.3704e9), ("iwr6843", 60.25e9))
}
_MIN_WAVELENGTHS = 4.0
"""Shortest side of a box for a radar without ranges."""
_MAX_RINGS = 12
_MAX_PLANES = 1000
PlanM = Annotated[float, Interval(ge=1e-3, le=10.0)]
PlanSides = tuple[PlanM, PlanM, PlanM]
_StepM = Annotated[float, Interval(ge=1e-4, le=10.0)]
_HeightM = Annotated[float, Interval(ge=0.0, le=10.0)]
_Elevation = Annotated[float, Interval(gt=-90.0, lt=90.0)]


@dataclass(frozen=True, kw_only=True)
class PlanOptions(Bounded):
    """What is known of the scan to be planned: either `box` or `depth`, the rest is suggested.

    Raises
    ------
    ValueError
        For a value out of its bounds.
    UserError
        For elevations that repeat, or too many planes.

    Examples
    --------
    >>> geraf2.PlanOptions(box=(0.22, 0.22, 0.22), minutes=5.0).speed_m_per_s  # lengths in metres
    0.2
    """

    box: Annotated[PlanSides | None, Arg(metavar="X Y Z")] = None
    """Outer side lengths of the box, Z along the turntable's axis [m]."""
    depth: PlanM | None = None
    """Distance from a single plane to the object [m]."""
    radar: Path | None = None
    """TOML file with the chirp, as for `geraf2 import`; the positions of its antennas, where it
    gives them, are the array that is swept."""
    preset: Preset | None = None
    """Or the chirp of a known radar; awr1843 when neither is given. With --minutes its board
    is swept, too, where its antennas are known."""
    standoff: PlanM | None = None
    """Planes to the turntable's axis [m]."""
    aperture: Annotated[tuple[PlanM, PlanM] | None, Arg(metavar="W H")] = None
    """Width and height of a plane [m]."""
    spacing: _StepM | None = None
    """Distance of neighbouring antennas [m]."""
    planes: Few | None = None
    """Planes around the box, for each elevation; the planes that see most are chosen when neither
    these nor elevations are given."""
    elevations_deg: Annotated[tuple[_Elevation, ...], MinLen(1)] | None = None
    """Elevations of the planes' middles; 0 when only --planes is given [degrees]."""
    content: Annotated[tuple[_HeightM, PlanM] | None, Arg(metavar="LOW HIGH")] = None
    """Heights above the floor of the box between which the content lies, where they are known:
    planes look at its middle instead of that of the box [m]."""
    frame_period_s: Seconds = 3e-3
    """From one recording to the next [s]."""
    speed_m_per_s: PlanM = 0.2
    """Of the radar along a row [m/s]."""
    minutes: Annotated[float, Interval(gt=0.0, le=1e5)] | None = None
    """What the scan may take; as long as one ring around the box when not given [minutes]."""
    channels: Annotated[int, Interval(ge=1, le=64)] | None = None
    """Receivers at once, one above the other, as far apart as rows; 1 when no array is given."""
    array: str | None = None
    """Or a board: iwr1443, iwr1843, awr1443, awr1843, awr2243-cascade."""
    order: Order = "tdm"
    """Of a board's transmitters: in turns, or at once, separated by Doppler."""
    chirps_per_s: Annotated[float, Interval(gt=0.0, le=1e7)] | None = None
    """Of all transmitters; those of a position fill the frame period when not given [1/s]."""
    chirps_per_position: Annotated[int, Interval(ge=1, le=100_000)] = 1
    """Of each transmitter, added at a position."""
    settle_s: Annotated[float, Interval(ge=0.0, le=1e3)] | None = None
    """Stop at each position, for this time until the radar stands still and for its chirps [s]; the
    radar records while it moves when not given."""
    turn_s: Seconds = 3.0
    """From one plane to the next: turning the table, or moving the arm [s]."""
    max_elevation_deg: Annotated[float, Interval(ge=0.0, le=90.0)] = 90.0
    """What the arm reaches: below 90 no plane lies above the box [degrees]."""
    out: Path | None = None
    """Scan file to write: .json for `geraf2 simulate` and `import`, .csv for a robot."""

    def __post_init__(self) -> None:
        super().__post_init__()
        elevations = self.elevations_deg or ()
        n_rings = max(1, len(elevations))
        if len(set(elevations)) < len(elevations):
            raise UserError(what="--elevations-deg names an elevation twice")
        if n_rings * (self.planes or 1) > _MAX_PLANES or n_rings > _MAX_RINGS:
            expected = f"at most {_MAX_RINGS} elevations and {_MAX_PLANES} planes in all"
            got = f"{n_rings} elevations"
            raise UserError(what="too many planes", where="--planes", expected=expected, got=got)
        if self.content is not None:
            low, high = self.content
            top = np.inf if self.box is None else self.box[2]
            if not low < high <= top:
                raise UserError(
                    what="the content does not lie in the box",
                    where="--content",
                    expected=f"0 <= LOW < HIGH <= {top:g} m above the floor",
                    got=f"{low:g} {high:g}",
                )

    @property
    def has_rings(self) -> bool:
        """Whether planes or elevations are given, rather than chosen."""
        return self.planes is not None or self.elevations_deg is not None

    @property
    def height_m(self) -> float:
        """Middle of the content above that of the box [m]."""
        if self.content is None or self.box is None:
            return 0.0
        return 0.5 * (sum(self.content) - self.box[2])

    @property
    def scanner(self) -> Scanner:
        """Radar, and what moves it."""
        if self.channels is not None and self.array is not None:
            raise UserError(what="give either --channels or --array", got="both")
        own, n_tx, array = None, 1, self.array
        if array is None and self.channels is None and self.preset in ARRAYS:
            array = self.preset
        if array is not None:
            n_tx = len(find_array(array).tx)
        elif self.channels is None and self.radar is not None:
            own = _own_array(read_toml(self.radar, RadarManifest).antennas, self.order)
            n_tx = 1 if own is None else len(own.tx_offsets_m)
        return Scanner(
            channels=self.channels,
            array=array,
            own=own,
            order=self.order,
            chirps_per_s=self.chirps_per_s or n_tx * self.chirps_per_position / self.frame_period_s,
            chirps_per_position=self.chirps_per_position,
            speed_m_per_s=self.speed_m_per_s,
            settle_s=self.settle_s,
            turn_s=self.turn_s,
        )


def _own_array(antennas: AntennaManifest, order: Order) -> SweptArray | None:
    """Array at the antenna positions of a radar's file, None where it gives none."""
    if antennas.rx_offsets_m is None:
        return None
    axes = np.eye(3) if antennas.axes is None else np.asarray(antennas.axes)
    tx, rx = (
        tuple((float(a), float(b), float(c)) for a, b, c in np.asarray(offsets) @ axes.T)
        for offsets in (antennas.tx_offsets_m or [[0.0, 0.0, 0.0]], antennas.rx_offsets_m)
    )
    return SweptArray(tx_offsets_m=tx, rx_offsets_m=rx, order=order)


def plan(options: PlanOptions) -> ScanPlan | PlanePlan | TimedPlan:
    """Plan a scan; what is not given is suggested.

    Parameters
    ----------
    options
        Sides of the box, or depth of a single plane [m], and what is known of radar and scanner.

    Returns
    -------
    ScanPlan | PlanePlan | TimedPlan
        The planes that see most in the time, with the lines of the arm; rings of planes if
        `options.planes` or `options.elevations_deg` is given; a single plane if `options.depth` is.

    Raises
    ------
    UserError
        For settings that contradict each other, a box that the radar cannot resolve, or a plan
        that does not fit into the time.

    Examples
    --------
    >>> best = geraf2.plan(geraf2.PlanOptions(box=(0.22, 0.22, 0.22), minutes=20.0))
    >>> best.seen_share > best.ring_share
    True
    >>> rings = geraf2.plan(geraf2.PlanOptions(box=(0.22, 0.22, 0.22), elevations_deg=(0.0,)))
    >>> rings.n_planes, rings.spacing_m  # [m]
    (36, 0.0033)
    """
    if options.depth is not None and options.minutes is None:
        return make_plane(options)
    if options.has_rings and options.minutes is None:
        return make_plan(options)
    return make_timed_plan(options)


def make_timed_plan(options: PlanOptions) -> TimedPlan:
    """Find the plan that sees most in the time; UserError where none fits.

    The time is `options.minutes`, or what the scanner takes for one ring around the box.
    """
    if options.has_rings:
        raise UserError(
            what="a plan by minutes chooses planes and elevations itself",
            hint="leave --planes and --elevations-deg out, or --minutes",
        )
    plan, scanner = make_plan(options), options.scanner
    if options.minutes is None:
        _, seconds = swept_planes(plan.apertures, plan.spacing_m, scanner)
    else:
        seconds = 60.0 * options.minutes
    return find_best_plan(
        plan,
        scanner,
        seconds,
        max_elevation_deg=options.max_elevation_deg,
        spacing_m=options.spacing,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplainedScan:
    """An existing scan as a plan."""

    box_m: PlanSides
    """Sides of the box; 0.2 m where none is recorded [m]."""
    center_m: Floats
    """Its middle, (3,) [m]."""
    planes: list[Aperture]
    elevations_deg: tuple[float, ...]
    """Of the planes' middles, seen from the middle of the box [degrees]."""
    spacing_m: float
    scan: ScanFile
    seconds: float
    """That the scanner would take [s]."""
    seen_share: float
    """Of all normals, in which a surface is seen."""
    expected: ExpectedAccuracy | None
    """None where the spacing is too coarse."""


def explain_scan(scene: Path, scanner: Scanner) -> ExplainedScan:
    """Explain a scan that exists: its planes, what they see, and the time of it by a scanner."""
    capture = open_capture(scene)
    if not capture.poses:
        raise UserError(what="has no planes", where=scene)
    center, half = np.zeros(3), np.full(3, 0.1)
    if capture.walls:
        center = np.asarray(capture.walls[0].center_m)
        half = 0.5 * np.asarray(capture.walls[0].size_m)
    apertures, n_positions = [], []
    for pose in capture.poses:  # which are read one at a time
        apertures.append(Aperture.from_pose(pose).turn_right_handed())
        n_positions.append(len(np.unique(np.round(pose.phase_centers, 5), axis=0)))
    areas = [4.0 * float(plane.half_m.prod()) for plane in apertures]
    spacing = float(np.median(np.sqrt(np.divide(areas, n_positions))))
    spacing = max(round(spacing, 4), 1e-4)
    scan, seconds = swept_planes(apertures, spacing, scanner)
    share = seen_share(apertures, center, 2.0 * half)
    outward = [plane.middle_m - center for plane in apertures]
    far = float(np.median([np.linalg.norm(w) for w in outward]))
    sides = (2.0 * half[0], 2.0 * half[1], 2.0 * half[2])
    coarsest = COARSEST * nyquist_spacing_m(sides, far, capture.waveform.center_wavelength_m)
    return ExplainedScan(
        box_m=sides,
        center_m=center,
        planes=apertures,
        elevations_deg=tuple(np.rad2deg([np.arcsin(w[2] / np.linalg.norm(w)) for w in outward])),
        spacing_m=spacing,
        scan=scan,
        seconds=seconds - scanner.turn_s,
        seen_share=share,
        expected=expect_accuracy(apertures, center, share) if spacing <= coarsest else None,
    )


def make_plan(options: PlanOptions) -> ScanPlan:
    """Plan with everything that was left open filled in."""
    if options.box is None:
        raise UserError(what="give --box, or --depth of a single plane")
    waveform = _choose_waveform(options)
    _require_size(options.box, waveform)
    standoff = options.standoff or suggested_standoff_m(options.box)
    radius = 0.5 * float(np.hypot(options.box[0], options.box[1]))
    if standoff <= radius:
        raise UserError(
            what="the box would turn into the radar",
            where="--standoff",
            expected=f"more than {radius:.3f} m, half the diagonal of the box",
            got=f"{standoff:g} m",
        )
    aperture = options.aperture or suggested_aperture_m(options.box)
    limit = nyquist_spacing_m(options.box, standoff, waveform.center_wavelength_m)
    spacing = options.spacing or np.floor(1e4 * limit) / 1e4
    return ScanPlan(
        box_m=options.box,
        waveform=waveform,
        standoff_m=standoff,
        aperture_m=aperture,
        spacing_m=float(spacing),
        n_planes=options.planes or suggested_planes(aperture, standoff),
        elevations_deg=options.elevations_deg or (0.0,),
        frame_period_s=options.frame_period_s,
        speed_m_per_s=options.speed_m_per_s,
        turn_s=options.turn_s,
        height_m=options.height_m,
    )


def _require_size(box_m: PlanSides, waveform: Waveform) -> None:
    """Refuse a box whose near and far walls, and all between, echo in one range cell."""
    min_m = _MIN_WAVELENGTHS * waveform.center_wavelength_m
    if waveform.n_samples > 1:
        min_m = max(min_m, waveform.range_cell_m)
    if min(box_m) < min_m:
        raise UserError(
            what="the box is too small for the radar to separate its walls from the content",
            where="--box",
            expected=f"sides of at least {min_m:.3f} m, a range cell or 4 wavelengths",
            got=f"{min(box_m):g} m",
            hint="is it in metres?",
        )


def make_plane(options: PlanOptions) -> PlanePlan:
    """Single plane with everything that was left open filled in; as wide as it is far."""
    for name in ("box", "standoff", "planes", "content"):
        if getattr(options, name) is not None:
            raise UserError(what=f"--depth plans a single plane, without --{name}")
    depth = options.depth or 0.0
    plan = PlanePlan(
        waveform=_choose_waveform(options),
        depth_m=depth,
        aperture_m=options.aperture or (depth, depth),
        spacing_m=options.spacing or depth,
        frame_period_s=options.frame_period_s,
        speed_m_per_s=options.speed_m_per_s,
    )
    if options.spacing is not None:
        return plan
    return replace(plan, spacing_m=float(np.floor(1e4 * plan.nyquist_spacing_m) / 1e4))


def _choose_waveform(options: PlanOptions) -> Waveform:
    if options.radar is not None and options.preset is not None:
        raise UserError(what="give either --radar or --preset", got="both")
    if options.radar is None:
        return _PRESETS[options.preset or "awr1843"]
    radar = read_toml(options.radar, RadarManifest)
    start = radar.first_sample_hz()
    slope, rate, n_samples = radar.chirp_slope_hz_per_s, radar.sample_rate_hz, radar.n_samples
    if start is None or slope is None or rate is None or n_samples is None:
        raise UserError(
            what="does not describe the chirp",
            where=options.radar,
            expected="start_frequency_hz, chirp_slope_hz_per_s, sample_rate_hz and n_samples",
        )
    return Waveform(
        start_frequency_hz=start,
        chirp_slope_hz_per_s=slope,
        sample_rate_hz=rate,
        n_samples=n_samples,
        path_bias_m=radar.path_bias_m or 0.0,
    )
