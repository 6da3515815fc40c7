"""Instrument delay from a reflector at a known position."""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.scene import Capture

# Least power of the reflector over the median of all delays searched; noise alone reaches 3.
_MIN_CONTRAST = 6.0


@dataclass(frozen=True, kw_only=True, eq=False)
class DelayCurve:
    """Quality of each delay of a search, and the best delay."""

    delay_m: float
    """Change of the instrument delay, two-way path [m]."""
    sigma_m: float
    candidates_m: Floats
    """Changes tried, (n,) [m]."""
    quality: Floats
    """Power at the reflector relative to its median, (n,)."""


def delay_from_reflector(
    capture: Capture, position_m: Floats, search_m: tuple[float, float]
) -> DelayCurve:
    """Delay at which the echo focused on a known position is strongest.

    The signals of each pose are focused on the position, so that the power depends only on the
    delay. Powers of the poses are added.

    position_m: of a small reflector (a corner, the surface of a small sphere), (3,) [m].
    search_m: smallest and largest change of the delay, two-way path [m].

    Raises UserError if no delay is clearly stronger than the others.
    """
    waveform = capture.waveform
    step = SPEED_OF_LIGHT_M_PER_S / waveform.bandwidth_hz / 40.0
    candidates = np.arange(search_m[0], search_m[1] + step, step)
    frequencies = waveform.frequencies_hz
    phase_per_hz_m = 2j * np.pi / SPEED_OF_LIGHT_M_PER_S
    window = np.hanning(waveform.n_samples + 2)[1:-1]
    steering = np.exp(phase_per_hz_m * np.outer(candidates, frequencies)) * window
    powers = []
    for pose in capture.poses:
        if pose.n_antennas == 0:
            continue
        path = np.linalg.norm(position_m - pose.tx_positions, axis=1)
        path += np.linalg.norm(position_m - pose.rx_positions, axis=1) + waveform.path_bias_m
        focused = (pose.signal * np.exp(phase_per_hz_m * np.outer(path, frequencies))).sum(axis=0)
        powers.append(np.abs(steering @ focused) ** 2)
    if not powers:
        raise UserError(what="no plane has antennas")
    total = np.sum(powers, axis=0)
    quality = total / max(float(np.median(total)), 1e-300)
    best = int(total.argmax())
    # Strong echoes from other positions have different delays in each pose.
    tops = np.array([(candidates[int(p.argmax())], p.max()) for p in powers])
    deviation = float(
        np.average(np.abs(tops[:, 0] - candidates[best]), weights=tops[:, 1] + 1e-300)
    )
    alone = deviation < 20.0 * step  # half a range cell
    if quality[best] < _MIN_CONTRAST or not alone or best in (0, len(total) - 1):
        raise UserError(
            what="the reflector does not stand out",
            expected=f"a power of at least {_MIN_CONTRAST:g} times the median of delays between "
            f"{search_m[0]:g} and {search_m[1]:g} m",
            got=f"{quality[best]:.3g} times at {candidates[best]:g} m, and planes that are "
            f"{1e3 * deviation:.0f} mm off on average",
            hint="check --reflector X Y Z [m] and --delay-search",
        )
    refined = candidates[best] + step * _parabola(np.log(total), best)
    # Poses differ by other echoes in the reflector's range cell.
    around = slice(max(0, best - 20), best + 21)
    own = [candidates[around][int(p[around].argmax())] for p in powers]
    spread = float(np.std(own)) / np.sqrt(len(own)) if len(own) > 1 else 0.0
    return DelayCurve(
        delay_m=float(refined),
        sigma_m=float(np.hypot(spread, step)),
        candidates_m=candidates,
        quality=quality,
    )


def _parabola(values: Floats, best: int) -> float:
    """Maximum of the parabola through three samples, in steps from the middle one."""
    left, middle, right = values[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0 else 0.0
