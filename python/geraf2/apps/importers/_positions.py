"""Where the radar was at each frame: robot logs, rasters, or one place; and its antennas."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import left_out
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.io.manifest import AntennaManifest, RasterManifest

Range = tuple[int, int]

# A robot that scans moves at some centimetres per second; its arm can do about 2 m/s.
_MAX_SPEED_M_PER_S = 2.0
# Without time stamps nothing tells the way back to the next row from a fault, but this does.
_MAX_STEP_M = 1.0
# Between two rows of a log the way is taken as straight. A hole in the log is this many of its
# usual steps long, and matters if the radar went farther in it than a few wavelengths.
_MAX_GAP_STEPS, _MAX_GAP_M = 20.0, 0.01
# Antennas of two descriptions are the same ones if they are nearer: a quarter of a wavelength.
_SAME_ANTENNA_M = 1e-3
# Places are a plane if they extend across it less than this part of their extent in it.
_MAX_FLATNESS = 0.3


class Track(Protocol):
    """Places of a recording; one place may be seen by several frames, which are averaged."""

    @property
    def frames_per_place(self) -> int:
        """Frames that are averaged."""

    @property
    def ranges(self) -> tuple[Range, ...]:
        """Places that can be used, as (first, stop)."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know."""

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """Positions (n, 3) [m] and rotations (n, 3, 3), end effector to capture frame."""

    def __str__(self) -> str:
        """Say what is known, in one line."""


@dataclass(frozen=True, kw_only=True)
class RasterTrack:
    """Rows and columns in the plane of the radar's horizontal and vertical axes."""

    raster: RasterManifest
    axes: Floats
    frames_per_place: int
    ranges: tuple[Range, ...]
    notes: tuple[str, ...] = ()

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """See Track.at."""
        row, column = np.divmod(np.arange(first, stop), self.raster.n_columns)
        if self.raster.serpentine:
            column = np.where(row % 2, self.raster.n_columns - 1 - column, column)
        along = (column - (self.raster.n_columns - 1) / 2) * self.raster.column_step_m
        up = (row - (self.raster.n_rows - 1) / 2) * self.raster.row_step_m
        center = np.asarray(self.raster.center_m)
        positions = center + along[:, None] * self.axes[1] + up[:, None] * self.axes[2]
        return positions, _identity(len(positions))

    def __str__(self) -> str:
        raster = self.raster
        return (
            f"raster of {raster.n_rows} rows x {raster.n_columns} columns, "
            f"{1e3 * raster.row_step_m:g} x {1e3 * raster.column_step_m:g} mm"
            f"{', serpentine' if raster.serpentine else ''}, {self.frames_per_place} frames a place"
        )


