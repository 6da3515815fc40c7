"""Settings of a moving parcel that fixed arrays scan: `[belt]` of a simulation's spec."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, Few, LengthM, NotNegative, SignedM
from geraf2._types import Floats
from geraf2.scene.arrays import ARRAYS, find_array

_Share = Annotated[float, Interval(ge=-0.2, le=0.2)]
_Pair = tuple[SignedM, SignedM]


@dataclass(frozen=True, kw_only=True)
class BeltArraySpec(Bounded):
    """A fixed array, whose long side stands across the travel."""

    side: Literal["left", "right", "above", "below"]
    name: str = ""
    """Name; the side when not given."""
    board: str = "awr2243-cascade"
    """Board, as of `geraf2 plan --array`; of channels at one position the shortest baseline."""
    tx_m: tuple[_Pair, ...] = ()
    """Transmitter of each channel instead of a board's: across the travel, along it [m]."""
    rx_m: tuple[_Pair, ...] = ()
    """Receiver of each of these channels [m]."""
    n_boards: Few = 1
    """Boards in a line across the travel, which continue each other's channels."""
    row_m: LengthM = 0.004
    """Approximate distance of the board's channels that are recorded [m]."""
    station_m: SignedM = 0.0
    """Position along the belt [m]."""
    standoff_m: LengthM = 0.35
    """Distance from the middle of the belt's parcels [m]."""
    offset_m: SignedM = 0.0
    """Middle of the channels across the travel, up beside the belt [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.tx_m) != len(self.rx_m):
            msg = f"tx_m and rx_m must have one entry a channel, got {len(self.tx_m)} and "
            raise ValueError(msg + str(len(self.rx_m)))
        if self.board not in ARRAYS:
            msg = f"board must be one of {', '.join(ARRAYS)}, got {self.board!r}"
            raise ValueError(msg)

    def channels(self) -> tuple[Floats, Floats, Floats]:
        """Transmitters, receivers (n, 2), across and along the travel [m], and turns (n,)."""
        if self.tx_m:
            tx, rx = np.array(self.tx_m), np.array(self.rx_m)
            return tx, rx, np.unique(tx, axis=0, return_inverse=True)[1].ravel().astype(float)
        tx, rx, turn = find_array(self.board).line(self.row_m)
        middles = 0.5 * (tx + rx)[:, 0]
        step = float(np.median(np.diff(np.sort(middles)))) if len(tx) > 1 else self.row_m
        pitch = float(np.ptp(middles)) + step
        shifts = pitch * (np.arange(self.n_boards) - 0.5 * (self.n_boards - 1))
        shift = np.array([1.0, 0.0]) * shifts[:, None, None]
        return (tx + shift).reshape(-1, 2), (rx + shift).reshape(-1, 2), np.tile(turn, len(shifts))


@dataclass(frozen=True, kw_only=True)
class BeltSpec(Bounded):
    """A belt that carries the parcel past fixed arrays, and the errors of its motion."""

    arrays: Annotated[tuple[BeltArraySpec, ...], MinLen(1)]
    speed_m_per_s: Annotated[float, Interval(gt=0.0, le=10.0)] = 0.5
    """Speed of the belt [m/s]."""
    travel_m: LengthM = 1.0
    """Travel past each array that is recorded, half of it before [m]."""
    frame_m: LengthM = 0.004
    """Nominal travel between frames that are recorded [m]."""
    chirp_s: Annotated[float, Interval(ge=0.0, le=1.0)] = 60e-6
    """From one transmitter's chirp to the next; 0: all at once, separated by Doppler [s]."""
    segment_m: LengthM = 0.25
    """Travel of one plane of the scene [m]."""
    encoder: bool = True
    """Whether the encoder's travel is recorded; else the nominal speed times the time."""
    speed_error: _Share = 0.0
    """Recorded over true travel, less 1."""
    speed_change: _Share = 0.0
    """Change of the speed over the travel, as a share."""
    encoder_jitter_m: NotNegative = 0.0
    """Rms error of the encoder at each frame [m]."""
    vibration_rms_m: NotNegative = 0.0
    """Rms vibration of the parcel across the travel, sideways and up [m]."""
    yaw_drift_deg: Annotated[float, Interval(ge=-45.0, le=45.0)] = 0.0
    """Rotation of the parcel about the vertical over the travel [degrees]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [array.name or array.side for array in self.arrays]
        if len(set(names)) < len(names):
            msg = f"arrays need different names, got {', '.join(names)}"
            raise ValueError(msg)

    @property
    def n_antennas(self) -> int:
        """Antennas of the whole scan."""
        n_channels = sum(len(array.channels()[0]) for array in self.arrays)
        return n_channels * (int(self.travel_m / self.frame_m) + 1)
