"""Unknown phases of a radar's channels, estimated from neighbouring antennas.

A wavefront is smooth, but channel phases differ between neighbouring antennas. Each antenna's part
of an echo is compared with the sum of its neighbours. The difference that all antennas of a channel
share is the channel's phase (docs/math/calibration.md#channels).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints
from geraf2.calibration.acceptance import Gain, coherence_nats
from geraf2.echoes.echo_phases import EchoPhases
from geraf2.errors import UserError
from geraf2.scene import Capture, Pose

# Channels are distinguished by the offset from transmitter to receiver. The tolerance is far below
# the distance of two patches and far above the rounding errors of positions.
_OFFSET_TOLERANCE_M = 1.25e-4
_MAX_CHANNELS = 256
_N_NEIGHBORS = 24
_N_ROUNDS = 20
_MIN_SAMPLES = 30
# Least number of echoes, and largest number of channels, of a search for interleaved channels.
_MIN_ECHOES = 8
_MAX_TURNS = 16
# Least growth of the neighbours' agreement, equal to the effect of phases of 3 degrees RMS.
_MIN_TURN_GAIN = 0.002


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelPhases:
    """Phase of each channel, to be removed from the signal."""

    phases_rad: Floats
    """Phases of mean zero, since a common phase has no effect, (n_channels,) [rad]."""
    sigma_rad: Floats
    """Standard deviation, (n_channels,) [rad]."""


def interleaved_channels(pose: Pose, n_channels: int) -> Ints:
    """Channel of each antenna for interleaved channels: antenna i has channel i modulo n."""
    return np.arange(pose.n_antennas, dtype=np.int64) % n_channels


def offset_channels(poses: Sequence[Pose]) -> list[Ints] | None:
    """Channel of each antenna by the offset from its transmitter to its receiver.

    The offsets of a virtual array repeat along the plane. None if they do not, or if all antennas
    have the same offset.
    """
    local = [(p.rx_positions - p.tx_positions) @ p.axes.T for p in poses]
    steps = np.round(np.concatenate(local) / (2.0 * _OFFSET_TOLERANCE_M)).astype(np.int64)
    if len(steps) == 0:
        return None
    # One number per row, of steps below 2^19: np.unique of rows takes 0.6 s for 145,000 antennas.
    kinds, index = np.unique(steps @ [1, 1 << 20, 1 << 40], return_inverse=True)
    if not 1 < len(kinds) <= min(_MAX_CHANNELS, max(1, len(steps) // 16)):
        return None
    bounds = np.cumsum([p.n_antennas for p in poses])[:-1]
    return [part.astype(np.int64) for part in np.split(index.ravel(), bounds)]


def find_turns(echoes: list[EchoPhases]) -> int | None:
    """Find the number of interleaved channels, 2 to 16, with held-out echoes; None if none.

    For each number, every other echo gives the phases of antennas relative to their neighbours. The
    other half gives the growth of the neighbours' agreement by these phases. Multiples of the true
    number explain as much, so the smallest number with nine tenths of the largest growth is used.

    echoes: strong echoes of the capture.
    """
    parts = _antenna_values(echoes)
    antennas, votes, half = [], [], []
    for number, (own, values, neighbors) in enumerate(parts):
        antennas.append(own)
        votes.append(values * np.conj(values[neighbors].sum(axis=1)))
        half.append(np.full(len(own), number % 2 == 1))
    if len(parts) < _MIN_ECHOES:
        return None
    antenna, vote, test = (np.concatenate(column) for column in (antennas, votes, half))
    gains = np.zeros(_MAX_TURNS + 1)
    for n in range(2, _MAX_TURNS + 1):
        cell = test * n + antenna % n
        parts_of_sums = [np.bincount(cell, part, 2 * n) for part in (vote.real, vote.imag)]
        sums = (parts_of_sums[0] + 1j * parts_of_sums[1]).reshape(2, n)
        if (np.abs(sums) == 0.0).any():
            continue
        change = sums[0] / np.abs(sums[0])
        change = change * np.exp(-1j * np.angle(change.mean()))
        gains[n] = float((sums[1] * np.conj(change)).real.sum() - sums[1].real.sum())
    gains /= float(np.abs(vote[test]).sum())
    if gains.max() < _MIN_TURN_GAIN:
        return None
    return int(np.flatnonzero(gains >= 0.9 * gains.max())[0])


def channels_of(poses: Sequence[Pose], n_turns: int) -> list[Ints] | None:
    """Channel of each antenna of each pose: interleaved, or by offsets if `n_turns` is 0."""
    return (
        [interleaved_channels(pose, n_turns) for pose in poses]
        if n_turns
        else offset_channels(poses)
    )


def estimate_channel_phases(echoes: list[EchoPhases], channels: list[Ints]) -> ChannelPhases:
    """Estimate the common phase of each channel relative to neighbouring antennas.

    The estimate alternates between the neighbours' sums, without the current phases, and the
    phases. It converges for standard deviations up to a radian.

    echoes: strong echoes of the capture.
    channels: channel of each antenna of each pose, from 0, [(n_antennas,)].

    Raises UserError if a channel has too few antennas in strong echoes.
    """
    n_channels = 1 + max((int(c.max()) for c in channels if len(c)), default=0)
    parts = _antenna_values(echoes, channels)
    channel = np.concatenate([np.zeros(0, dtype=np.int64), *(part[0] for part in parts)])
    n_samples = np.bincount(channel, minlength=n_channels)
    if n_samples.min() < _MIN_SAMPLES:
        raise UserError(
            what=f"channel {int(n_samples.argmin())} has too few antennas in strong echoes",
            expected=f"at least {_MIN_SAMPLES}",
            got=int(n_samples.min()),
            hint="check --channels, or leave it out",
        )
    phases = np.zeros(n_channels)
    for _ in range(_N_ROUNDS):
        votes = np.zeros(n_channels, dtype=np.complex128)
        for own, values, neighbors in parts:
            corrected = values * np.exp(-1j * phases[own])
            around = corrected[neighbors].sum(axis=1)
            np.add.at(votes, own, corrected * np.conj(around))
        change = np.angle(votes)
        phases = phases + change - change.mean()
        if np.abs(change - change.mean()).max() < 1e-4:
            break
    phases = np.angle(np.exp(1j * (phases - phases.mean())))
    return ChannelPhases(
        phases_rad=phases,
        sigma_rad=_sigma(parts, phases),
    )


def phase_gain(
    echoes: list[EchoPhases], channels: list[Ints], phases_rad: Floats
) -> tuple[Gain, float, float]:
    """Gain of echoes by removing phases that were estimated without them.

    channels: of each antenna of each pose, [(n_antennas,)]. phases_rad: of each channel.

    Returns the gain and the RMS coherence, weighted by power, without and with the phases removed.
    """
    turns = np.exp(-1j * phases_rad)
    coherence = np.zeros((2, len(echoes)))
    for number, echo in enumerate(echoes):
        removed = replace(echo, values=echo.values * turns[channels[echo.pose][echo.antennas]])
        coherence[:, number] = echo.coherence, removed.coherence
    powers = np.array([float(np.abs(echo.values).sum()) ** 2 for echo in echoes])
    before, after = np.sqrt(coherence**2 @ powers / max(float(powers.sum()), 1e-300)).tolist()
    return Gain.of(coherence_nats(coherence[0], coherence[1], powers)), before, after


def with_channel_phases(capture: Capture, channels: list[Ints], phases_rad: Floats) -> Capture:
    """Capture with the channels' phases removed."""
    turns = np.exp(-1j * phases_rad).astype(np.complex64)
    poses = [
        replace(pose, signal=pose.signal * turns[channel][:, None])
        for pose, channel in zip(capture.poses, channels, strict=True)
    ]
    return replace(capture, poses=tuple(poses))


