"""Frames of a recording on the rows of a robot log."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import left_out
from geraf2.apps.importers._tracks import LogTrack, Range
from geraf2.errors import UserError

# A scanning robot moves at some centimetres per second; its arm reaches about 2 m/s.
_MAX_SPEED_M_PER_S = 2.0
# Without time stamps, longer steps are faults and no return to the next row.
_MAX_STEP_M = 1.0
# Between two rows of a log the motion is assumed to be straight. A hole is this many median steps
# long, and matters if the radar moved by more than a few wavelengths in it.
_MAX_GAP_STEPS, _MAX_GAP_M = 20.0, 0.01

# Frames that last less than this share of the log are named; they are refused where at most two
# rows lie between many of them, as with time stamps in milliseconds.
_LITTLE, _FEWEST_ROWS, _MIN_FRAMES = 0.1, 2, 8
_TIME_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_SUFFIXES = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}


def log_track(
    log: RobotLog,
    n_frames: int,
    *,
    frame_period_s: float | None,
    start_time_s: float | None,
    keep_good: bool,
    tx_delays_s: tuple[float, ...] = (),
) -> LogTrack:
    """Track of a robot log; UserError where its rows do not cover the frames."""
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
    covered, outside = _covered_frames(log, n_frames, start_time_s, frame_period_s, keep_good)
    timing = LogTrack(log=log, start_time_s=start_time_s, frame_period_s=frame_period_s)
    if log.scan is not None:
        starts, ranges = _frames_on_lines(log, n_frames, start_time_s, frame_period_s, keep_good)
        n_used = sum(stop - first for first, stop in ranges)
        if n_used < n_frames:
            notes.append(f"{n_frames - n_used} of {n_frames} frames lie between the lines")
        return replace(timing, ranges=ranges, notes=tuple(notes), plane_starts=starts)
    outside += _require_rows_between(log, covered, start_time_s, frame_period_s)
    ranges, more = _without_jumps(log, covered, start_time_s, frame_period_s, keep_good)
    notes = [*log.notes, *notes, *outside, *more]
    return replace(timing, ranges=ranges, notes=tuple(notes), tx_delays_s=tx_delays_s)


def _covered_frames(
    log: RobotLog, n_frames: int, start_time_s: float, frame_period_s: float, keep_good: bool
) -> tuple[Range, list[str]]:
    """Frames within the time stamps of the log, as (first, stop), and notes."""
    assert log.times_s is not None
    # A hundredth of a period: clocks are rounded.
    slack = 0.01 * frame_period_s
    first = int(np.ceil((log.times_s[0] - start_time_s - slack) / frame_period_s))
    stop = int(np.floor((log.times_s[-1] - start_time_s + slack) / frame_period_s)) + 1
    covered = (max(first, 0), min(stop, n_frames))
    end = start_time_s + (n_frames - 1) * frame_period_s
    spans = (
        f"frames {start_time_s:.6f} s to {end:.6f} s",
        f"rows {log.times_s[0]:.6f} s to {log.times_s[-1]:.6f} s",
    )
    if covered[1] <= covered[0]:
        raise UserError(
            what="time stamps of positions and frames do not overlap",
            where=log.path,
            expected=spans[0],
            got=spans[1],
            hint="correct start_time_s under [raw]",
        )
    n_out = n_frames - (covered[1] - covered[0])
    if n_out:
        text = f"{n_out} of {n_frames} frames lie outside the time stamps"
        wrong = {"expected": spans[0], "got": spans[1], "hint": "--keep-good leaves them out"}
        left_out(text, keep_good, log.path, **wrong)
        return covered, [f"{n_out} of {n_frames} frames outside the time stamps were left out"]
    return covered, []


def _require_rows_between(
    log: RobotLog, covered: Range, start_s: float, period_s: float
) -> list[str]:
    """Note where the frames cover little of the log; UserError where no row lies between them."""
    assert log.times_s is not None
    begin, end = (start_s + period_s * frame for frame in (covered[0], covered[1] - 1))
    inside = int(((log.times_s >= begin) & (log.times_s <= end)).sum())
    span_s, log_s = end - begin, float(log.times_s[-1] - log.times_s[0])
    if not log_s > 0 or span_s > _LITTLE * log_s or covered[1] - covered[0] < _MIN_FRAMES:
        return []
    text = f"the frames last {span_s:.4g} s, {100 * span_s / log_s:.2g} % of the {log_s:.4g} s"
    if inside > _FEWEST_ROWS or len(log.times_s) < _MIN_FRAMES:
        return [f"{text} of {log.path.name}"]
    step = float(np.median(np.diff(log.times_s))) / period_s
    unit = min(_TIME_UNITS, key=lambda name: abs(np.log(step * _TIME_UNITS[name])))
    raise UserError(
        what=f"{text} of the log, and fewer than {_FEWEST_ROWS + 1} rows lie between them",
        where=log.path,
        expected="time stamps in seconds",
        hint=f"are they {unit}? name the column time_{_SUFFIXES[unit]}; or correct start_time_s",
    )


def _frames_on_lines(
    log: RobotLog, n_frames: int, start_s: float, period_s: float, keep_good: bool
) -> tuple[tuple[int, ...], tuple[Range, ...]]:
    """First frame of each plane of a scan file, and the range of frames on each of its lines."""
    assert log.scan is not None
    starts, ranges = [], []
    for plane in log.scan.planes:
        own = []
        for line in plane.lines:
            # A hundredth of a period: clocks are rounded.
            first = int(np.ceil((line.start_s - start_s) / period_s - 0.01))
            stop = int(np.floor((line.end_s - start_s) / period_s + 0.01)) + 1
            if max(first, 0) < min(stop, n_frames):
                own.append((max(first, 0), min(stop, n_frames)))
            else:
                text = f"no frame was recorded on a line of plane {plane.name!r}"
                span = f"frames until {start_s + (n_frames - 1) * period_s:.6g} s"
                left_out(text, keep_good, log.path, expected=f"{line.start_s:.6g} s", got=span)
        starts += [own[0][0]] if own else []
        ranges += own
    return tuple(starts), tuple(ranges)


def _one_row_a_frame(log: RobotLog, n_frames: int, *, keep_good: bool) -> LogTrack:
    n_rows = len(log.positions)
    per_place, rest = divmod(n_frames, n_rows)
    notes = list(log.notes)
    if rest or not per_place:
        if not keep_good or not log.is_whole:
            raise UserError(
                what=f"{n_rows} positions without time stamps do not match {n_frames} frames",
                where=log.path,
                expected="one for each frame, or for each group of as many frames",
                hint="give time stamps"
                + (", or --keep-good cuts the rest" if log.is_whole else ""),
            )
        per_place = max(per_place, 1)
        notes.append(f"{n_rows} positions for {n_frames} frames: the rest was cut")
    used = min(n_rows, n_frames // per_place)
    if log.scan is not None:
        counts = [sum(line.n_places for line in plane.lines) for plane in log.scan.planes]
        starts = tuple(k for k in np.cumsum([0, *counts[:-1]]).tolist() if k < used)
        ranges = tuple((a, min(b, used)) for a, b in pairwise([*starts, used]))
        return LogTrack(
            log=log,
            frames_per_place=per_place,
            ranges=ranges,
            notes=tuple(notes),
            plane_starts=starts,
        )
    steps = np.linalg.norm(np.diff(log.positions[:used], axis=0), axis=1)
    if steps.size and steps.max() > _MAX_STEP_M:
        bad = int(steps.argmax())
        raise UserError(
            what=f"positions jump by {steps[bad]:.3g} m after row {log.rows[bad]}",
            where=log.path,
            expected=f"steps below {_MAX_STEP_M:g} m",
            hint="positions are in metres",
        )
    return LogTrack(log=log, frames_per_place=per_place, ranges=((0, used),), notes=tuple(notes))


def _without_jumps(
    log: RobotLog, covered: Range, start_s: float, period_s: float, keep_good: bool
) -> tuple[tuple[Range, ...], list[str]]:
    """Ranges of frames outside the jumps and holes of the log, and a note."""
    assert log.times_s is not None
    dt = np.diff(log.times_s)
    steps = np.linalg.norm(np.diff(log.positions, axis=0), axis=1)
    jumps = steps > _MAX_SPEED_M_PER_S * dt
    holes = ~jumps & (dt > _MAX_GAP_STEPS * np.median(dt)) & (steps > _MAX_GAP_M)
    begin_s, end_s = (start_s + period_s * frame for frame in (covered[0], covered[1] - 1))
    met = (log.times_s[1:] > begin_s) & (log.times_s[:-1] < end_s)
    bad = np.flatnonzero((jumps | holes) & met)
    if not len(bad):
        return (covered,), []
    first = int(bad[0])
    kind = "jump" if jumps[first] else "have a hole, they move"
    if not keep_good:
        raise UserError(
            what=f"positions {kind} by {steps[first]:.3g} m in {dt[first]:.3g} s after row "
            f"{log.rows[first]}" + (f", and {len(bad) - 1} times more" if len(bad) > 1 else ""),
            where=log.path,
            expected=f"metres, and at most {_MAX_SPEED_M_PER_S:g} m/s",
            hint="--keep-good leaves the frames in between out",
        )
    ranges, at, n_out = [], covered[0], 0
    for k in bad:
        # Frames strictly between the two rows.
        begin = int(np.floor((log.times_s[k] - start_s) / period_s + 1e-9)) + 1
        end = int(np.ceil((log.times_s[k + 1] - start_s) / period_s - 1e-9))
        begin, end = max(begin, at), min(end, covered[1])
        if end > begin:
            n_out += end - begin
            if begin > at:
                ranges.append((at, begin))
            at = end
    if covered[1] > at:
        ranges.append((at, covered[1]))
    if not ranges or len(bad) > 0.5 * met.sum():
        raise UserError(
            what=f"positions jump after {len(bad)} of {len(log.rows)} rows",
            where=log.path,
            hint="check their unit",
        )
    return tuple(ranges), [f"{n_out} frames at {len(bad)} jumps of the positions were left out"]
