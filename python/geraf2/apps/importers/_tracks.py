"""Positions of the radar at each frame: from a robot log, on a raster, or one fixed position."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import note_omission
from geraf2.errors import UserError
from geraf2.io.manifest import RasterManifest

Range = tuple[int, int]

# A scanning robot moves at some centimetres per second; its arm reaches about 2 m/s.
_MAX_SPEED_M_PER_S = 2.0
# Without time stamps, longer steps are faults and no return to the next row.
_MAX_STEP_M = 1.0
# Between two rows of a log the motion is assumed to be straight. A hole is this many median steps
# long, and matters if the radar moved by more than a few wavelengths in it.
_MAX_GAP_STEPS, _MAX_GAP_M = 20.0, 0.01
# Frames that last less than this share of the log are named; they are refused where at most two
# rows lie between many of them, as with time stamps in milliseconds.
_LITTLE, _MIN_ROWS, _MIN_FRAMES = 0.1, 2, 8
# Speed of a turn, over twice this time; planes differ by more than 2 degrees.
_TURN_RAD_PER_S, _TURN_S, _TURN_RAD = 0.05, 0.1, 0.035
_TIME_UNITS = {
    "ms": ("milliseconds", 1e-3),
    "us": ("microseconds", 1e-6),
    "ns": ("nanoseconds", 1e-9),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Positions of a recording, by default one at the origin."""

    positions: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    """(n_positions, 3) [m]."""
    rotations: Rotation | None = None
    """End effector to capture frame, of each position; None: never turned."""
    tx_positions: Floats | None = None
    """At each transmitter's chirp, (n_positions, n_tx, 3) [m]; None where all share one."""
    frames_per_position: int = 1
    """Number of frames averaged at each position."""
    ranges: tuple[Range, ...] = ((0, 1),)
    """Usable positions, as (first, stop)."""
    plane_starts: tuple[int, ...] = (0,)
    """First position of each plane; the positions of one plane form a pose."""
    text: str
    """Description for the user."""
    notes: tuple[str, ...] = ()
    """Warnings for the user."""

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """Positions (n, 3) [m] and rotations (n, 3, 3), end effector to capture frame."""
        positions = self.positions[first:stop]
        if self.rotations is None:
            return positions, np.broadcast_to(np.eye(3), (len(positions), 3, 3))
        return positions, np.asarray(self.rotations[first:stop].as_matrix())


