"""Scan files: the planes, lines and speeds of a scan, before it is made or while it is read.

JSON holds all of it; CSV is a robot log (time, position, rotation), as `geraf2 import --positions`
reads it. All lengths are in metres, in the capture's frame, which turns with the object.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, MinLen
from scipy.spatial.transform import Rotation

from geraf2._bounds import Bounded, Triple
from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic, write_text_atomic
from geraf2.io.text import read_object
from geraf2.io.toml import from_table, to_table

SCAN_FORMAT = "geraf2-scan"
_TimeS = Annotated[float, Interval(ge=-1e12, le=1e12)]
_SpeedMPerS = Annotated[float, Interval(gt=0.0, le=10.0)]
_Axes = tuple[Triple, Triple, Triple]
_MAX_ERROR = 1e-3  # of axes that are no rotation


@dataclass(frozen=True, kw_only=True)
class ScanLine(Bounded):
    """Straight path of the radar, with this many positions at equal distances."""

    start_m: Triple
    """First position [m]."""
    end_m: Triple
    """Last position [m]."""
    n_positions: Annotated[int, Interval(ge=1, le=1_000_000)]
    """Number of positions at which it records, both ends included."""
    start_s: _TimeS
    """Time of the first position: the middle of its chirps [s]."""
    speed_m_per_s: _SpeedMPerS
    """From the first position to the last; of stop and go the mean [m/s]."""
    phase_reference: str = ""
    """Group with a common phase reference, where several radars or runs were joined."""

    @property
    def end_s(self) -> float:
        """Time of the last place [s]."""
        length_m = np.linalg.norm(np.subtract(self.end_m, self.start_m))
        return self.start_s + float(length_m) / self.speed_m_per_s

    @property
    def times_s(self) -> Floats:
        """Times of the positions, (n_positions,) [s]."""
        return np.linspace(self.start_s, self.end_s, self.n_positions)

    @property
    def positions_m(self) -> Floats:
        """(n_positions, 3) [m]."""
        return np.linspace(self.start_m, self.end_m, self.n_positions)

    @property
    def velocity_m_per_s(self) -> Floats:
        """(3,) [m/s]; zero where the line is a point."""
        path = np.subtract(self.end_m, self.start_m)
        return np.asarray(self.speed_m_per_s * path / max(float(np.linalg.norm(path)), 1e-300))


@dataclass(frozen=True, kw_only=True)
class SweptPlane:
    """Lines that make a scan plane together."""

    name: str
    axes: _Axes
    """Rows: looking direction, horizontal, vertical."""
    lines: Annotated[tuple[ScanLine, ...], MinLen(1)]
    angle_deg: Annotated[float, Interval(ge=-3600.0, le=3600.0)] = 0.0
    """Angle of its middle about z, from x to y [degrees]."""

    def __post_init__(self) -> None:
        axes = np.asarray(self.axes, dtype=np.float64)
        if np.abs(axes @ axes.T - np.eye(3)).max() > _MAX_ERROR or np.linalg.det(axes) < 0:
            msg = f"axes of plane {self.name!r} must be orthonormal, right-handed rows"
            raise ValueError(msg)
        references = {line.phase_reference for line in self.lines}
        if len(references) > 1:
            msg = (
                f"sweeps of plane {self.name!r} overlap with different phase references, got "
                + " and ".join(repr(name) for name in sorted(references))
            )
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class SweptArray(Bounded):
    """Antennas that the lines move, in the axes of the plane: looking, horizontal, vertical."""

    tx_offsets_m: Annotated[tuple[Triple, ...], MinLen(1)] = ((0.0, 0.0025, 0.0),)
    """(n_tx, 3) from the position of the array [m]."""
    rx_offsets_m: Annotated[tuple[Triple, ...], MinLen(1)] = ((0.0, -0.0025, 0.0),)
    """(n_rx, 3) from the position of the array [m]."""
    order: Literal["tdm", "ddm"] = "tdm"
    """Transmitters take turns chirp by chirp, or send at once, separated by their Doppler."""
    chirp_s: Annotated[float, Interval(gt=0.0, le=1e3)] = 1e-3
    """From one chirp to the next [s]."""

    @property
    def n_channels(self) -> int:
        """Number of antennas at each position."""
        return len(self.tx_offsets_m) * len(self.rx_offsets_m)

    @property
    def tx_delays_s(self) -> Floats:
        """When each transmitter sends, from the time of the position, (n_tx,) [s]."""
        n = len(self.tx_offsets_m)
        late = self.chirp_s * (np.arange(n) - 0.5 * (n - 1))
        return np.asarray(late if self.order == "tdm" else np.zeros(n))


@dataclass(frozen=True, kw_only=True)
class ScanFile:
    """Planes of a scan in the order of time, and the antennas that are swept over them."""

    planes: Annotated[tuple[SweptPlane, ...], MinLen(1)]
    array: SweptArray = field(default_factory=SweptArray)
    motion: Literal["continuous", "stop-and-go"] = "continuous"
    """Whether the radar moves while it records: then transmitters that take turns send
    at positions of their own."""
    spacing_m: Annotated[float, Interval(gt=0.0, le=10.0)]
    """Approximate distance of neighbouring antennas, by which apertures are cut [m]."""
    format: Literal["geraf2-scan"] = "geraf2-scan"
    format_version: Literal[1] = 1

    def __post_init__(self) -> None:
        lines = [(plane.name, line) for plane in self.planes for line in plane.lines]
        for (_, before), (name, line) in pairwise(lines):
            if line.start_s < before.end_s:
                msg = (
                    f"time stamps go back at plane {name!r}: a line starts at {line.start_s:.6g} s,"
                    f" before the one before it ends at {before.end_s:.6g} s"
                )
                raise ValueError(msg)

    @property
    def seconds(self) -> float:
        """Time from the first position to the last [s]."""
        return self.planes[-1].lines[-1].end_s - self.planes[0].lines[0].start_s

    @property
    def n_antennas(self) -> int:
        """Of the whole scan."""
        n_positions = sum(line.n_positions for plane in self.planes for line in plane.lines)
        return n_positions * self.array.n_channels

    def antennas(self, plane: SweptPlane) -> tuple[Floats, Floats]:
        """Transmitter and receiver of each antenna of a plane, both (n_antennas, 3) [m].

        Receivers change fastest, then transmitters, then positions, as in `geraf2 import dca1000`.
        In continuous motion, where transmitters take turns, the positions of the whole array are
        those at the time when each sends.
        """
        axes = np.asarray(plane.axes)
        tx, rx = (np.asarray(o) @ axes for o in (self.array.tx_offsets_m, self.array.rx_offsets_m))
        late = self.array.tx_delays_s * (self.motion == "continuous")
        parts = [
            line.positions_m[:, None] + late[:, None] * line.velocity_m_per_s
            for line in plane.lines
        ]
        positions = np.concatenate(parts)[:, :, None]  # position, transmitter, receiver
        shape = (*positions.shape[:2], len(rx), 3)
        return (
            np.broadcast_to(positions + tx[:, None], shape).reshape(-1, 3).copy(),
            np.broadcast_to(positions + rx, shape).reshape(-1, 3).copy(),
        )

    def log_rows(self) -> Floats:
        """Robot log: time, position, quaternion w x y z of each position, (n_positions, 8)."""
        parts = []
        for plane in self.planes:
            x, y, z, w = Rotation.from_matrix(np.asarray(plane.axes).T).as_quat()
            for line in plane.lines:
                turn = np.broadcast_to([w, x, y, z], (line.n_positions, 4))
                parts.append(np.column_stack([line.times_s, line.positions_m, turn]))
        return np.concatenate(parts)


def read_scan_file(path: Path) -> ScanFile:
    """Read a scan file; UserError where it is none, or its times decrease."""
    table = read_object(path)
    if table.get("format") != SCAN_FORMAT:
        raise UserError(what="is no scan file", where=path, expected=f'"format": "{SCAN_FORMAT}"')
    return from_table(table, ScanFile, path)


def write_scan_file(path: Path, scan: ScanFile) -> None:
    """Write a scan, whole or not at all: `.json` with all of it, `.csv` the robot's log."""
    if path.suffix == ".csv":
        rows = (
            f"{row[0]:.6f}," + ",".join(f"{value:z.9g}" for value in row[1:])
            for row in scan.log_rows()
        )
        write_text_atomic(path, "\n".join(["time_s,x_m,y_m,z_m,qw,qx,qy,qz", *rows]) + "\n")
        return
    write_json_atomic(path, to_table(scan))
