"""Decision between real and complex samples of a recording.

A reading of the words is the better, the fewer lines its spectra have: the mean logarithm of the
power falls where the power is concentrated. An echo is one line for each receiver in the right
reading. Real words read as complex have two, or one for each of many receivers; complex words read
as real have two. The side of a complex spectrum without echoes counts as flat noise.

Without noise leakage hides the lines, and a linear prediction decides: a line takes one complex
weight, or two real ones. Readings are compared at equal numbers of weights.
"""

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from geraf2._types import Complexes, Floats, Words
from geraf2.apps.importers._word_order import SIGN_BIT, WordOrder, channels, prediction_error

_N_WORDS = 1 << 18
# Words of a segment. The one whose best spectra are most concentrated fits the chirps best.
_SEGMENTS = (64, 128, 256, 512, 1024)
_MIN_PER_CHANNEL = 64
# Bins at zero and at half the sample rate, over which the Hann window spreads what is there.
_GUARD_BINS = 2
# This part of the spectrum beside zero, on either side, belongs to what the transmitter couples
# into the receivers.
_COUPLING_PART = 16
# Least share of the best reading's distance from white noise at which receivers alternate: 33 of
# 122 recordings of alternating receivers reach it, and 7 of 122 of sequential ones. Chirps of a
# known length correct this choice.
_SAME_SHARE = 0.97
# From this ratio of the energies of the sides on, leakage of strong echoes decides the weaker one.
_LEAKING = 30.0
# Share of segments below the power taken, whose ratio to the mean is that of white noise.
_QUANTILE = 0.25
# Power of rounding to integers, below which nothing counts.
_ROUNDING = 1.0 / 12.0

_N_WEIGHTS = (2, 4, 8, 16)
_N_PREDICTED = 1 << 16
_N_ALTERNATING = (1, 2, 4)
# Words that a sample of all receivers may have: each has an offset of its own.
_OFFSET_WORDS = 16
# The lowest residuals are compared: the others lie where a chirp begins. Their mean over that of
# all, for real and complex noise.
_USED = 0.7
_MEAN_REAL, _MEAN_COMPLEX = 0.310, 0.485
# Mean logarithm of the ratio of residuals: below -1.2 on the recordings of real samples at hand,
# and above -.13 on 130 recordings of complex ones and three of real boards.
_MIN_GAIN = -0.15


def real_advantage(
    words: Words, complex_orders: Iterable[WordOrder], real_orders: Iterable[WordOrder]
) -> tuple[WordOrder, float]:
    """Best of the real orders, and by how much it beats every complex one (negative: not at all).

    The advantage is a mean logarithm over all segments, receivers and bins.
    """
    complex_orders, real_orders = list(complex_orders), list(real_orders)
    offsets = {order.offset_binary for order in real_orders}
    some = words[:_N_WORDS]
    powers = {key: float((some ^ SIGN_BIT if key else some).var()) for key in offsets}
    offset = min(powers, key=lambda key: powers[key])
    real_orders = [order for order in real_orders if order.offset_binary == offset]
    complex_orders = [order for order in complex_orders if order.offset_binary == offset]
    found = []
    for length in _SEGMENTS:
        of_real = _levels(some, real_orders, length, _real_level)
        of_complex = _levels(some, complex_orders, length, _complex_level)
        if of_real:
            best, other = min(of_real.values()), min(of_complex.values(), default=np.inf)
            found.append((min(best, other), length, other - best))
    _, length, advantage = min(found)
    levels = _levels(some, real_orders, length, partial(_real_level, with_coupling=True))
    white = float(np.log(powers[offset] + _ROUNDING))
    # The best order, or the one with most alternating receivers that is nearly as good.
    lowest = min(levels, key=lambda order: levels[order])
    enough = white - _SAME_SHARE * (white - levels[lowest])
    good = [order for order in levels if levels[order] <= enough and not order.is_sequential]
    return max(good, key=lambda order: order.n_rx, default=lowest), advantage


