"""Records that files, simulation and reconstruction share: waveform, wall, scan plane.

Intervals are broad physical limits, checked by :mod:`geraf2.io.toml`: they catch a value in GHz, us
or mm, not a poor choice.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from geraf2._types import Floats, Ints
from geraf2._validation import require_finite, require_positive, require_shape
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S

FrequencyHz = Annotated[float, Interval(ge=1e8, le=1e13)]
SlopeHzPerS = Annotated[float, Interval(ge=1e9, le=1e18)]
RateHz = Annotated[float, Interval(ge=1e2, le=1e12)]
SampleCount = Annotated[int, Interval(ge=1, le=1 << 20)]
BiasM = Annotated[float, Interval(ge=-100.0, le=100.0)]
Metres = Annotated[float, Interval(ge=-1e6, le=1e6)]
SideM = Annotated[float, Interval(gt=0.0, le=1e3)]
Permittivity = Annotated[float, Interval(ge=1.0, le=1e3)]

Samples = NDArray[np.complex64] | NDArray[np.int16]
"""complex64 (n_antennas, n_samples), or int16 (n_antennas, n_samples, 2), I and Q."""


@dataclass(frozen=True, kw_only=True)
class Waveform:
    """A linear chirp; the signal of one path of length d is exp(-j 2 pi (nu + k t) d / c).

    Raises
    ------
    ValueError
        If a frequency, rate or count is not positive.

    Examples
    --------
    >>> chirp = geraf2.Waveform(
    ...     start_frequency_hz=77e9, chirp_slope_hz_per_s=70e12, sample_rate_hz=625e3, n_samples=32
    ... )
    >>> round(chirp.range_cell_m, 4), chirp.frequencies_hz.shape
    (0.0418, (32,))
    """

    start_frequency_hz: FrequencyHz
    """Frequency nu at the first ADC sample [Hz]."""
    chirp_slope_hz_per_s: SlopeHzPerS
    """Slope k [Hz/s]."""
    sample_rate_hz: RateHz
    """Complex ADC samples per second [Hz]."""
    n_samples: SampleCount
    """ADC samples per chirp."""
    path_bias_m: BiasM = 0.0
    """Instrument delay on the two-way path [m]; part of every path length."""

    def __post_init__(self) -> None:
        require_positive("start_frequency_hz", self.start_frequency_hz)
        require_positive("chirp_slope_hz_per_s", self.chirp_slope_hz_per_s)
        require_positive("sample_rate_hz", self.sample_rate_hz)
        require_finite("path_bias_m", self.path_bias_m)
        if self.n_samples < 1:
            msg = f"n_samples must be at least 1, got {self.n_samples}"
            raise ValueError(msg)

    @property
    def frequencies_hz(self) -> Floats:
        """Instantaneous frequency of each sample, (n_samples,) [Hz]."""
        times = np.arange(self.n_samples) / self.sample_rate_hz
        return self.start_frequency_hz + self.chirp_slope_hz_per_s * times

    @property
    def bandwidth_hz(self) -> float:
        """Swept bandwidth, n_samples steps [Hz]."""
        return self.chirp_slope_hz_per_s * self.n_samples / self.sample_rate_hz

    @property
    def center_frequency_hz(self) -> float:
        """Mean of the sampled frequencies [Hz]."""
        return float(self.frequencies_hz.mean())

    @property
    def center_wavelength_m(self) -> float:
        """Wavelength at mid-band [m]."""
        return SPEED_OF_LIGHT_M_PER_S / self.center_frequency_hz

    @property
    def range_cell_m(self) -> float:
        """One-way range resolution c / 2B [m]."""
        return SPEED_OF_LIGHT_M_PER_S / (2.0 * self.bandwidth_hz)

    @property
    def unambiguous_range_m(self) -> float:
        """One-way range at which the beat frequency wraps, instrument delay included [m]."""
        return self.range_cell_m * self.n_samples


@dataclass(frozen=True, kw_only=True)
class Wall:
    """One closed dielectric shell around the content, outermost first in a scene.

    Raises
    ------
    ValueError
        If a length is not positive or the permittivity is below 1.

    Examples
    --------
    >>> carton = geraf2.Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6)
    >>> round(carton.one_way_delay_m, 5)
    0.00106
    """

    size_m: tuple[SideM, SideM, SideM]
    """Outer side lengths [m]."""
    thickness_m: SideM
    """Wall thickness [m]."""
    permittivity: Permittivity
    """Relative permittivity, real part."""
    center_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """Centre of the box in the frame [m]."""

    def __post_init__(self) -> None:
        for side in self.size_m:
            require_positive("size_m", side)
        require_positive("thickness_m", self.thickness_m)
        if self.permittivity < 1.0:
            msg = f"permittivity must be at least 1, got {self.permittivity}"
            raise ValueError(msg)
        if 2.0 * self.thickness_m >= min(self.size_m):
            msg = f"thickness_m leaves no room inside {self.size_m}, got {self.thickness_m}"
            raise ValueError(msg)

    @property
    def inner_size_m(self) -> tuple[float, float, float]:
        """Inner side lengths [m]."""
        x, y, z = (side - 2.0 * self.thickness_m for side in self.size_m)
        return x, y, z

    @property
    def one_way_delay_m(self) -> float:
        """Extra one-way path of a normal crossing, (sqrt(eps) - 1) thickness [m]."""
        return (float(np.sqrt(self.permittivity)) - 1.0) * self.thickness_m


def require_outermost_first(walls: Sequence[Wall]) -> None:
    """Raise ValueError where a wall is larger than the one before it: it cannot lie inside."""
    for outer, inner in pairwise(walls):
        if any(b > a for a, b in zip(outer.size_m, inner.size_m, strict=True)):
            msg = f"walls must be nested, outermost first, got {inner.size_m} after {outer.size_m}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True, eq=False)
class RawPose:
    """One scan plane as an importer reads it: its samples may be the converter's integers."""

    signal: Samples
    """Raw ADC samples, of integers I and Q apart."""
    tx_positions: Floats
    """Transmitter of each antenna, (n_antennas, 3) [m]."""
    rx_positions: Floats
    """Receiver of each antenna, (n_antennas, 3) [m]."""
    axes: Floats
    """Rows: looking direction, horizontal, vertical unit vectors in the frame, (3, 3)."""
    name: str = ""
    """Where it came from, e.g. the frame folder."""
    angle_deg: float | None = None
    """Turntable angle, if known [degrees]."""

    def __post_init__(self) -> None:
        parts = (2,) if self.signal.dtype == np.int16 else ()
        require_shape("signal", self.signal, (None, None, *parts))
        require_shape("tx_positions", self.tx_positions, (self.n_antennas, 3))
        require_shape("rx_positions", self.rx_positions, (self.n_antennas, 3))
        require_shape("axes", self.axes, (3, 3))

    @property
    def n_antennas(self) -> int:
        """Number of antennas."""
        return int(self.signal.shape[0])

    @property
    def phase_centers(self) -> Floats:
        """Midpoint of transmitter and receiver, (n_antennas, 3) [m]."""
        return np.asarray(0.5 * (self.tx_positions + self.rx_positions))


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose(RawPose):
    """One scan plane: every antenna (one tx/rx pair at one position) with its samples.

    Raises
    ------
    ValueError
        If shapes do not go together.

    Examples
    --------
    >>> position = np.array([[-0.4, 0.0, 0.0], [-0.4, 0.003, 0.0]])  # of two antennas [m]
    >>> pose = geraf2.Pose(signal=np.zeros((2, 32), np.complex64), tx_positions=position,
    ...                    rx_positions=position, axes=np.eye(3))
    >>> pose.phase_centers.shape
    (2, 3)
    """

    signal: NDArray[np.complex64]
    """Raw ADC samples, (n_antennas, n_samples)."""

    def __post_init__(self) -> None:
        require_shape("signal", self.signal, (None, None))
        super().__post_init__()

    def select(self, antennas: Ints) -> "Pose":
        """Select antennas by their indices, (n,)."""
        return replace(
            self,
            signal=self.signal[antennas],
            tx_positions=self.tx_positions[antennas],
            rx_positions=self.rx_positions[antennas],
        )

    def moved(self, shift_m: Floats) -> "Pose":
        """Move antennas by one displacement, (3,) [m], or by their own, (n_antennas, 3) [m]."""
        tx, rx = self.tx_positions + shift_m, self.rx_positions + shift_m
        return replace(self, tx_positions=tx, rx_positions=rx)
