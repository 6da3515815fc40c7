"""Positions of the radar at each frame: from a robot log, on a raster, or one fixed position."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geraf2._types import Floats
from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import left_out
from geraf2.errors import UserError
from geraf2.io.manifest import RasterManifest

Range = tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Positions of a recording, by default one at the origin; its text describes them."""

    frames_per_place: int = 1
    """Number of frames averaged at each position."""
    ranges: tuple[Range, ...] = ((0, 1),)
    """Usable positions, as (first, stop)."""
    notes: tuple[str, ...] = ()
    """Warnings for the user."""

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """Positions (n, 3) [m] and rotations (n, 3, 3), end effector to capture frame."""
        return np.zeros((stop - first, 3)), _identity(stop - first)

    def each_tx(self, first: int, stop: int) -> Floats | None:
        """Position at each transmitter's chirp, (n, n_tx, 3) [m]; None where all share one."""
        del first, stop
        return None

    def __str__(self) -> str:
        return f"one position, {self.frames_per_place} frames averaged"


@dataclass(frozen=True, kw_only=True, eq=False)
class RasterTrack(Track):
    """Rows and columns in the plane of the radar's horizontal and vertical axes."""

    raster: RasterManifest
    axes: Floats

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """Positions on the raster, none of them turned."""
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
            f"{', serpentine' if raster.serpentine else ''}, {self.frames_per_place} frames each"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTrack(Track):
    """Positions of a robot log, interpolated at the times of the frames."""

    log: RobotLog
    start_time_s: float = 0.0
    frame_period_s: float = 0.0
    plane_starts: tuple[int, ...] = (0,)
    """First position of each plane; the positions of one plane form a pose."""
    tx_delays_s: tuple[float, ...] = ()
    """Time of each transmitter's chirp after that of the frame [s]; empty: all at once."""

    def at(self, first: int, stop: int) -> tuple[Floats, Floats]:
        """Positions and rotations of the rows, or between them at the times of the frames."""
        log, times = self.log, self._times_s(first, stop)
        if log.times_s is None:
            positions = log.positions[first:stop]
        else:
            # Rounding may put the last frame after the last row.
            times = np.clip(times, log.times_s[0], log.times_s[-1])
            positions = self._interpolated(times)
        if log.quaternions is None:
            return positions, _identity(len(positions))
        turns = log.rotations[first:stop] if log.times_s is None else log.turns(times)
        return positions, np.asarray(turns.as_matrix())

    def each_tx(self, first: int, stop: int) -> Floats | None:
        """Position at each transmitter's chirp, (n, n_tx, 3) [m].

        None for simultaneous chirps and without chirp times (no scan file, no time between chirps).
        """
        scan = self.log.scan
        if self.log.times_s is None:
            return None
        times = self._times_s(first, stop)
        if scan is None and self.tx_delays_s:
            return self._interpolated(times[:, None] + np.array(self.tx_delays_s))
        if scan is None or scan.motion != "continuous" or not scan.array.tx_delays_s.any():
            return None
        delays_s = scan.array.tx_delays_s
        slack = 0.01 * self.frame_period_s  # clocks are rounded
        velocity = np.zeros((len(times), 3))
        for line in (line for plane in scan.planes for line in plane.lines):
            on = (times >= line.start_s - slack) & (times <= line.end_s + slack)
            velocity[on] = line.velocity_m_per_s
        positions = self._interpolated(times)
        return np.asarray(positions[:, None] + delays_s[:, None] * velocity[:, None])

    def _times_s(self, first: int, stop: int) -> Floats:
        return np.asarray(self.start_time_s + self.frame_period_s * np.arange(first, stop))

    def _interpolated(self, times_s: Floats) -> Floats:
        """Positions at any times, (..., 3); before and after the log those at its ends."""
        log = self.log
        assert log.times_s is not None
        axes = [np.interp(times_s, log.times_s, log.positions[:, axis]) for axis in range(3)]
        return np.stack(axes, axis=-1)

    def __str__(self) -> str:
        log = self.log
        text = f"{len(log.positions)} rows of {log.path.name}"
        if log.times_s is None:
            return f"{text}, one for each {self.frames_per_place} frames"
        return (
            f"{text}, {log.times_s[0]:.6g} s to {log.times_s[-1]:.6g} s, interpolated at frames "
            f"from {self.start_time_s:.6g} s every {1e3 * self.frame_period_s:g} ms"
        )


def raster_track(
    raster: RasterManifest, axes: Floats, n_frames: int, *, keep_good: bool, where: object
) -> RasterTrack:
    """Track of a raster; the number of frames must be a multiple of its positions."""
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


def without_places(track: Track, missing: Sequence[int]) -> Track:
    """Remove some positions from a track; UserError if none remains."""
    ranges = list(track.ranges)
    for place in missing:
        ranges = [
            part
            for first, stop in ranges
            for part in ((first, min(stop, place)), (max(first, place + 1), stop))
            if part[0] < part[1]
        ]
    if not ranges:
        raise UserError(what="no position remains")
    return replace(track, ranges=tuple(ranges))


def planes_of(track: Track) -> list[Track]:
    """Tracks of the poses of a recording: one for each plane of a scan file, else a single one."""
    if not isinstance(track, LogTrack) or len(track.plane_starts) < 2:
        return [track]
    firsts = [first for first, _ in track.ranges]
    plane = np.searchsorted(track.plane_starts, firsts, side="right")
    return [
        replace(track, ranges=tuple(track.ranges[k] for k in np.flatnonzero(plane == number)))
        for number in np.unique(plane)
    ]


def _identity(n: int) -> Floats:
    return np.broadcast_to(np.eye(3), (n, 3, 3))
