"""Values of a radar configuration of TI's software, and their checks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geraf2.apps.importers._transmitters import Transmitters
from geraf2.errors import UserError

TYPED = (1e9, 1e-6, 1e12)
"""Units of typed values: start [GHz], ADC start [us] and slope [MHz/us]."""


@dataclass(frozen=True, kw_only=True)
class TiConfig:
    """Values of a configuration file; None where it has none."""

    ramp_start_hz: float | None = None
    adc_start_s: float | None = None
    chirp_slope_hz_per_s: float | None = None
    sample_rate_hz: float | None = None
    n_samples: int | None = None
    n_rx: int | None = None
    transmitters: Transmitters | None = None
    """Transmitters of each chirp of a loop."""
    n_chirps_per_frame: int | None = None
    n_frames: int | None = None
    """Frames to record; None also for recordings of unlimited length."""
    frame_period_s: float | None = None
    n_lanes: int | None = None
    is_real: bool | None = None
    """Whether samples are real, without Q."""
    interleaved: bool | None = None
    """Whether receivers alternate from sample to sample."""

    def first_sample_hz(self) -> float | None:
        """Frequency of the first sample: start + slope x ADC start."""
        if self.ramp_start_hz is None or self.chirp_slope_hz_per_s is None:
            return None
        return self.ramp_start_hz + self.chirp_slope_hz_per_s * (self.adc_start_s or 0.0)


def to_number(value: Any, name: str, path: Path) -> float:
    """Finite number from JSON or text, hexadecimal too; UserError names its key."""
    try:
        if isinstance(value, str) and value.strip().lower().startswith("0x"):
            return float(int(value, 16))
        if isinstance(value, (int, float, str)) and not isinstance(value, bool):
            number = float(value)
            if math.isfinite(number):
                return number
    except (ValueError, OverflowError):
        pass
    raise UserError(what=f"{name!r} must be a number", where=path, got=repr(value)[:60])


def profile_values(
    values: Sequence[float], at: Sequence[int], units: tuple[float, float, float]
) -> dict[str, Any]:
    """Chirp in SI units; `at` are indices of start, ADC start, slope, samples and rate [kHz].

    units: of start [Hz], ADC start [s] and slope [Hz/s].
    """
    start, adc_start, slope, n_samples, rate_khz = (values[index] for index in at)
    return {
        "ramp_start_hz": units[0] * start,
        "adc_start_s": units[1] * adc_start,
        "chirp_slope_hz_per_s": units[2] * slope,
        "n_samples": int(n_samples),
        "sample_rate_hz": 1e3 * rate_khz,
    }


def ones(mask: float) -> int:
    """Count the bits of a mask."""
    return int(mask).bit_count()


def bpm_mask(code: float) -> int:
    """Mask of the transmitters that a BPM code turns by 180 degrees while they are on.

    Bits 2 k and 2 k + 1 of the code are of transmitter k, off and on.
    """
    return sum(1 << k for k in range(int(code).bit_length()) if int(code) >> 2 * k + 1 & 1)


def is_real_16(bits: float, output: float, path: Path) -> bool:
    """Whether codes mean real samples and not complex ones; UserError unless they have 16 bits."""
    if bits != 2:
        raise UserError(what="samples are not of 16 bits", where=path, expected=2, got=int(bits))
    if output not in (0, 1, 2):
        raise UserError(
            what="samples are neither real nor complex",
            where=path,
            expected="output format 0 (real), 1 or 2 (complex)",
            got=f"{output:g}",
        )
    return output == 0
