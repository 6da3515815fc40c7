"""A capture in memory: poses, waveform, frame, walls."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from geraf2._validation import require_positive, require_shape
from geraf2.io.manifest import CalibrationManifest
from geraf2.scene.waveform import Waveform


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """One scan plane: every antenna (one tx/rx pair at one place) with its samples."""

    signal: NDArray[np.complex64]
    """Raw ADC samples, (n_antennas, n_samples)."""
    tx_positions: NDArray[np.float64]
    """Transmitter of each antenna, (n_antennas, 3) [m]."""
    rx_positions: NDArray[np.float64]
    """Receiver of each antenna, (n_antennas, 3) [m]."""
    axes: NDArray[np.float64]
    """Rows: looking direction, horizontal, vertical unit vectors in the frame, (3, 3)."""
    name: str = ""
    """Where it came from, e.g. the frame folder."""
    angle_deg: float | None = None
    """Turntable angle, if known [degrees]."""

    def __post_init__(self) -> None:
        n_antennas = self.signal.shape[0]
        require_shape("signal", self.signal, (None, None))
        require_shape("tx_positions", self.tx_positions, (n_antennas, 3))
        require_shape("rx_positions", self.rx_positions, (n_antennas, 3))
        require_shape("axes", self.axes, (3, 3))

    @property
    def n_antennas(self) -> int:
        """Number of antennas."""
        return int(self.signal.shape[0])

    @property
    def phase_centers(self) -> NDArray[np.float64]:
        """Midpoint of transmitter and receiver, (n_antennas, 3) [m]."""
        return np.asarray(0.5 * (self.tx_positions + self.rx_positions))


@dataclass(frozen=True, kw_only=True)
class Wall:
    """One closed dielectric shell around the content, outermost first in a scene."""

    size_m: tuple[float, float, float]
    """Outer side lengths [m]."""
    thickness_m: float
    """Wall thickness [m]."""
    permittivity: float
    """Relative permittivity, real part."""
    center_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of the box in the frame [m]."""

    def __post_init__(self) -> None:
        for side in self.size_m:
            require_positive("size_m", side)
        require_positive("thickness_m", self.thickness_m)
        if self.permittivity < 1.0:
            msg = f"permittivity must be at least 1, got {self.permittivity}"
            raise ValueError(msg)

    @property
    def one_way_delay_m(self) -> float:
        """Extra one-way path of a normal crossing, (sqrt(eps) - 1) thickness [m]."""
        return (float(np.sqrt(self.permittivity)) - 1.0) * self.thickness_m


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """Everything the radar measured, in metres, in one named frame."""

    waveform: Waveform
    poses: tuple[Pose, ...]
    frame: str = "capture"
    """Name of the right-handed frame that positions are given in."""
    walls: tuple[Wall, ...] = ()
    """Known walls, outermost first; empty when nothing is known."""
    calibration: tuple[CalibrationManifest, ...] = ()
    """What calibrations found, in order; samples, positions and delay already have it."""
    provenance: dict[str, str] = field(default_factory=dict)
    """Where the capture came from: importer, source, phase sign found, seed."""

    @property
    def n_antennas(self) -> int:
        """Antennas over all poses."""
        return sum(pose.n_antennas for pose in self.poses)
