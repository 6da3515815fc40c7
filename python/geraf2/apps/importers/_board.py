"""Antennas of a board, and the axes of a plane of positions."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import require_equal
from geraf2.apps.importers._tracks import Track
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.io.manifest import AntennaManifest

# Antenna positions of two descriptions must agree to a quarter of a wavelength.
_SAME_ANTENNA_M = 1e-3
# Positions form a plane if their extent across it is below this share of that within it.
_MAX_FLATNESS = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class Board:
    """Antenna positions of a radar board in the frame of the end effector."""

    tx_offsets: Floats
    """(n_tx, 3) [m]."""
    rx_offsets: Floats
    """(n_rx, 3) [m]."""
    axes: Floats
    """Rows: viewing direction, horizontal, vertical."""
    notes: tuple[str, ...] = ()

    def antennas(self, positions: Floats, rotations: Floats) -> tuple[Floats, Floats]:
        """Transmitter and receiver of each antenna, (n_positions * n_tx * n_rx, 3) [m].

        The receivers change fastest, the positions slowest. `positions` is (n_positions, 3),
        or (n_positions, n_tx, 3) where the board moves between the chirps of its transmitters.
        """
        shape = (len(positions), len(self.tx_offsets), len(self.rx_offsets), 3)
        if rotations.strides[0] == 0:  # one rotation for all positions
            rotations = rotations[:1]
        origins = positions if positions.ndim == 3 else positions[:, None]
        tx = origins + np.einsum("nij,tj->nti", rotations, self.tx_offsets)
        turned = np.einsum("nij,rj->nri", rotations, self.rx_offsets)
        rx = origins[:, :, None] + turned[:, None]
        return (
            np.broadcast_to(tx[:, :, None], shape).reshape(-1, 3),
            np.broadcast_to(rx, shape).reshape(-1, 3),
        )

    def mean_axes(self, track: Track) -> Floats:
        """Axes in the capture frame, rotated by the mean rotation of the track."""
        if track.rotations is None:
            return self.axes
        first, stop = track.ranges[0][0], track.ranges[-1][1]
        chosen = np.unique(np.linspace(first, stop - 1, 256).astype(int))
        turn = Rotation.from_matrix(track.rotations[chosen].as_matrix()).mean().as_matrix()
        return np.asarray(self.axes @ turn.T)


def board_of(antennas: AntennaManifest, *, n_tx: int, n_rx: int, center_hz: float) -> Board:
    """Board with the given antenna offsets, or with those of TI's evaluation boards."""
    axes = np.eye(3) if antennas.axes is None else np.asarray(antennas.axes, dtype=np.float64)
    notes = []
    if antennas.tx_offsets_m is not None:
        tx = np.asarray(antennas.tx_offsets_m, dtype=np.float64)
    elif n_tx == 1:
        tx = np.zeros((1, 3))
    else:
        raise UserError(
            what=f"the positions of the {n_tx} transmitters are not known",
            hint="give tx_offsets_m under [antennas] of --radar",
        )
    if antennas.rx_offsets_m is not None:
        rx = np.asarray(antennas.rx_offsets_m, dtype=np.float64)
    else:
        rx = ti_receivers(n_rx, center_hz, axes[1])
        notes.append(
            "the receivers' positions are not known and assumed as on TI's evaluation boards: 5 mm "
            "+ (3 - k) half wavelengths beside the transmitter; give rx_offsets_m under [antennas]"
        )
    for name, offsets, n in (("tx_offsets_m", tx, n_tx), ("rx_offsets_m", rx, n_rx)):
        require_equal(f"antennas.{name} has the wrong length", None, n, len(offsets))
    return Board(tx_offsets=tx, rx_offsets=rx, axes=axes, notes=tuple(notes))


def ti_receivers(n_rx: int, center_hz: float, axis: Floats) -> Floats:
    """Receivers of TI's boards: 5 mm + (3 - k) lambda / 2 beside the transmitter, (n_rx, 3) [m]."""
    half_wave = 0.5 * SPEED_OF_LIGHT_M_PER_S / center_hz
    return -(0.005 + (3 - np.arange(n_rx)) * half_wave)[:, None] * axis


def plane_axes(positions: Floats, *, towards: Floats | None, where: object) -> Floats:
    """Rows viewing direction, horizontal, vertical, from positions in a plane, (3, 3).

    positions: (n, 3) [m]; non-finite rows are ignored.
    towards: vector to the viewed side of the plane; towards the origin when None.
    where: the file, for messages.
    """
    positions = positions[np.isfinite(positions).all(axis=1)]
    if not len(positions):
        raise UserError(what="has no finite positions", where=where)
    center = positions.mean(axis=0)
    thinned = positions[:: max(1, len(positions) // 4096)]
    _, spread, directions = np.linalg.svd(thinned - center, full_matrices=False)
    viewing = directions[-1] if len(directions) == 3 else np.zeros(3)
    side = float(viewing @ (-center if towards is None else towards))
    flat = len(spread) == 3 and spread[2] < _MAX_FLATNESS * spread[1]
    if not flat or abs(side) < 1e-6:
        raise UserError(
            what="the viewing direction is not known: the positions are no plane"
            if not flat
            else "the viewing direction is not known: either side of the plane may be meant",
            where=where,
            hint="give the axes",
        )
    viewing = viewing * np.sign(side)
    up = np.array([0.0, 0.0, 1.0])
    if abs(viewing @ up) > 0.9:
        up = np.array([0.0, 1.0, 0.0])
    vertical = up - (up @ viewing) * viewing
    vertical /= np.linalg.norm(vertical)
    return np.stack([viewing, np.cross(vertical, viewing), vertical])


def scan_antennas(
    radar: AntennaManifest, log: RobotLog | None, n_tx: int, n_rx: int
) -> AntennaManifest:
    """Given antennas, completed by those of a scan file; UserError where the two disagree."""
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
                what="antenna offsets of the scan file contradict those of --radar",
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