def _levels(
    words: Words, orders: Iterable[WordOrder], length: int, level: Callable[[Floats], float]
) -> dict[WordOrder, float]:
    """Mean logarithm of the power for each order whose channels have enough words."""
    found = {}
    for order in orders:
        streams = channels(words, order)
        per_channel = length // len(streams)
        if per_channel >= _MIN_PER_CHANNEL and words.size >= length:
            found[order] = level(_power(streams, per_channel // (1 if order.is_real else 2)))
    return found


def _power(streams: Complexes, length: int) -> Floats:
    """Power in each bin, (n_channels, length): that of the quarter of segments without jumps."""
    n_segments = streams.shape[1] // length
    segments = streams[:, : n_segments * length].reshape(len(streams), n_segments, length)
    window = np.hanning(length + 1)[:length].astype(np.float32)
    segments = (segments - segments.mean(axis=2, keepdims=True)) * window
    power = np.square(np.abs(np.fft.fft(segments, axis=2)))
    rank = int(_QUANTILE * n_segments)
    lowest = np.partition(power, rank, axis=1)[:, rank].astype(np.float64)
    return np.asarray(lowest / (-np.log1p(-_QUANTILE) * np.square(window).sum()))


def _real_level(power: Floats, *, with_coupling: bool = False) -> float:
    """Level, without the bins of the coupling, which are others where receivers alternate."""
    first = _GUARD_BINS + (0 if with_coupling else power.shape[1] // (2 * _COUPLING_PART))
    half = power[:, first : power.shape[1] // 2 - _GUARD_BINS + 1]
    return float(np.log(half + _ROUNDING).mean())


def _complex_level(power: Floats) -> float:
    power = 0.5 * power + _ROUNDING
    half = power.shape[1] // 2
    first = _GUARD_BINS + half * 2 // _COUPLING_PART
    sides = power[:, first:half], power[:, half + 1 : 1 - first]
    lines = [float(np.log(side).mean()) for side in sides]
    energy = [float(side.sum()) for side in sides]
    if max(energy) >= _LEAKING * min(energy):
        return 0.5 * sum(lines)
    noise = [float(np.log(side.mean(axis=1)).mean()) for side in sides]
    return 0.5 * min(lines[0] + noise[1], lines[1] + noise[0])


def is_predicted_as_real(words: Words, order: WordOrder) -> bool:
    """Whether words are predicted better as real samples than in this order."""
    some = words[: min(_N_PREDICTED, len(words) // _OFFSET_WORDS * _OFFSET_WORDS)]
    as_complex = _residuals(channels(some, order), 0.5, _MEAN_COMPLEX)
    signed = (some ^ SIGN_BIT if order.offset_binary else some).astype(np.float32)
    signed = signed.reshape(-1, _OFFSET_WORDS)
    centred = (signed - signed.mean(axis=0)).astype(np.complex64)
    as_real = min(
        (_residuals(centred.reshape(-1, n).T, 1.0, _MEAN_REAL) for n in _N_ALTERNATING),
        key=lambda residuals: float(residuals.mean()),
    )
    return float((as_real - as_complex).mean()) < _MIN_GAIN


def _residuals(streams: Complexes, per_weight: float, usual: float) -> Floats:
    """Logarithm of the residual over the power, for each number of real weights."""
    centred = streams - streams.mean(axis=1, keepdims=True)
    power = (np.abs(centred) ** 2).mean(axis=1, dtype=np.float64)
    alive = power > 0
    found = []
    for n_weights in _N_WEIGHTS:
        error = prediction_error(centred[alive], int(per_weight * n_weights))
        ratio = np.sort((np.abs(error).astype(np.float64) ** 2 / power[alive, None]).ravel())
        lowest = float(ratio[: max(1, int(_USED * ratio.size))].mean())
        found.append(np.log10(max(lowest / usual, 1e-12)))
    return np.array(found)
