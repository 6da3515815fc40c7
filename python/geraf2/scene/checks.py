"""Checks of a capture. Every finding is one line that states what to check."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats
from geraf2.constants import MAX_SPACING_WAVELENGTHS
from geraf2.errors import UserError
from geraf2.scene.summary import CaptureSummary, PoseSummary

# Turntable scans face one point within a few degrees.
_MAX_OFF_AXIS_RAD = np.deg2rad(30.0)
# A plane is flat: its depth is jitter, far below its width.
_MAX_DEPTH_FRACTION = 0.3
# Clipped data sit on the largest value in bulk; in float data the maximum is met once or twice.
MAX_SATURATED = 1e-3
# A constant offset in the samples; echoes average out over antennas and samples to below 1e-3.
_MAX_DC = 0.01
# Interference in a thousandth of the recordings does no harm.
_MAX_NOISY = 1e-3
MAX_ANTENNA_M = 1e5
"""Beyond this no antenna is [m]; the kernels take positions up to 1e6 m."""
# Transmitter and receiver of a near-field scan are centimetres apart, rarely metres.
_MAX_APART_M = 5.0
# A pose this many times farther from the middle of all than half of them are, and metres off.
_MAX_STRAY = 20.0
# Axes in float32, typed in with four digits, are orthonormal to about 1e-4.
_MAX_AXES_ERROR = 1e-3
# Poses of one scan differ by a few dB; 20 dB is another gain or a lost channel.
_MAX_LEVEL_DB = 20.0
# Planes of one scan have their echoes at the same ranges to three cells: a cuboid turns edges and
# faces to them. Moved by more, a profile must correlate with the others' so well, and so much
# better than unmoved.
_MAX_SHIFT_CELLS, _MIN_FIT, _MIN_GAIN = 3, 0.7, 0.2
# Echoes of content stand out of the weakest quarter of the ranges.
_MIN_CONTENT_DB = 6.0
# Leakage between the antennas reaches a few cells under the Hann window.
_LEAKAGE_CELLS = 4

# Of an AWR1843 on the two-way path; it moves what is seen by half a range cell of this length.
_USUAL_DELAY_M = 0.15


@dataclass(frozen=True, kw_only=True)
class Finding:
    """An implausible property of a capture."""

    severity: str
    """"error": nothing useful can come out; "warning": check it before you trust the result."""
    message: str
    """What is wrong, with its number."""
    action: str = ""
    """What to do about it."""

    def __str__(self) -> str:
        return f"{self.message}; {self.action}" if self.action else self.message


def check_capture(summary: CaptureSummary) -> tuple[Finding, ...]:
    """All findings of a capture, errors first."""
    if not summary.poses:
        return (error("the scene has no planes"),)
    findings = [
        *_check_samples(summary),
        *_check_axes(summary),
        *_check_unit(summary),
        *_check_positions(summary),
        *_check_geometry(summary),
        *_check_ranges(summary),
        *_check_repeats(summary),
        *_check_sampling(summary),
    ]
    return tuple(sorted(findings, key=lambda finding: finding.severity))


def require_plausible(summary: CaptureSummary, where: object) -> tuple[Finding, ...]:
    """Raise UserError with the first error found; otherwise return the warnings."""
    return require_no_errors(check_capture(summary), where)


def require_no_errors(findings: Iterable[Finding], where: object) -> tuple[Finding, ...]:
    """Raise UserError with the first error of findings, else return them."""
    for finding in (kept := tuple(findings)):
        if finding.severity == "error":
            raise UserError(finding.message, where=where, hint=finding.action or None)
    return kept


def error(message: str) -> Finding:
    """Make a finding after which nothing useful can come out."""
    return Finding(severity="error", message=message)


def warning(message: str, action: str = "") -> Finding:
    """Make a finding that is to be checked before the result is trusted."""
    return Finding(severity="warning", message=message, action=action)


def format_mm(values_m: Iterable[float]) -> str:
    """Lengths or positions [m] in whole millimetres, as (x, y, z)."""
    return "(" + ", ".join(f"{1e3 * value:z.0f}" for value in values_m) + ")"


def _list(poses: Sequence[PoseSummary]) -> str:
    names = ", ".join(pose.name or "unnamed" for pose in poses[:3])
    return names if len(poses) <= 3 else f"{names} and {len(poses) - 3} more"


def _check_samples(summary: CaptureSummary) -> Iterator[Finding]:
    empty = [pose for pose in summary.poses if not pose.n_antennas]
    if empty:
        yield error(f"{len(empty)} planes have 0 antennas: {_list(empty)}")
    bad = [pose for pose in summary.poses if pose.n_bad_samples]
    if bad:
        total = sum(pose.n_bad_samples for pose in bad)
        yield error(f"{total} samples are NaN or infinite, in {_list(bad)}")
    bad = [pose for pose in summary.poses if pose.n_bad_positions]
    if bad:
        total = sum(pose.n_bad_positions for pose in bad)
        yield error(f"{total} antenna coordinates are NaN or infinite, in {_list(bad)}")
    full = [pose for pose in summary.poses if pose.n_antennas]
    dead = [pose for pose in full if pose.n_constant == pose.n_antennas]
    if dead and len(dead) == len(full):
        yield error("the signal is constant: every antenna has the same value in all samples")
    elif dead:
        yield warning(
            f"the signal is constant in {len(dead)} planes: {_list(dead)}", "record them again"
        )
    part = [pose for pose in full if 0 < pose.n_constant < pose.n_antennas]
    if part:
        total = sum(pose.n_constant for pose in part)
        yield warning(
            f"{total} antennas have a constant signal, in {_list(part)}",
            "frames were lost: record these planes again where many are",
        )
    clipped = [
        pose for pose in full if pose.n_constant == 0 and pose.saturated_fraction > MAX_SATURATED
    ]
    if clipped:
        percent = 100 * max(pose.saturated_fraction for pose in clipped)
        yield warning(
            f"{len(clipped)} planes look saturated ({percent:.1f} % of the samples sit on the "
            f"largest value): {_list(clipped)}",
            "lower the receiver gain",
        )
    yield from _check_offsets(full)
    levels = np.array([pose.rms for pose in full if pose not in dead])
    if levels.size > 2:
        with np.errstate(divide="ignore"):
            decibels = 20 * np.log10(levels / np.median(levels))
        odd = [
            p
            for p, level in zip([p for p in full if p not in dead], decibels, strict=True)
            if abs(level) > _MAX_LEVEL_DB
        ]
        if odd:
            yield warning(
                f"the level of {len(odd)} planes is more than {_MAX_LEVEL_DB:.0f} dB off the "
                f"median: {_list(odd)}",
                "check their gain and channels",
            )


def _check_axes(summary: CaptureSummary) -> Iterator[Finding]:
    """Yield findings about invalid axes and positions."""
    full = [pose for pose in summary.poses if pose.n_antennas]
    errors = [np.abs(pose.axes @ pose.axes.T - np.eye(3)).max() for pose in full]
    odd = [pose for pose, off in zip(full, errors, strict=True) if not off < _MAX_AXES_ERROR]
    if odd:
        yield error(f"the axes of {len(odd)} planes are not orthonormal: {_list(odd)}")
    far = [pose for pose in full if pose.farthest_m > MAX_ANTENNA_M]
    if far:
        largest = max(pose.farthest_m for pose in far)
        yield error(f"antenna coordinates reach {largest:.3g} m, in {_list(far)}")


def _check_positions(summary: CaptureSummary) -> Iterator[Finding]:
    """Yield findings about antennas far from partner or planes, or inside the box."""
    full = [pose for pose in summary.poses if pose.n_antennas]
    far = [pose for pose in full if pose.farthest_m > MAX_ANTENNA_M]
    hint = "are some positions in millimetres? all must be in metres"
    apart = [pose for pose in full if pose.apart_m > _MAX_APART_M and pose not in far]
    if apart:
        most = max(pose.apart_m for pose in apart)
        yield error(
            f"transmitters stand up to {most:.3g} m from their receivers, in {_list(apart)}; {hint}"
        )
    rest = [pose for pose in summary.usable_poses if pose not in far and pose not in apart]
    centers = np.array([pose.center for pose in rest]).reshape(-1, 3)
    if len(rest) > 2:
        away = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
        limit = max(_MAX_APART_M, _MAX_STRAY * float(np.median(away)))
        stray = [pose for pose, one in zip(rest, away, strict=True) if one > limit]
        if stray:
            yield error(
                f"{len(stray)} planes lie up to {away.max():.3g} m from the others: "
                f"{_list(stray)}; {hint}"
            )
    if summary.walls:
        middle, half = np.array(summary.walls[0].center_m), 0.5 * np.array(summary.walls[0].size_m)
        inside = [p for p in rest if (np.abs(p.corners_m - middle) < half).all(axis=1).any()]
        if inside:
            yield error(
                f"antennas of {len(inside)} planes stand within the outer wall: {_list(inside)};"
                " check its size and position, and the unit of the antennas' positions"
            )


def _check_offsets(poses: Sequence[PoseSummary]) -> Iterator[Finding]:
    """Yield findings about constant offset and interference."""
    offset = [pose for pose in poses if pose.dc_fraction > _MAX_DC and not pose.n_constant]
    if offset:
        percent = 100 * max(pose.dc_fraction for pose in offset)
        yield warning(
            f"{len(offset)} planes have a constant offset (DC) of up to {percent:.1f} % of their "
            f"power: {_list(offset)}",
            "'geraf2 reconstruct' subtracts what harms; for other uses subtract the mean of the "
            "samples before the import",
        )
    noisy = [pose for pose in poses if pose.n_noisy > max(1, _MAX_NOISY * pose.n_antennas)]
    if noisy:
        total = sum(pose.n_noisy for pose in noisy)
        yield warning(
            f"{total} antennas are 10 dB noisier than those around them, in {_list(noisy)}: "
            "interference, or frames that were lost in part",
            "switch other radars off and record these planes again",
        )


def _check_unit(summary: CaptureSummary) -> Iterator[Finding]:
    """Yield findings about the unit, by spacing and wavelength, extent and range."""
    wavelength = summary.waveform.center_wavelength_m
    limit = summary.waveform.unambiguous_range_m
    # Receivers of a board are near each other in any unit of the board's positions.
    spacing = float(np.fmax(summary.spacing_m, _mean_spacing_m(summary)))
    aperture = max(summary.aperture_m)
    if spacing <= wavelength:  # sampled as a radar is; few frequencies make a short range
        return
    clues = []
    if spacing > MAX_SPACING_WAVELENGTHS * wavelength:
        clues.append(f"antennas are {spacing:.3g} m ({spacing / wavelength:.0f} wavelengths) apart")
    if aperture > limit:
        clues.append(f"a plane is {aperture:.3g} m wide")
    if summary.standoff_m > limit:
        clues.append(f"the planes look at a point {summary.standoff_m:.3g} m away")
    if not clues:
        return
    # Of the two units the one whose distance is nearer to half a metre, as boxes are scanned. A
    # distance that the echoes give is in metres; then the spacing nearer to half a wavelength.
    given, usual = summary.standoff_m, 0.5
    if not given > limit:  # NaN where no distance is known
        given, usual = spacing, 0.5 * wavelength
    format_mm, in_cm = (abs(np.log(given / per_m / usual)) for per_m in (1e3, 1e2))
    unit = "centimetres" if in_cm < format_mm else "millimetres"
    yield error(
        f"positions do not look like metres: {'; '.join(clues)}, but the unambiguous range is "
        f"{limit:.3g} m; if they are in {unit}, convert them to metres"
    )


def _mean_spacing_m(summary: CaptureSummary) -> float:
    """Spacing of as many antennas spread evenly over the plane, or along the line [m]."""
    spacings = []
    for pose in summary.usable_poses:
        _, width, height = pose.extent_m
        line = max(width, height) / pose.n_antennas
        spacings.append(max(line, np.sqrt(width * height / pose.n_antennas)))
    return float(np.median(spacings)) if spacings else float("nan")


def _check_geometry(summary: CaptureSummary) -> Iterator[Finding]:
    poses, focus = summary.usable_poses, summary.focus
    # A single plane faces its own strongest echo, in whatever range cell that is.
    away = []
    if focus is not None and not summary.is_plane:
        away = [pose for pose in poses if _looks_away(pose, focus)]
    if away and focus is not None:
        yield warning(
            f"{len(away)} planes do not look at the point the scan looks at "
            f"({focus[0]:z.3f}, {focus[1]:z.3f}, {focus[2]:z.3f}) m: {_list(away)}",
            "check the looking axis and the frame",
        )
    deep = [
        pose
        for pose in poses
        if pose.extent_m[0] > _MAX_DEPTH_FRACTION * max(pose.extent_m[1:].max(), 1e-9)
        and pose.extent_m[0] > summary.waveform.center_wavelength_m
    ]
    if deep:
        yield warning(
            f"{len(deep)} planes reach {max(pose.extent_m[0] for pose in deep):.3g} m along their "
            f"looking axis: {_list(deep)}",
            "are rows and columns of the axes swapped?",
        )
    point = [pose for pose in poses if pose.n_antennas > 1 and not pose.extent_m.max() > 0]
    if point:
        yield warning(
            f"all antennas of {len(point)} planes stand at one position: {_list(point)}",
            "check the log of positions",
        )
    width = summary.scene_width_m or 0.0
    if summary.standoff_m + width / 2 > summary.waveform.unambiguous_range_m >= summary.standoff_m:
        yield warning(
            f"the far side of the scene ({summary.standoff_m + width / 2:.3g} m) lies beyond the "
            f"unambiguous range ({summary.waveform.unambiguous_range_m:.3g} m)",
            "take more samples over the same band",
        )


def _check_ranges(summary: CaptureSummary) -> Iterator[Finding]:
    """Yield findings about the ranges of the echoes: of single planes, and of the stated box."""
    focus, n_samples = summary.focus, summary.waveform.n_samples
    poses = [p for p in summary.usable_poses if p.profile.any()]
    if summary.is_plane or focus is None or n_samples < 2 * _LEAKAGE_CELLS or not poses:
        return
    cell_m, away = summary.waveform.range_cell_m, [np.linalg.norm(p.center - focus) for p in poses]
    steps = np.round((np.array(away) - np.median(away)) / cell_m).astype(int)
    power = np.stack([np.roll(p.profile, -n) for p, n in zip(poses, steps, strict=True)])
    if len(poses) > 3:
        moved = [(p, n) for p, n in zip(poses, _shifts(power), strict=True) if n]
        if moved:
            most = max(abs(n) for _, n in moved)
            yield warning(
                f"the echoes of {len(moved)} planes lie up to {most * cell_m:.2f} m nearer or "
                f"farther than those of the others: {_list([p for p, _ in moved])}",
                "check the trigger of these recordings, and that they belong to these positions",
            )
    if summary.walls:
        yield from _check_content(summary, np.median(power, axis=0), float(np.median(away)))


def _shifts(power: Floats) -> list[int]:
    """Range cells by which the profile of each plane is moved against the others', (n_planes,)."""
    level = np.log(power + 1e-6 * power.max(axis=1, keepdims=True))
    level -= level.mean(axis=1, keepdims=True)
    common = np.median(level, axis=0)
    common -= common.mean()
    # Circular correlation at all shifts at once.
    product = np.fft.ifft(np.fft.fft(level, axis=1) * np.fft.fft(common).conj(), axis=1).real
    scale = np.linalg.norm(level, axis=1) * np.linalg.norm(common) + 1e-30
    fits = product / scale[:, None]
    n = power.shape[1]
    best = [int(k) for k in (fits.argmax(axis=1) + n // 2) % n - n // 2]
    sure = (fits.max(axis=1) > _MIN_FIT) & (fits.max(axis=1) - fits[:, 0] > _MIN_GAIN)
    return [
        k if abs(k) > _MAX_SHIFT_CELLS and is_sure else 0
        for k, is_sure in zip(best, sure, strict=True)
    ]


def _check_content(summary: CaptureSummary, power: Floats, away_m: float) -> Iterator[Finding]:
    """Yield findings about echoes within and outside the ranges of the stated box."""
    waveform, reach = summary.waveform, 0.5 * float(np.linalg.norm(summary.walls[0].size_m))
    ranges = np.arange(len(power)) * waveform.range_cell_m - 0.5 * waveform.path_bias_m
    ranges %= waveform.unambiguous_range_m
    off = np.abs(ranges - away_m)
    inside = off < reach + 2.0 * waveform.range_cell_m
    beyond = ~inside & (ranges > _LEAKAGE_CELLS * waveform.range_cell_m)
    beyond &= ranges < waveform.unambiguous_range_m - _LEAKAGE_CELLS * waveform.range_cell_m
    floor = float(np.partition(power, len(power) // 4)[len(power) // 4])
    where = f"{away_m - reach:.2f} to {away_m + reach:.2f} m"
    if not inside.any() or not floor > 0.0:
        return
    level_db = 10.0 * np.log10(power[inside].max() / floor)
    if level_db < _MIN_CONTENT_DB:
        yield warning(
            f"the echoes from the ranges of the stated box, {where}, are {level_db:.0f} dB above "
            "the weakest ranges: the box is empty or not there",
            "check path_bias_m, the walls and the receiver",
        )
    elif beyond.any() and power[beyond].max() > power[inside].max():
        most = float(ranges[beyond][power[beyond].argmax()])
        yield warning(
            f"the strongest echo comes from {most:.2f} m, outside the ranges of the stated box, "
            f"{where}",
            "check path_bias_m and the walls, or remove what stands there",
        )


def _looks_away(pose: PoseSummary, focus: Floats) -> bool:
    line = focus - pose.center
    distance = float(np.linalg.norm(line))
    return distance == 0 or float(pose.axes[0] @ line) < np.cos(_MAX_OFF_AXIS_RAD) * distance


def _check_repeats(summary: CaptureSummary) -> Iterator[Finding]:
    by_signal: dict[str, list[PoseSummary]] = defaultdict(list)
    for pose in summary.poses:
        if pose.n_antennas and pose.n_constant < pose.n_antennas:
            by_signal[pose.digest].append(pose)
    for same in by_signal.values():
        if len(same) > 1:
            yield warning(
                f"{len(same)} planes hold the same samples: {_list(same)}",
                "one recording was stored several times: find the missing ones",
            )
    repeated = [pose for pose in summary.poses if pose.n_repeated_positions]
    if repeated:
        total = sum(pose.n_repeated_positions for pose in repeated)
        yield warning(
            f"{total} antennas stand where another one of their plane does: {_list(repeated)}",
            "check the log of positions",
        )


def _check_sampling(summary: CaptureSummary) -> Iterator[Finding]:
    spacing, limit = summary.spacing_m, summary.nyquist_spacing_m
    sane = spacing <= MAX_SPACING_WAVELENGTHS * summary.waveform.center_wavelength_m
    if summary.walls and summary.is_coarse and sane:
        yield warning(
            f"antenna spacing {1e3 * spacing:.2f} mm is above the scene's Nyquist spacing "
            f"{1e3 * limit:.2f} mm: expect grating lobes at the edges of the scene",
            "scan a finer raster",
        )
    waveform = summary.waveform
    matters = waveform.range_cell_m < _USUAL_DELAY_M and not summary.delay_given
    if waveform.path_bias_m == 0 and matters:
        yield warning(
            "the instrument delay (waveform.path_bias_m) is 0: unless it was subtracted already, "
            "everything appears too far away",
            "'geraf2 calibrate' finds it by the box",
        )
