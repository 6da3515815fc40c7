import numpy as np
import pytest

from geraf2.scene import Waveform

AWR1843 = Waveform(
    start_frequency_hz=77.3704e9,
    chirp_slope_hz_per_s=70.15e12,
    sample_rate_hz=625e3,
    n_samples=32,
)


def test_frequencies_start_at_the_start_frequency():
    assert AWR1843.frequencies_hz[0] == 77.3704e9
    assert np.allclose(np.diff(AWR1843.frequencies_hz), 70.15e12 / 625e3)


def test_zero_samples_are_rejected():
    with pytest.raises(ValueError, match="n_samples must be at least 1, got 0"):
        Waveform(
            start_frequency_hz=77e9, chirp_slope_hz_per_s=7e13, sample_rate_hz=1e6, n_samples=0
        )