def raster_track(
    raster: RasterManifest, axes: Floats, n_frames: int, *, keep_good: bool, where: object
) -> Track:
    """Rows and columns along the radar's axes; the frames must be a multiple of the positions."""
    n_rows, n_columns = raster.n_rows, raster.n_columns
    per_position, rest = divmod(n_frames, n_rows * n_columns)
    notes = []
    if rest:
        text, hint = f"{n_frames} frames do not fill the raster", "--keep-good uses what there is"
        expected = f"a multiple of {n_rows} x {n_columns} = {n_rows * n_columns}"
        notes.append(note_omission(text, keep_good, where, expected=expected, hint=hint))
        per_position = max(per_position, 1)
    used = min(n_rows * n_columns, n_frames // per_position)
    row, column = np.divmod(np.arange(used), n_columns)
    if raster.serpentine:
        column = np.where(row % 2, n_columns - 1 - column, column)
    along = (column - (n_columns - 1) / 2) * raster.column_step_m
    up = (row - (n_rows - 1) / 2) * raster.row_step_m
    return Track(
        positions=np.asarray(raster.center_m) + along[:, None] * axes[1] + up[:, None] * axes[2],
        frames_per_position=per_position,
        ranges=((0, used),),
        notes=tuple(notes),
        text=f"raster of {n_rows} rows x {n_columns} columns, {1e3 * raster.row_step_m:g} x "
        f"{1e3 * raster.column_step_m:g} mm{', serpentine' if raster.serpentine else ''}, "
        f"{per_position} frames each",
    )


def remove_positions(track: Track, missing: Sequence[int]) -> Track:
    """Remove some positions from a track; UserError if none remains."""
    ranges = list(track.ranges)
    for position in missing:
        ranges = [
            part
            for first, stop in ranges
            for part in ((first, min(stop, position)), (max(first, position + 1), stop))
            if part[0] < part[1]
        ]
    if not ranges:
        raise UserError(what="no position remains")
    return replace(track, ranges=tuple(ranges))


def planes_of(track: Track) -> list[Track]:
    """Tracks of the poses of a recording: one for each plane of a scan file, else a single one."""
    plane = np.searchsorted(track.plane_starts, [first for first, _ in track.ranges], side="right")
    return [
        replace(track, ranges=tuple(track.ranges[k] for k in np.flatnonzero(plane == number)))
        for number in np.unique(plane)
    ]


def divide_at_turns(track: Track, period_s: float) -> Track:
    """Track whose planes are the stretches in which the board keeps its rotation.

    Frames during a turn are left out, unless the board turns all the time.
    """
    if track.rotations is None:
        return track
    first, stop = track.ranges[0][0], track.ranges[-1][1]
    turns = track.rotations[first:stop]
    reach = max(1, round(_TURN_S / period_s))
    frames = np.arange(stop - first)
    before = turns[np.maximum(frames - reach, 0)]
    angles = (turns[np.minimum(frames + reach, len(frames) - 1)] * before.inv()).magnitude()
    still = angles < _TURN_RAD_PER_S * 2 * reach * period_s
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    starts: list[int] = []
    ranges: list[tuple[int, int]] = []
    last = None
    for begin, end in edges.reshape(-1, 2):
        middle = turns[int(begin + end) // 2]
        if last is None or (middle * last.inv()).magnitude() > _TURN_RAD:
            starts.append(int(first + begin))
            last = middle
        cut = [(max(a, int(first + begin)), min(b, int(first + end))) for a, b in track.ranges]
        ranges += [(a, b) for a, b in cut if a < b]
    if len(starts) < 2:
        return track
    n_out = sum(b - a for a, b in track.ranges) - sum(b - a for a, b in ranges)
    note = f"{len(starts)} planes; {n_out} frames during turns between them were left out"
    notes = (*track.notes, note)
    return replace(track, ranges=tuple(ranges), plane_starts=tuple(starts), notes=notes)


@dataclass(frozen=True, eq=False)
class _Frames:
    """Frames of a recording on the clock of a log with time stamps."""

    log: RobotLog
    rows_s: Floats
    """Time stamps of the log, (n_rows,)."""
    n_frames: int
    start_s: float
    period_s: float
    keep_good: bool

    def time_s(self, frame: int) -> float:
        return self.start_s + self.period_s * frame

    def between(self, first_s: float, last_s: float) -> Range:
        """Frames from one time to another, both included; to a hundredth: clocks are rounded."""
        first = int(np.ceil((first_s - self.start_s) / self.period_s - 0.01))
        stop = int(np.floor((last_s - self.start_s) / self.period_s + 0.01)) + 1
        return max(first, 0), min(stop, self.n_frames)


def log_track(
    log: RobotLog,
    n_frames: int,
    *,
    frame_period_s: float | None,
    start_time_s: float | None,
    keep_good: bool,
    tx_delays_s: tuple[float, ...] = (),
) -> Track:
    """Track of a robot log, interpolated at the frames; UserError where its rows do not cover them.

    tx_delays_s: time of each transmitter's chirp after that of the frame; empty: all at once.
    """
    if log.times_s is None:
        return _one_row_a_frame(log, n_frames, keep_good=keep_good)
    if frame_period_s is None:
        raise UserError(
            what="the time between frames is not known",
            where=log.path,
            hint="give frame_period_s under [raw] of --radar, or the radar's --config",
        )
    notes = []
    if start_time_s is None:
        start_time_s = float(log.times_s[0])
        notes.append(
            "the time of the first frame is not known and was assumed to be that of the first row "
            f"of {log.path.name}; give start_time_s under [raw]"
        )
    frames = _Frames(log, log.times_s, n_frames, start_time_s, frame_period_s, keep_good)
    covered, outside = _covered_frames(frames)
    starts: tuple[int, ...] = (0,)
    if log.scan is not None:
        starts, ranges = _frames_on_lines(frames)
        n_used = sum(stop - first for first, stop in ranges)
        if n_used < n_frames:
            notes.append(f"{n_frames - n_used} of {n_frames} frames lie between the lines")
    else:
        outside += _require_rows_between(frames, covered)
        ranges, more = _remove_jumps(frames, covered)
        notes = [*log.notes, *notes, *outside, *more]
    times_s = np.asarray(start_time_s + frame_period_s * np.arange(n_frames))
    # Rounding may put the last frame after the last row.
    inside_s = np.clip(times_s, log.times_s[0], log.times_s[-1])
    return Track(
        positions=frames.log.positions_at(inside_s),
        rotations=None if log.quaternions is None else log.rotations_at(inside_s),
        tx_positions=_tx_positions(frames, times_s, tx_delays_s),
        ranges=ranges,
        plane_starts=starts,
        notes=tuple(notes),
        text=f"{_rows_of(log)}, {_shown(log.times_s[0])} to {_shown(log.times_s[-1])}, "
        f"interpolated at frames from {_shown(start_time_s)} every {1e3 * frame_period_s:g} ms",
    )


def _shown(time_s: float) -> str:
    return f"{round(float(time_s), 3) + 0.0:.15g} s"


def _rows_of(log: RobotLog) -> str:
    return f"{len(log.positions)} rows of {log.path.name}"


def _tx_positions(frames: _Frames, times_s: Floats, delays_s: tuple[float, ...]) -> Floats | None:
    """Positions at each transmitter's chirp; None for simultaneous chirps and without times."""
    scan = frames.log.scan
    if scan is None:
        return frames.log.positions_at(times_s[:, None] + np.array(delays_s)) if delays_s else None
    if scan.motion != "continuous" or not scan.array.tx_delays_s.any():
        return None
    slack = 0.01 * frames.period_s  # clocks are rounded
    velocity = np.zeros((len(times_s), 3))
    for line in (line for plane in scan.planes for line in plane.lines):
        on = (times_s >= line.start_s - slack) & (times_s <= line.end_s + slack)
        velocity[on] = line.velocity_m_per_s
    return np.asarray(
        frames.log.positions_at(times_s)[:, None]
        + scan.array.tx_delays_s[:, None] * velocity[:, None]
    )


def _covered_frames(frames: _Frames) -> tuple[Range, list[str]]:
    """Frames within the time stamps of the log, and notes."""
    rows_s, n_frames = frames.rows_s, frames.n_frames
    covered = frames.between(rows_s[0], rows_s[-1])
    spans = {
        "expected": f"frames {frames.start_s:.6f} s to {frames.time_s(n_frames - 1):.6f} s",
        "got": f"rows {rows_s[0]:.6f} s to {rows_s[-1]:.6f} s",
    }
    if covered[1] <= covered[0]:
        raise UserError(
            what="time stamps of positions and frames do not overlap",
            where=frames.log.path,
            hint="correct start_time_s under [raw]",
            **spans,
        )
    n_out = n_frames - (covered[1] - covered[0])
    if not n_out:
        return covered, []
    text = f"{n_out} of {n_frames} frames lie outside the time stamps"
    note_omission(text, frames.keep_good, frames.log.path, **spans)
    return covered, [f"{n_out} of {n_frames} frames outside the time stamps were left out"]


def _require_rows_between(frames: _Frames, covered: Range) -> list[str]:
    """Note where the frames cover little of the log; UserError where no row lies between them."""
    rows_s = frames.rows_s
    begin, end = frames.time_s(covered[0]), frames.time_s(covered[1] - 1)
    inside = int(((rows_s >= begin) & (rows_s <= end)).sum())
    span_s, log_s = end - begin, float(rows_s[-1] - rows_s[0])
    if not log_s > 0 or span_s > _LITTLE * log_s or covered[1] - covered[0] < _MIN_FRAMES:
        return []
    text = f"the frames last {span_s:.4g} s, {100 * span_s / log_s:.2g} % of the {log_s:.4g} s"
    if inside > _MIN_ROWS or len(rows_s) < _MIN_FRAMES:
        return [f"{text} of {frames.log.path.name}"]
    step = float(np.median(np.diff(rows_s))) / frames.period_s
    unit = min(_TIME_UNITS, key=lambda name: abs(np.log(step * _TIME_UNITS[name][1])))
    raise UserError(
        what=f"{text} of the log, and fewer than {_MIN_ROWS + 1} rows lie between them",
        where=frames.log.path,
        expected="time stamps in seconds",
        hint=f"are they {_TIME_UNITS[unit][0]}? name the column time_{unit}; or correct "
        "start_time_s",
    )


def _frames_on_lines(frames: _Frames) -> tuple[tuple[int, ...], tuple[Range, ...]]:
    """First frame of each plane of a scan file, and the range of frames on each of its lines."""
    assert frames.log.scan is not None
    starts, ranges = [], []
    for plane in frames.log.scan.planes:
        own = []
        for line in plane.lines:
            found = frames.between(line.start_s, line.end_s)
            if found[0] < found[1]:
                own.append(found)
            else:
                text = f"no frame was recorded on a line of plane {plane.name!r}"
                wanted, got = f"{line.start_s:.6g} s", f"{frames.time_s(frames.n_frames - 1):.6g} s"
                span = {"expected": wanted, "got": f"frames until {got}"}
                note_omission(text, frames.keep_good, frames.log.path, None, **span)
        starts += [own[0][0]] if own else []
        ranges += own
    return tuple(starts), tuple(ranges)


def _one_row_a_frame(log: RobotLog, n_frames: int, *, keep_good: bool) -> Track:
    n_rows = len(log.positions)
    per_position, rest = divmod(n_frames, n_rows)
    notes = list(log.notes)
    if rest or not per_position:
        if not keep_good or not log.is_whole:
            raise UserError(
                what=f"{n_rows} positions without time stamps do not match {n_frames} frames",
                where=log.path,
                expected="one for each frame, or for each group of as many frames",
                hint="give time stamps"
                + (", or --keep-good cuts the rest" if log.is_whole else ""),
            )
        per_position = max(per_position, 1)
        notes.append(f"{n_rows} positions for {n_frames} frames: the rest was cut")
    used = min(n_rows, n_frames // per_position)
    starts: tuple[int, ...] = (0,)
    if log.scan is not None:
        counts = [sum(line.n_positions for line in plane.lines) for plane in log.scan.planes]
        starts = tuple(k for k in np.cumsum([0, *counts[:-1]]).tolist() if k < used)
    else:
        steps = np.linalg.norm(np.diff(log.positions[:used], axis=0), axis=1)
        if steps.max(initial=0.0) > _MAX_STEP_M:
            bad = int(steps.argmax())
            raise UserError(
                what=f"positions jump by {steps[bad]:.3g} m after row {log.rows[bad]}",
                where=log.path,
                expected=f"steps below {_MAX_STEP_M:g} m",
                hint="positions are in metres",
            )
    return Track(
        positions=log.positions,
        rotations=None if log.quaternions is None else log.rotations,
        frames_per_position=per_position,
        ranges=tuple((first, min(stop, used)) for first, stop in pairwise([*starts, used])),
        plane_starts=starts,
        notes=tuple(notes),
        text=f"{_rows_of(log)}, one for each {per_position} frames",
    )


def _remove_jumps(frames: _Frames, covered: Range) -> tuple[tuple[Range, ...], list[str]]:
    """Ranges of frames outside the jumps and holes of the log, and a note."""
    log, rows_s = frames.log, frames.rows_s
    if len(rows_s) == 1:
        return (covered,), []
    dt = np.diff(rows_s)
    steps = np.linalg.norm(np.diff(log.positions, axis=0), axis=1)
    jumps = steps > _MAX_SPEED_M_PER_S * dt
    holes = ~jumps & (dt > _MAX_GAP_STEPS * np.median(dt)) & (steps > _MAX_GAP_M)
    begin_s, end_s = frames.time_s(covered[0]), frames.time_s(covered[1] - 1)
    met = (rows_s[1:] > begin_s) & (rows_s[:-1] < end_s)
    bad = np.flatnonzero((jumps | holes) & met)
    if not len(bad):
        return (covered,), []
    most = UserError(
        what=f"positions jump after {len(bad)} of {len(log.rows)} rows",
        where=log.path,
        expected=f"metres, and at most {_MAX_SPEED_M_PER_S:g} m/s",
        hint="check their unit: columns of millimetres are named x_mm, y_mm, z_mm",
    )
    if len(bad) > 0.5 * met.sum():
        raise most
    first = int(bad[0])
    kind = "jump" if jumps[first] else "have a hole, they move"
    if not frames.keep_good:
        raise UserError(
            what=f"positions {kind} by {steps[first]:.3g} m in {dt[first]:.3g} s after row "
            f"{log.rows[first]}" + (f", and {len(bad) - 1} times more" if len(bad) > 1 else ""),
            where=log.path,
            expected=f"metres, and at most {_MAX_SPEED_M_PER_S:g} m/s",
            hint="--keep-good leaves the frames in between out",
        )
    # Frames strictly between the two rows.
    out = np.zeros(covered[1], dtype=np.bool_)
    for k in bad:
        begin = int(np.floor((rows_s[k] - frames.start_s) / frames.period_s + 1e-9)) + 1
        end = int(np.ceil((rows_s[k + 1] - frames.start_s) / frames.period_s - 1e-9))
        out[max(begin, covered[0]) : max(end, 0)] = True
    good = np.flatnonzero(~out[covered[0] :]) + covered[0]
    if not len(good):
        raise most
    runs = np.split(good, np.flatnonzero(np.diff(good) > 1) + 1)
    ranges = tuple((int(run[0]), int(run[-1]) + 1) for run in runs)
    return ranges, [f"{out.sum()} frames at {len(bad)} jumps of the positions were left out"]