@dataclass(frozen=True, kw_only=True)
class StaticTrack:
    """One place at the origin."""

    frames_per_place: int
    ranges: tuple[Range, ...] = ((0, 1),)
    notes: tuple[str, ...] = ()

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """See Track.at."""
        return np.zeros((stop - first, 3)), _identity(stop - first)

    def __str__(self) -> str:
        return f"one place, {self.frames_per_place} frames averaged"


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTrack:
    """A robot log, interpolated at the times of the frames."""

    log: RobotLog
    start_time_s: float = 0.0
    frame_period_s: float = 0.0
    frames_per_place: int = 1
    ranges: tuple[Range, ...] = ()
    notes: tuple[str, ...] = ()
    plane_starts: tuple[int, ...] = (0,)
    """First place of each plane; those of one plane make a pose."""
    tx_delays_s: tuple[float, ...] = ()
    """When each transmitter sends, from the time of the frame; none: all at once [s]."""

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """See Track.at."""
        log = self.log
        if log.times_s is None:
            if log.quaternions is None:
                return log.positions[first:stop], _identity(stop - first)
            return log.positions[first:stop], _matrices(log.quaternions[first:stop])
        times = self.start_time_s + self.frame_period_s * np.arange(first, stop)
        # The last frame may lie a rounding behind the last row.
        times = np.clip(times, log.times_s[0], log.times_s[-1])
        positions = self._interpolated(times)
        if log.quaternions is None:
            return positions, _identity(len(times))
        return positions, np.asarray(log.turns(times).as_matrix())

    def each_tx(self, first: int, stop: int) -> Floats | None:
        """Where the end effector is when each transmitter sends, (n, n_tx, 3) [m].

        None where it is the same for all: one transmitter, all at once, or nothing that says how
        they take turns while the arm moves: no scan file, and no time between chirps.
        """
        scan, log_s = self.log.scan, self.log.times_s
        if log_s is None:
            return None
        times = self.start_time_s + self.frame_period_s * np.arange(first, stop)
        if scan is None and self.tx_delays_s:
            sent_s = times[:, None] + np.array(self.tx_delays_s)
            return self._interpolated(np.clip(sent_s, log_s[0], log_s[-1]))
        if scan is None or scan.motion != "continuous":
            return None
        late = scan.array.tx_delays_s
        if not late.any():
            return None
        slack = 0.01 * self.frame_period_s  # clocks are rounded
        velocity = np.zeros((len(times), 3))
        for line in (line for plane in scan.planes for line in plane.lines):
            on = (times >= line.start_s - slack) & (times <= line.end_s + slack)
            velocity[on] = line.velocity_m_per_s
        places = self._interpolated(np.clip(times, log_s[0], log_s[-1]))
        return np.asarray(places[:, None] + late[:, None] * velocity[:, None])

    def _interpolated(self, times_s: Floats) -> Floats:
        log = self.log
        assert log.times_s is not None
        ways = (np.interp(times_s, log.times_s, log.positions[:, axis]) for axis in range(3))
        return np.stack(list(ways), axis=-1)

    def __str__(self) -> str:
        log = self.log
        text = f"{len(log.positions)} rows of {log.path.name}"
        if log.times_s is None:
            return f"{text}, one for each {self.frames_per_place} frames"
        return (
            f"{text}, {log.times_s[0]:.6g} s to {log.times_s[-1]:.6g} s, interpolated at frames "
            f"from {self.start_time_s:.6g} s every {1e3 * self.frame_period_s:g} ms"
        )


AnyTrack = RasterTrack | StaticTrack | LogTrack


@dataclass(frozen=True, kw_only=True, eq=False)
class Board:
    """Antennas of the board in the frame of the end effector."""

    tx_offsets: Floats
    """(n_tx, 3) [m]."""
    rx_offsets: Floats
    """(n_rx, 3) [m]."""
    axes: Floats
    """Rows looking direction, horizontal, vertical."""
    notes: tuple[str, ...] = ()

    def antennas(self, positions: Floats, rotations: Floats) -> tuple[Floats, Floats]:
        """Transmitter and receiver of each antenna, (n_places * n_tx * n_rx, 3) [m].

        The receivers change fastest, the places slowest. Positions are (n_places, 3), or (n_places,
        n_tx, 3) where the board moves from one transmitter's chirp to the next's.
        """
        shape = (len(positions), len(self.tx_offsets), len(self.rx_offsets), 3)
        if rotations.strides[0] == 0:  # one rotation for all places is turned by once
            rotations = rotations[:1]
        where = positions if positions.ndim == 3 else positions[:, None]
        tx = where + np.einsum("nij,tj->nti", rotations, self.tx_offsets)
        turned = np.einsum("nij,rj->nri", rotations, self.rx_offsets)
        rx = where[:, :, None] + turned[:, None]
        return (
            np.broadcast_to(tx[:, :, None], shape).reshape(-1, 3),
            np.broadcast_to(rx, shape).reshape(-1, 3),
        )

    def mean_axes(self, track: Track) -> Floats:
        """Axes in the capture frame, turned by the mean rotation of the track."""
        first, stop = track.ranges[0][0], track.ranges[-1][1]
        chosen = np.unique(np.linspace(first, stop - 1, 256).astype(int))
        matrices = np.concatenate([track.at(k, k + 1)[1] for k in chosen])
        turn = Rotation.from_matrix(matrices).mean().as_matrix()
        return np.asarray(self.axes @ turn.T)


