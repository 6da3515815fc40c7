"""Offset between the clocks of radar and arm, from sweeps in opposite directions.

With an offset tau the recorded positions of a sweep at velocity v are wrong by v tau. Neighbouring
lines that run in opposite directions then see the same echoes 2 v tau apart. The spectra S of three
such lines along their direction, at each range r, agree at the true offset:

    J(tau) = sum over triples of |sum over kappa, r of conj(S_1 S_3) U_2^2 exp(j kappa dv tau)|

with dv = 2 v_2 - v_1 - v_3 and U_2 = S_2 / |S_2|. A surface moves its echoes from line to line;
the third line removes what is linear of it, and the magnitude a phase that lines differ by. Sweeps
in one direction determine nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats

Motion = Callable[[Floats], Floats]
"""Positions (n, 3) [m] at times (n,) [s]."""
MAX_OFFSET_S = 0.15
"""Largest offset that is searched [s]."""
_STEP_S, _N_FINE = 5e-4, 8
_N_ROUNDS = 3
# Steps of the positions: 2.5 mm at .1 m/s, more than the noise of an arm.
_POSITION_STEP_S = 0.025
# A sweep moves at this share of the speed of fast motion or more, within 11 degrees of one
# direction, and is this share of the longest one long.
_FAST, _MIN_SPEED, _MIN_COSINE, _MIN_LENGTH = 0.75, 0.3, 0.98, 0.3
_MIN_FRAMES, _MIN_TRIPLES = 16, 4
# Echoes beyond 60 degrees of the normal are weak, and alias first.
_MAX_SINE = 0.87
# Ranges with the most power; further ones are noise.
_N_RANGES = 24
# Shift of a scene's echoes between lines 2 mm apart that is not linear: .15 ms at .1 m/s.
_SCENE_M = 1.5e-5
# Least ratio of the highest likelihood to the median, less 1, times the root of the number of
# triples: noise alone reaches 2.
_MIN_CONTRAST = 3.0


@dataclass(frozen=True, kw_only=True)
class ClockOffset:
    """Offset by which the radar's time stamps are late on the clock of the positions."""

    offset_s: float
    sigma_s: float
    """One standard deviation [s]; infinite where the scan does not determine the offset."""
    n_lines: int
    """Lines that alternate in direction."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """Samples around one straight line."""

    interval_s: tuple[float, float]
    """Begin and end of the line on the clock of the positions [s]."""
    times_s: Floats
    """Of the frames on the clock of the radar, (n,) [s]."""
    signal: NDArray[np.complexfloating]
    """(n, n_channels, n_samples)."""


def straight_lines(span_s: tuple[float, float], positions_at: Motion) -> list[tuple[float, float]]:
    """Begin and end of each straight line of a motion [s].

    span_s: begin and end of the motion [s].
    """
    times = np.linspace(*span_s, max(3, int((span_s[1] - span_s[0]) / _POSITION_STEP_S)))
    positions = positions_at(times)
    steps = np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    directions = steps / np.maximum(lengths, 1e-300)[:, None]
    moves = lengths > _MIN_SPEED * np.quantile(lengths, _FAST)
    found, begin = [], 0
    for k in range(1, len(steps) + 1):
        is_on = k < len(steps) and moves[k] and directions[k] @ directions[begin] > _MIN_COSINE
        if moves[begin] and is_on:
            continue
        if moves[begin]:
            found.append((begin, k))
        begin = k
    reach = [float(np.linalg.norm(positions[b] - positions[a])) for a, b in found]
    return [
        (float(times[a]), float(times[b]))
        for (a, b), length in zip(found, reach, strict=True)
        if length >= _MIN_LENGTH * max(reach)
    ]


def find_clock_offset(
    sweeps: Sequence[Sweep], positions_at: Motion, wavelength_m: float
) -> ClockOffset:
    """Offset of the radar's clock, and its standard deviation.

    sweeps: in order of time.
    """
    sweeps = _with_ranges(sweeps)
    offset, sigma, contrast, n = 0.0, np.inf, np.inf, 0
    steps = np.arange(-MAX_OFFSET_S, MAX_OFFSET_S + 0.5 * _STEP_S, _STEP_S)
    for number in range(_N_ROUNDS):
        candidates = zip(sweeps, sweeps[1:], sweeps[2:], strict=False)
        found = [_triple(lines, offset, positions_at, wavelength_m) for lines in candidates]
        triples = [triple for triple in found if triple is not None]
        n = len(triples)
        if n < _MIN_TRIPLES:
            return ClockOffset(offset_s=0.0, sigma_s=np.inf, n_lines=0)
        change, sigma, peak = _best_step(triples, steps)
        contrast = peak if number == 0 else contrast
        offset = float(np.clip(offset + change, -MAX_OFFSET_S, MAX_OFFSET_S))
        steps = np.linspace(-_N_FINE, _N_FINE, 4 * _N_FINE + 1) * _STEP_S
    is_found = abs(offset) < MAX_OFFSET_S and (contrast - 1) * np.sqrt(n) > _MIN_CONTRAST
    return ClockOffset(offset_s=offset, sigma_s=sigma if is_found else np.inf, n_lines=n + 2)


def _with_ranges(sweeps: Sequence[Sweep]) -> list[Sweep]:
    """Sweeps with the strongest ranges as samples, less the mean of all frames."""
    if not sweeps:
        return []
    mean = np.sum([sweep.signal.sum(axis=0) for sweep in sweeps], axis=0)
    mean /= max(1, sum(len(sweep.signal) for sweep in sweeps))
    window = np.hanning(mean.shape[-1] + 2)[1:-1]
    profiles = [np.fft.fft((sweep.signal - mean) * window, axis=-1) for sweep in sweeps]
    power = np.sum([(np.abs(profile) ** 2).sum(axis=(0, 1)) for profile in profiles], axis=0)
    kept = np.argsort(-power)[:_N_RANGES]
    return [
        replace(sweep, signal=profile[..., kept].reshape(len(profile), -1))
        for sweep, profile in zip(sweeps, profiles, strict=True)
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Triple:
    """Product of the spectra of three lines that alternate in direction."""

    product: NDArray[np.complexfloating]
    """Sum over ranges, (n_wavenumbers,)."""
    rates: Floats
    """Change of its phase with the offset, (n_wavenumbers,) [rad/s]."""
    speed: float
    """Mean speed of the lines [m/s]."""

    def likelihood(self, steps_s: Floats) -> tuple[Floats, Floats]:
        """Magnitude of the sum at steps (n,) [s], and its derivative [1/s]."""
        phasors = np.exp(1j * self.rates[:, None] * steps_s)
        total, slope = self.product @ phasors, (1j * self.rates * self.product) @ phasors
        size = np.maximum(np.abs(total), 1e-300)
        return size, (np.conj(total) * slope).real / size


def _triple(
    sweeps: Sequence[Sweep], offset_s: float, positions_at: Motion, wavelength_m: float
) -> _Triple | None:
    """Product of three sweeps; None where they do not alternate in direction."""
    ends = np.array([positions_at(np.array(sweep.interval_s)) for sweep in sweeps])
    moved = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(moved, axis=1)
    units = moved / lengths[:, None]
    if max(units[0] @ units[1], units[1] @ units[2]) > -_MIN_COSINE:
        return None
    direction = units[1] - 0.5 * (units[0] + units[2])
    direction /= np.linalg.norm(direction)
    frames = []
    for sweep in sweeps:
        times = sweep.times_s - offset_s
        inside = (times >= sweep.interval_s[0]) & (times <= sweep.interval_s[1])
        if inside.sum() < _MIN_FRAMES:
            return None
        along = (positions_at(times[inside]) - ends.mean(axis=(0, 1))) @ direction
        frames.append((along, np.gradient(along, times[inside]), sweep.signal[inside]))
    span = 1.001 * float(lengths.max())
    spacing = max(float(np.abs(np.diff(along)).mean()) for along, *_ in frames)
    reach = min(4 * np.pi / wavelength_m * _MAX_SINE, np.pi / spacing)
    wavenumbers = np.arange(-reach, reach, 2 * np.pi / (1.1 * span))
    spectra, speeds = [], []
    for along, speed, signal in frames:
        window = np.cos(np.pi * along / span).clip(0.0) ** 2 * np.abs(speed)
        waves = np.exp(-1j * np.outer(wavenumbers, along))
        spectra.append(waves @ (window[:, None] * signal))
        speeds.append(float((window * speed).sum() / window.sum()))
    before, own, after = spectra
    unit = own / np.maximum(np.abs(own), 1e-300)
    product = (np.conj(before * after) * unit**2).sum(axis=1)
    change = 2 * speeds[1] - speeds[0] - speeds[2]
    return _Triple(product=product, rates=wavenumbers * change, speed=0.25 * abs(change))


def _best_step(triples: Sequence[_Triple], steps_s: Floats) -> tuple[float, float, float]:
    """Step of the largest likelihood and its standard deviation [s], and its contrast."""
    found = [triple.likelihood(steps_s) for triple in triples]
    values, slopes = (np.array(part) for part in zip(*found, strict=True))
    k = int(np.clip(values.sum(axis=0).argmax(), 1, len(steps_s) - 2))
    total = values.sum(axis=0)
    contrast = float(total[k] / np.median(total))
    slope = slopes.sum(axis=0)
    curvature = float(slope[k + 1] - slope[k - 1]) / (steps_s[k + 1] - steps_s[k - 1])
    if curvature >= 0:
        return float(steps_s[k]), np.inf, contrast
    spread = float(np.linalg.norm(slopes[:, k] - slopes[:, k].mean()))
    scene_s = _SCENE_M / float(np.mean([triple.speed for triple in triples]))
    sigma = float(np.hypot(spread / -curvature, scene_s))
    return float(steps_s[k] - slope[k] / curvature), sigma, contrast
