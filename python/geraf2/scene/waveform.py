"""The FMCW chirp as the receiver samples it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._validation import require_finite, require_positive
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S


@dataclass(frozen=True, kw_only=True)
class Waveform:
    """A linear chirp; the signal of one path of length d is exp(-j 2 pi (nu + k t) d / c)."""

    start_frequency_hz: float
    """Frequency nu at the first ADC sample [Hz]."""
    chirp_slope_hz_per_s: float
    """Slope k [Hz/s]."""
    sample_rate_hz: float
    """Complex ADC samples per second [Hz]."""
    n_samples: int
    """ADC samples per chirp."""
    path_bias_m: float = 0.0
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
    def frequencies_hz(self) -> NDArray[np.float64]:
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