def board_of(antennas: AntennaManifest, *, n_tx: int, n_rx: int, center_hz: float) -> Board:
    """Antenna offsets as given; without them, the receivers of TI's evaluation boards.

    On these, receiver k lies 5 mm + (3 - k) lambda / 2 beside the first transmitter.
    """
    axes = np.eye(3) if antennas.axes is None else np.asarray(antennas.axes, dtype=np.float64)
    if float(np.abs(axes @ axes.T - np.eye(3)).max()) > 1e-3:
        raise UserError(what="antennas.axes must be orthonormal rows", got=antennas.axes)
    notes = []
    if antennas.tx_offsets_m is not None:
        tx = np.asarray(antennas.tx_offsets_m, dtype=np.float64)
    elif n_tx == 1:
        tx = np.zeros((1, 3))
    else:
        raise UserError(
            what=f"where the {n_tx} transmitters are is not known",
            hint="give tx_offsets_m under [antennas] of --radar",
        )
    if antennas.rx_offsets_m is not None:
        rx = np.asarray(antennas.rx_offsets_m, dtype=np.float64)
    else:
        half_wave = 0.5 * SPEED_OF_LIGHT_M_PER_S / center_hz
        rx = -(0.005 + (3 - np.arange(n_rx)) * half_wave)[:, None] * axes[1]
        notes.append(
            "where the receivers are is not known and was taken from TI's evaluation boards: 5 mm "
            "+ (3 - k) half wavelengths beside the transmitter; give rx_offsets_m under [antennas]"
        )
    for name, offsets, n in (("tx_offsets_m", tx, n_tx), ("rx_offsets_m", rx, n_rx)):
        if len(offsets) != n:
            raise UserError(
                what=f"antennas.{name} has the wrong length", expected=n, got=len(offsets)
            )
    return Board(tx_offsets=tx, rx_offsets=rx, axes=axes, notes=tuple(notes))


