"""Values of a radar configuration of TI's software, and their checks.

Transmitters that take turns have a chirp each. Transmitters that send together are separated by
their signs: of two, the second is turned by 180 degrees in every other chirp (BPM), so that
A = (c0 + c1) / 2 and B = (c0 - c1) / 2. In general a loop of chirps is the code matrix times the
signals of the transmitters, and its inverse separates them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError

GIVE = "give the parameters in --radar"
# Least singular value over the largest: below it noise is amplified more than ten times.
_MIN_SINGULAR = 0.1

Chirps = Sequence[tuple[int, int, int]]
"""First and last index of chirps, and the mask of their transmitters or of those turned."""


@dataclass(frozen=True)
class Transmitters:
    """Masks of the chirps of a loop, bit k for transmitter k, and the masks of turned ones."""

    masks: tuple[int, ...]
    turned: tuple[int, ...]

    @property
    def n_chirps(self) -> int:
        """Chirps of a loop."""
        return len(self.masks)

    @property
    def take_turns(self) -> bool:
        """Whether each chirp has a single transmitter."""
        return all(mask.bit_count() == 1 for mask in self.masks)

    @property
    def together(self) -> tuple[int, ...]:
        """Transmitters in the order of their first chirp, the lowest of a chirp first."""
        bits = [k for mask in self.masks for k in range(mask.bit_length()) if mask >> k & 1]
        return tuple(dict.fromkeys(bits))

    @cached_property
    def decoder(self) -> Floats | None:
        """Matrix that separates transmitters that send together, or None; (n_tx, n_chirps)."""
        code = np.array(
            [
                [(mask >> k & 1) * (1 - 2 * (turned >> k & 1)) for k in self.together]
                for mask, turned in zip(self.masks, self.turned, strict=True)
            ],
            dtype=np.float64,
        )
        if code.ndim != 2 or code.shape[0] != code.shape[1]:
            return None
        singular = np.linalg.svd(code, compute_uv=False)
        if singular[-1] < _MIN_SINGULAR * singular[0]:
            return None
        return np.asarray(np.linalg.inv(code), dtype=np.float64)

    def __str__(self) -> str:
        text = f"mask{'s' * (self.n_chirps > 1)} {', '.join(map(str, self.masks))}"
        if self.take_turns:
            return f"{text}, chirp by chirp"
        if self.decoder is None:
            return f"{text}: several send together, and no code separates them"
        order = ", ".join(map(str, self.together))
        return f"{text}: several send together, separated by their signs, in the order {order}"


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
    n_chirps_per_loop: int | None = None
    """Chirps that differ, where their transmitters may be unknown."""
    n_chirps_per_frame: int | None = None
    n_frames: int | None = None
    """Frames to record; None also for recordings of unlimited length."""
    frame_period_s: float | None = None
    path_bias_m: float | None = None
    """Instrument delay on the two-way path; None also where it is stated as 0."""
    channel_gains: tuple[complex, ...] | None = None
    """Factor of each channel of a loop, receivers fastest: some boards have turned antennas."""
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


def to_number(value: Any, name: str, where: object) -> float:
    """Finite number from JSON or text, hexadecimal too; UserError names its key."""
    number = math.nan
    try:
        if isinstance(value, str) and value.strip().lower().startswith("0x"):
            number = float(int(value, 16))
        elif isinstance(value, (int, float, str)) and not isinstance(value, bool):
            number = float(value)
    except (ValueError, OverflowError):
        pass
    if not math.isfinite(number):
        what = f"{name!r} must be a number"
        raise UserError(what=what, where=where, got=repr(value)[:60])
    return number


def require_count(name: str, got: int, least: int, most: int, where: object) -> None:
    """UserError where a line or a call has too few or too many values."""
    if not least <= got <= most:
        few = got < least
        raise UserError(
            what=f"{name} has too {'few' if few else 'many'} values",
            where=where,
            expected=f"{least} or more" if few else f"{most} or fewer",
            got=got,
            hint=None if few else f"other chips have other values: {GIVE}",
        )


def profile_values(
    values: Sequence[float],
    at: Sequence[int] = range(5),
    units: tuple[float, float, float] = (1e9, 1e-6, 1e12),
) -> dict[str, Any]:
    """Chirp in SI units.

    at: indices of start, ADC start, slope, number of samples, rate [kHz].
    units: of the first three; by default GHz, us and MHz/us.
    """
    start, adc_start, slope, n_samples, rate_khz = (values[index] for index in at)
    return {
        "ramp_start_hz": units[0] * start,
        "adc_start_s": units[1] * adc_start,
        "chirp_slope_hz_per_s": units[2] * slope,
        "n_samples": int(n_samples),
        "sample_rate_hz": 1e3 * rate_khz,
    }


def bpm_mask(code: float) -> int:
    """Mask of the transmitters that a BPM code (bits 2 k and 2 k + 1: off, on) turns while on."""
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


def transmitters_of(
    chirps: Chirps, first: int, last: int, path: Path, turned: Chirps = ()
) -> Transmitters | None:
    """Transmitters of the chirps of a frame, over the shortest period; None where not all known."""
    if last < first:
        raise UserError(what="chirpEndIdx of the frame lies before chirpStartIdx", where=path)
    pairs = [(_mask_of(chirps, k), _mask_of(turned, k) or 0) for k in range(first, last + 1)]
    masks = [mask for mask, _ in pairs if mask is not None]
    if len(masks) < len(pairs):
        return None
    if not all(masks):
        raise UserError(
            what=f"chirp {first + masks.index(0)} has no transmitter",
            where=path,
            expected="a mask of one or more",
        )
    n = len(pairs)
    period = next(p for p in range(1, n + 1) if n % p == 0 and pairs == pairs[:p] * (n // p))
    return Transmitters(tuple(masks[:period]), tuple(code for _, code in pairs[:period]))


def _mask_of(chirps: Chirps, index: int) -> int | None:
    return next((mask for start, end, mask in chirps if start <= index <= end), None)