def _antenna_values(
    echoes: list[EchoPhases], channels: list[Ints] | None = None
) -> list[tuple[Ints, NDArray[np.complex128], Ints]]:
    """Channel, value and neighbours of each antenna, values normalised over each echo.

    Without channels, the index of the antenna instead of its channel.
    """
    known: dict[bytes, Ints] = {}  # all sub-apertures of a raster have the same neighbours
    parts = []
    for echo in echoes:
        key = np.rint(echo.offsets_m / _OFFSET_TOLERANCE_M).astype(np.int32).tobytes()
        if key not in known:
            n = min(_N_NEIGHBORS + 1, len(echo.antennas))
            known[key] = KDTree(echo.offsets_m).query(echo.offsets_m, k=n)[1][:, 1:]
        scale = max(float(np.sqrt(np.mean(np.abs(echo.values) ** 2))), 1e-30)
        own = echo.antennas if channels is None else channels[echo.pose][echo.antennas]
        parts.append((own, echo.values / scale, known[key]))
    return parts


def _sigma(parts: list[tuple[Ints, NDArray[np.complex128], Ints]], phases: Floats) -> Floats:
    """Estimate standard deviations from the spread of the single echoes' estimates."""
    each = []
    for own, values, neighbors in parts:
        corrected = values * np.exp(-1j * phases[own])
        votes = np.zeros(len(phases), dtype=np.complex128)
        np.add.at(votes, own, corrected * np.conj(corrected[neighbors].sum(axis=1)))
        each.append(votes)
    votes = np.stack(each)
    total = votes.sum(axis=0)
    across = (votes * np.conj(total / np.maximum(np.abs(total), 1e-30))).imag
    return np.asarray(np.sqrt((across**2).sum(axis=0)) / np.maximum(np.abs(total), 1e-30))