def plane_axes(places: Floats, *, towards: Floats | None, where: object) -> Floats:
    """Rows looking direction, horizontal, vertical, from places in a plane, (3, 3).

    places: (n, 3) [m]; values that are not finite are left out.
    towards: looks to this side of the plane; to the origin when None.
    where: the file, for messages.
    """
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        raise UserError(what="has no places", where=where)
    center = places.mean(axis=0)
    # A large scan is as flat as every 16th of its places.
    thinned = places[:: max(1, len(places) // 4096)]
    _, spread, directions = np.linalg.svd(thinned - center, full_matrices=False)
    looking = directions[-1] if len(directions) == 3 else np.zeros(3)
    side = float(looking @ (-center if towards is None else towards))
    flat = len(spread) == 3 and spread[2] < _MAX_FLATNESS * spread[1]
    if not flat or abs(side) < 1e-6:
        raise UserError(
            what="the looking direction is not known: the places are no plane"
            if not flat
            else "the looking direction is not known: either side of the plane may be meant",
            where=where,
            hint="give the axes",
        )
    looking = looking * np.sign(side)
    up = np.array([0.0, 0.0, 1.0])
    if abs(looking @ up) > 0.9:
        up = np.array([0.0, 1.0, 0.0])
    vertical = up - (up @ looking) * looking
    vertical /= np.linalg.norm(vertical)
    return np.stack([looking, np.cross(vertical, looking), vertical])


def raster_track(
    raster: RasterManifest, axes: Floats, n_frames: int, *, keep_good: bool, where: object
) -> RasterTrack:
    """Frames onto a raster; their number must be a multiple of its places."""
    n_places = raster.n_rows * raster.n_columns
    per_place, rest = divmod(n_frames, n_places)
    notes = []
    if rest:
        text, hint = f"{n_frames} frames do not fill the raster", "--keep-good uses what there is"
        expected = f"a multiple of {raster.n_rows} x {raster.n_columns} = {n_places}"
        notes.append(left_out(text, keep_good, where, expected=expected, hint=hint))
        per_place = max(per_place, 1)
    used = min(n_places, n_frames // per_place)
    return RasterTrack(
        raster=raster,
        axes=axes,
        frames_per_place=per_place,
        ranges=((0, used),),
        notes=tuple(notes),
    )


def without_places(track: AnyTrack, missing: Sequence[int]) -> AnyTrack:
    """Leave some places of a track out."""
    ranges = list(track.ranges)
    for place in missing:
        ranges = [
            part
            for first, stop in ranges
            for part in ((first, min(stop, place)), (max(first, place + 1), stop))
            if part[0] < part[1]
        ]
    if not ranges:
        raise UserError(what="no place is left")
    return replace(track, ranges=tuple(ranges))


def planes_of(track: AnyTrack) -> list[AnyTrack]:
    """Tracks of the poses that a recording holds: of a scan file its planes, else all in one."""
    if not isinstance(track, LogTrack) or len(track.plane_starts) < 2:
        return [track]
    firsts = [first for first, _ in track.ranges]
    plane = np.searchsorted(track.plane_starts, firsts, side="right")
    return [
        replace(track, ranges=tuple(track.ranges[k] for k in np.flatnonzero(plane == number)))
        for number in np.unique(plane)
    ]


def scan_antennas(
    radar: AntennaManifest, log: RobotLog | None, n_tx: int, n_rx: int
) -> AntennaManifest:
    """Antennas as given; what is left out is taken from a scan file."""
    if log is None or log.scan is None:
        return radar
    array = log.scan.array
    planned, there = (len(array.tx_offsets_m), len(array.rx_offsets_m)), (n_tx, n_rx)
    if planned != there:
        raise UserError(
            what="the array of the scan file contradicts the recording",
            where=log.path,
            expected=f"{planned[0]} transmitters and {planned[1]} receivers",
            got=f"{n_tx} and {n_rx}",
        )
    for name, known in (("tx_offsets_m", array.tx_offsets_m), ("rx_offsets_m", array.rx_offsets_m)):
        given = getattr(radar, name)
        if given is None or len(given) != len(known):
            continue
        off_m = float(np.linalg.norm(np.subtract(given, known), axis=1).max())
        if off_m > _SAME_ANTENNA_M:
            raise UserError(
                what="places of the scan file's array contradict those of --radar",
                where=log.path,
                expected=f"{name} within {1e3 * _SAME_ANTENNA_M:g} mm",
                got=f"{1e3 * off_m:.3g} mm",
            )
    return radar.model_copy(
        update={
            "tx_offsets_m": radar.tx_offsets_m or [list(o) for o in array.tx_offsets_m],
            "rx_offsets_m": radar.rx_offsets_m or [list(o) for o in array.rx_offsets_m],
        }
    )


def log_track(
    log: RobotLog,
    n_frames: int,
    *,
    frame_period_s: float | None,
    start_time_s: float | None,
    keep_good: bool,
    tx_delays_s: tuple[float, ...] = (),
) -> LogTrack:
    """Frames onto a robot log; see LogTrack."""
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
            "the time of the first frame is not known and was taken as that of the first row of "
            f"{log.path.name}; give start_time_s under [raw]"
        )
    covered, outside = _covered_frames(log, n_frames, start_time_s, frame_period_s, keep_good)
    if log.scan is not None:
        starts, ranges = _frames_on_lines(log, n_frames, start_time_s, frame_period_s, keep_good)
        n_used = sum(stop - first for first, stop in ranges)
        notes.append(f"{n_frames - n_used} of {n_frames} frames between the lines were left out")
        return LogTrack(
            log=log,
            start_time_s=start_time_s,
            frame_period_s=frame_period_s,
            ranges=ranges,
            notes=tuple(notes),
            plane_starts=starts,
        )
    notes += outside
    ranges, more = _without_jumps(log, covered, start_time_s, frame_period_s, keep_good)
    return LogTrack(
        log=log,
        start_time_s=start_time_s,
        frame_period_s=frame_period_s,
        ranges=ranges,
        notes=(*log.notes, *notes, *more),
        tx_delays_s=tx_delays_s,
    )


def _covered_frames(
    log: RobotLog, n_frames: int, start_time_s: float, frame_period_s: float, keep_good: bool
) -> tuple[Range, list[str]]:
    """Frames within the time stamps of the log."""
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


def _frames_on_lines(
    log: RobotLog, n_frames: int, start_s: float, period_s: float, keep_good: bool
) -> tuple[tuple[int, ...], tuple[Range, ...]]:
    """First frame of each plane of a scan file, and the frames on each of its lines."""
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
        if not keep_good or log.notes:
            raise UserError(
                what=f"{n_rows} positions without time stamps do not match {n_frames} frames",
                where=log.path,
                expected="one for each frame, or for each group of as many frames",
                hint="give time stamps" + ("" if log.notes else ", or --keep-good cuts the rest"),
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
    """Ranges of frames that lie in no jump and no hole of the log."""
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


def _identity(n: int) -> Floats:
    return np.broadcast_to(np.eye(3), (n, 3, 3))


def _matrices(quaternions: Floats) -> Floats:
    return np.asarray(Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix())
