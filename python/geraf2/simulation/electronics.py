"""Errors of the receiver: leakage, gains and phases, I and Q imbalance, rounding."""

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.scene import Waveform
from geraf2.simulation.streams import stream
from geraf2.simulation.world import WorldSpec

Signals = list[NDArray[np.complex64]]
_Complex = NDArray[np.complex128]

# Leakage also takes paths via the housing: longer by at most this, and weaker.
_N_NEAR_PATHS, _NEAR_PATH_M, _NEAR_AMPLITUDE = 3, 0.08, 0.2
# Periods of the ripple over the chirp: a filter's and a mismatched line's, not the echoes'.
_N_RIPPLES = 4


def leakage(world: WorldSpec, waveform: Waveform, apart_m: Floats, seed: int) -> _Complex:
    """Direct leakage between transmitter and receiver.

    A direct path of length `apart_m` and three weaker ones up to 8 cm longer, by the housing, with
    one random common phase; the same in each plane.

    world: its `leakage_db` is the mean power over the samples, one being that of all echoes.
    waveform: the chirp.
    apart_m: distance of transmitter and receiver, (n_antennas,) [m].
    seed: of paths and phases.

    Returns (n_antennas, n_samples).
    """
    rng = stream(seed, "leakage")
    longer = np.concatenate([[0.0], rng.uniform(0.0, _NEAR_PATH_M, _N_NEAR_PATHS)])
    amplitudes = np.ones(1 + _N_NEAR_PATHS, np.complex128)
    parts = rng.normal(size=(2, _N_NEAR_PATHS)) / np.sqrt(2.0)
    amplitudes[1:] = _NEAR_AMPLITUDE * (parts[0] + 1j * parts[1])
    amplitudes *= np.exp(2j * np.pi * rng.uniform())
    paths = apart_m[:, None] + longer + waveform.path_bias_m
    turns = paths[:, :, None] * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    signal = np.einsum("p,apf->af", amplitudes, np.exp(-2j * np.pi * turns))
    level = 10.0 ** (world.leakage_db / 20.0)
    return np.asarray(level * signal / np.sqrt(np.mean(np.abs(signal) ** 2)))


def receiver_gains(
    world: WorldSpec, shape: tuple[int, int], seed: int, number: int
) -> _Complex | None:
    """Complex gain of each sample of one plane, but for the phases of its channels.

    Channels' gains, a phase that walks along the antennas, a phase of the plane, and a ripple over
    the chirp: 1 + r sum_k c_k exp(j 2 pi k t / T), of rms r.

    world: which effects are on.
    shape: antennas and samples.
    seed: of all draws.
    number: of the plane.

    Returns gains that broadcast to `shape`; None where all are one.
    """
    n_antennas, n_samples = shape
    gains: list[_Complex] = []
    if world.channel_gain_rms_db:
        db = world.channel_gain_rms_db * stream(seed, "channel_gains").normal(size=world.n_channels)
        own = 10.0 ** (db[np.arange(n_antennas) % world.n_channels, None] / 20.0)
        gains.append(own.astype(np.complex128))
    if world.phase_walk_deg:
        steps = stream(seed, "walk", number).normal(size=n_antennas)
        rate = np.deg2rad(world.phase_walk_deg) / np.sqrt(max(1, n_antennas - 1))
        gains.append(np.exp(1j * rate * (np.cumsum(steps) - steps[0]))[:, None])
    if world.random_plane_phase:
        gains.append(np.exp(2j * np.pi * stream(seed, "plane_phase", number).uniform(size=(1, 1))))
    if world.ripple_rms:
        parts = stream(seed, "ripple").normal(size=(2, 2 * _N_RIPPLES))
        weights = parts[0] + 1j * parts[1]
        weights *= world.ripple_rms / np.linalg.norm(weights)
        periods = np.delete(np.arange(-_N_RIPPLES, _N_RIPPLES + 1), _N_RIPPLES)
        waves = np.exp(2j * np.pi * np.outer(periods, np.arange(n_samples) / n_samples))
        gains.append(1.0 + (weights @ waves)[None])
    return reduce(np.multiply, gains) if gains else None


def convert(world: WorldSpec, signals: Signals, seed: int) -> Signals:
    """Apply the errors of I and Q and of the converter to samples.

    I' = I, Q' = (1 + g) (Q cos(a) + I sin(a)); then a constant offset; then both are rounded, and
    cut off at full scale.

    world: g, a, the offset's power where one is the echoes', bits and clipping.
    signals: of each plane, (n_antennas, n_samples).
    seed: of the offset's phase.
    """
    if world.iq_gain_error or world.iq_phase_error_deg:
        angle, gain = np.deg2rad(world.iq_phase_error_deg), np.float32(1.0 + world.iq_gain_error)
        cos, sin = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        signals = [
            (s.real + 1j * gain * (s.imag * cos + s.real * sin)).astype(np.complex64)
            for s in signals
        ]
    if world.dc_db > -np.inf:
        phase = 2.0 * np.pi * stream(seed, "dc").uniform()
        offset = np.complex64(10.0 ** (world.dc_db / 20.0) * np.exp(1j * phase))
        signals = [signal + offset for signal in signals]
    if not world.converter_bits:
        return signals
    largest = 2.0 ** (world.converter_bits - 1) - 1.0
    parts = [np.ascontiguousarray(signal).view(np.float32) for signal in signals]
    peak = max(float(np.abs(part).max()) for part in parts)
    step = np.float32(peak * 10.0 ** (-world.clip_db / 20.0) / largest)
    if not step > 0:
        return signals  # silence
    codes = (np.clip(np.rint(part / step), -largest, largest) for part in parts)
    return [np.asarray(code * step, np.float32).view(np.complex64) for code in codes]


def amplify(world: WorldSpec, signals: Sequence[NDArray[np.complex64]], seed: int) -> Signals:
    """Multiply the samples of all planes by :func:`receiver_gains`."""
    out = []
    for number, signal in enumerate(signals):
        gains = receiver_gains(world, (signal.shape[0], signal.shape[1]), seed, number)
        out.append(signal if gains is None else (signal * gains).astype(np.complex64))
    return out
