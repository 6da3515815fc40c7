"""Antenna arrays of evaluation boards: where transmitters and receivers lie, in wavelengths.

Positions are the maker's, in half wavelengths of the frequency the board was designed for. The
distance from transmitters to receivers is not stated: public scanners with these boards use 5 mm
(Yanik and Torlak, "Near-field MIMO-SAR millimeter-wave imaging with sparsely sampled
aperture data", IEEE Access 7, 2019).
"""

from dataclasses import dataclass, replace

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.io.scan_file import SweptArray
from geraf2.io.toml import nearest_name

TX_RX_DISTANCE_M = 0.005
"""From the transmitters to the receivers: to the last of these, or to their line [m]."""


@dataclass(frozen=True, kw_only=True)
class AntennaArray:
    """Transmitters and receivers of a board, along its long side and across it."""

    name: str
    tx: tuple[tuple[float, float], ...]
    """Of each transmitter in half wavelengths, (n_tx, 2)."""
    rx: tuple[tuple[float, float], ...]
    """Of each receiver in half wavelengths, (n_rx, 2)."""
    design_hz: float
    """Frequency whose wavelength is meant [Hz]."""
    source: str
    """Document that states the positions."""
    in_line: bool = True
    """Whether transmitters lie beyond the last receiver, rather than beside the receivers' line."""

    def positions_m(self) -> tuple[Floats, Floats]:
        """Transmitters (n_tx, 2) and receivers (n_rx, 2), along and across, about the middle [m].

        The middle is that of all phase centres, each halfway from a transmitter to a receiver.
        """
        half = 0.5 * SPEED_OF_LIGHT_M_PER_S / self.design_hz
        tx, rx = half * np.asarray(self.tx), half * np.asarray(self.rx)
        if self.in_line:
            tx[:, 0] += rx[:, 0].max() - tx[:, 0].min() + TX_RX_DISTANCE_M
        else:
            tx[:, 1] += TX_RX_DISTANCE_M
        middle = 0.5 * (tx.mean(axis=0) + rx.mean(axis=0))
        return tx - middle, rx - middle

    def line(self, step_m: float) -> tuple[Floats, Floats, Ints]:
        """Channels of the main line whose phase centres lie about `step_m` [m] apart.

        Of the pairs at one position, that with the shortest baseline: its midpoint errs least.

        Returns positions of transmitters and receivers, along and across, (n, 2) [m] each, and the
        number of each transmitter, (n,).
        """
        tx, rx = self.positions_m()
        t, r = (grid.ravel() for grid in np.meshgrid(range(len(tx)), range(len(rx)), indexing="ij"))
        across = 0.5 * (tx[t, 1] + rx[r, 1])
        levels, counts = np.unique(np.round(across, 6), return_counts=True)
        own = np.flatnonzero(np.abs(across - levels[counts.argmax()]) < 1e-6)
        t, r = t[own], r[own]
        quarter = 0.25 * SPEED_OF_LIGHT_M_PER_S / self.design_hz
        along = 0.5 * (tx[t, 0] + rx[r, 0])
        position = np.rint((along - along.min()) / quarter).astype(np.int64)
        step = max(1, round(step_m / quarter))
        order = np.lexsort((np.abs(tx[t, 0] - rx[r, 0]), position))
        first = order[np.unique(position[order], return_index=True)[1]]
        kept = first[position[first] % step == 0]
        return tx[t[kept]], rx[r[kept]], t[kept]

    def sweep(self, *, order: str = "tdm", chirp_s: float = 1e-3) -> SweptArray:
        """Array whose long side stands upright, so that a sweep along the horizontal covers it.

        order: "tdm" or "ddm". chirp_s: from one chirp to the next [s].
        """
        tx, rx = (
            tuple((0.0, float(across), float(along)) for along, across in positions)
            for positions in self.positions_m()
        )
        return SweptArray(
            tx_offsets_m=tx,
            rx_offsets_m=rx,
            order="ddm" if order == "ddm" else "tdm",
            chirp_s=chirp_s,
        )


_THREE_TX = ((0.0, 0.0), (2.0, 1.0), (4.0, 0.0))
_FOUR_RX = tuple((float(k), 0.0) for k in range(4))
_CASCADE_RX = (*range(11, 15), *range(50, 54), *range(46, 50), *range(4))

_BOARDS = (
    AntennaArray(
        name="iwr1443",
        design_hz=79.0e9,
        source="TI SWRU518, xWR1443BOOST user's guide: TX1 and TX3 two wavelengths apart, TX2 "
        "between them, half a wavelength across; receivers every half wavelength",
        tx=_THREE_TX,
        rx=_FOUR_RX,
    ),
    AntennaArray(
        name="iwr1843",
        design_hz=79.0e9,
        source="TI SPRUIM4, xWR1843BOOST user's guide: as on the xWR1443BOOST",
        tx=_THREE_TX,
        rx=_FOUR_RX,
    ),
    AntennaArray(
        name="awr2243-cascade",
        tx=(
            *((11.0, 6.0), (10.0, 4.0), (9.0, 1.0)),
            *((float(4 * k), 0.0) for k in range(8, -1, -1)),
        ),
        rx=tuple((float(k), 0.0) for k in _CASCADE_RX),
        design_hz=76.8e9,
        in_line=False,
        source="TI TIDUEN5A, imaging radar with cascaded mmWave sensors, figure 6: 12 "
        "transmitters, 16 receivers, 86 virtual channels in azimuth",
    ),
)
ARRAYS: dict[str, AntennaArray] = {
    array.name: array
    for board in _BOARDS
    for array in (board, replace(board, name=board.name.replace("iwr", "awr")))
}
"""Boards by name; AWR boards have the antennas of the IWR board of their number."""


def column(n_channels: int, pitch_m: float) -> SweptArray:
    """One transmitter and receivers one above the other, phase centres `pitch_m` apart.

    n_channels: receivers, all at once. pitch_m: of the phase centres, half the receivers' [m].
    """
    half = 0.5 * TX_RX_DISTANCE_M
    up = 2.0 * pitch_m * (np.arange(n_channels) - 0.5 * (n_channels - 1))
    return SweptArray(
        tx_offsets_m=((0.0, half, 0.0),), rx_offsets_m=tuple((0.0, -half, float(v)) for v in up)
    )


def find_array(name: str) -> AntennaArray:
    """Board of this name; UserError where none is known."""
    if name not in ARRAYS:
        raise UserError(
            what=f"no such array {name!r}" + nearest_name(name, ARRAYS), expected=", ".join(ARRAYS)
        )
    return ARRAYS[name]
