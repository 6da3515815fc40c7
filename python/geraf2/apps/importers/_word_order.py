"""Orders of the 16-bit words in a raw capture of a TI board, and their decoding."""

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from scipy.fft import ifft, rfft
from scipy.linalg import toeplitz

from geraf2._types import Complexes, Floats, Floats32, Words
from geraf2.io.manifest import ComplexLayout, RealLayout
from geraf2.io.samples import complex_samples

Layout = ComplexLayout | RealLayout
LAYOUTS: tuple[ComplexLayout, ...] = get_args(ComplexLayout)
REAL_LAYOUTS: tuple[RealLayout, ...] = get_args(RealLayout)
# Words decoded at a time: with their copies they fit into the second-level cache, and threads
# seldom wait for the interpreter.
_DECODE_WORDS = 1 << 18
SIGN_BIT = np.int16(-0x8000)


@dataclass(frozen=True, kw_only=True)
class WordOrder:
    """Order of the 16-bit words of complex or real samples."""

    layout: Layout
    n_rx: int
    offset_binary: bool = False
    swap_iq: bool = False

    @property
    def is_real(self) -> bool:
        """Whether each word is a sample; two of them make a complex one."""
        return self.layout in REAL_LAYOUTS

    @property
    def is_sequential(self) -> bool:
        """Whether receivers follow each other chirp by chirp."""
        return self.layout.endswith("-sequential")

    @property
    def n_alternating(self) -> int:
        """Receivers that alternate from sample to sample."""
        return 1 if self.is_sequential else self.n_rx

    @property
    def per_complex(self) -> int:
        """Samples of a receiver in the file that make a complex one."""
        return 2 if self.is_real else 1

    def __str__(self) -> str:
        return (
            f"{self.layout}, {'offset binary' if self.offset_binary else 'two-complement'}"
            f"{', I and Q swapped' if self.swap_iq else ''}"
        )


def decode(words: Words, order: WordOrder, n_samples: int) -> Complexes:
    """Complex samples of whole chirps, (n_chirps, n_rx, n_samples); see `decode_integers`."""
    if order.is_real:
        return analytic_signal(real_words(words, order, 2 * n_samples))
    return complex_samples(decode_integers(words, order, n_samples))


def real_words(words: Words, order: WordOrder, n_samples: int) -> Floats32:
    """Real samples of whole chirps, (n_chirps, n_rx, n_samples)."""
    signed = words ^ SIGN_BIT if order.offset_binary else words
    n_chirps = words.size // (order.n_rx * n_samples)
    signed = signed[: n_chirps * order.n_rx * n_samples]
    if order.layout == "real-sequential":
        return signed.reshape(n_chirps, order.n_rx, n_samples).astype(np.float32)
    chirps = signed.reshape(n_chirps, n_samples, order.n_rx).transpose(0, 2, 1)
    return np.ascontiguousarray(chirps, dtype=np.float32)


def analytic_signal(samples: Floats32) -> Complexes:
    """Every other sample of the analytic signal, (..., n) -> (..., n / 2): half the rate."""
    half = samples.shape[-1] // 2
    spectrum = rfft(samples, axis=-1)
    spectrum[..., 0] = 0.5 * (spectrum[..., 0] + spectrum[..., half])
    return np.asarray(ifft(spectrum[..., :half], axis=-1), dtype=np.complex64)


def decode_integers(words: Words, order: WordOrder, n_samples: int) -> Words:
    """I and Q of whole chirps, (n_chirps, n_rx, n_samples, 2), from words as stored in the file."""
    chirp = 2 * order.n_rx * n_samples
    n_chirps = words.size // chirp
    signal = np.empty((n_chirps, order.n_rx, n_samples, 2), dtype=np.int16)
    flat = signal.reshape(-1)
    step = max(1, _DECODE_WORDS // chirp)
    for first in range(0, n_chirps, step):
        chosen = slice(first * chirp, min(first + step, n_chirps) * chirp)
        some = flat[chosen]
        _pack(words[chosen], some, order, n_samples)
        if order.offset_binary:
            some ^= SIGN_BIT
    return signal


def _pack(words: Words, packed: Words, order: WordOrder, n_samples: int) -> None:
    """Copy words into the order (n_chirps, n_rx, n_samples, I and Q), one strided copy a part."""
    n_rx = order.n_rx
    if order.layout == "iq" and not order.swap_iq:  # I and Q of a sample move together
        pairs = words.view(np.uint32).reshape(-1, n_samples, n_rx)
        packed.view(np.uint32).reshape(-1, n_rx, n_samples)[...] = pairs.transpose(0, 2, 1)
        return
    if order.layout == "2-lane-sequential":  # I(n) I(n+1) Q(n) Q(n+1), receiver after receiver
        source, target = words.reshape(-1, 2, 2), packed.reshape(-1, 2, 2)
        copies = [(source[:, :, side], target[:, side]) for side in range(2)]
    elif order.layout == "iq-sequential":  # I0 Q0 I1 Q1 ..., receiver after receiver
        copies = [(words.reshape(-1, 2), packed.reshape(-1, 2))]
    else:
        groups = {
            "4-lane": (1, 2, n_rx),  # I0 I1 I2 I3 Q0 Q1 Q2 Q3
            "iq": (n_rx, 2, 1),  # I0 Q0 I1 Q1 ...
            "2-lane-pairs": (n_rx // 2, 2, 2),  # I0 I1 Q0 Q1 I2 I3 Q2 Q3
        }
        source = words.reshape(-1, n_samples, *groups[order.layout]).transpose(0, 2, 4, 1, 3)
        copies = [(source, packed.reshape(source.shape))]
    # I and Q one after the other: in a single copy the inner loop would be these two, which takes
    # 2 to 4 times as long.
    for source, target in copies:
        for part in range(2):
            target[..., part ^ order.swap_iq] = source[..., part]


_MIN_SAMPLES, _MAX_SAMPLES = 16, 8192
# The signal jumps at the end of a chirp: least median jump there over that elsewhere; 29 and 83 on
# captures of real boards, about 1 at any other period.
MIN_JUMP = 3.0
# Order of the linear prediction.
_N_LAGS = 4
_JUMP_SHARE = 0.05
_MIN_CHIRPS = 12


def channels(words: Words, order: WordOrder) -> Complexes:
    """Sample streams before the chirp length is known, (n_channels, n_samples)."""
    if order.is_real:
        one = replace(order, n_rx=1) if order.is_sequential else order
        real = real_words(words, one, words.size // one.n_rx)[0]
        return np.asarray(real, dtype=np.complex64)
    if order.is_sequential:
        one = replace(order, n_rx=1)
        return np.asarray(decode(words[: words.size // 4 * 4], one, words.size // 4 * 2)[0])
    n_samples = words.size // (2 * order.n_rx)
    return np.asarray(decode(words[: 2 * order.n_rx * n_samples], order, n_samples)[0])


def find_n_samples(words: Words, order: WordOrder, given: int | None) -> tuple[int | None, float]:
    """Return the samples per chirp, from the jumps of the signal, and the ratio of these to others.

    Jumps are residuals of a linear prediction. The chirp is the smallest period with a jump at
    every multiple.
    """
    jumps = signal_jumps(words, order)
    if not jumps.any():
        return given, 1.0
    usual_jump = float(np.median(jumps))
    if given is not None:
        return given, _jump_score(jumps, given) / usual_jump
    largest = min(_MAX_SAMPLES, len(jumps) // _MIN_CHIRPS)
    in_pairs = order.layout == "2-lane-sequential"
    periods = np.arange(_MIN_SAMPLES, largest, 2 if in_pairs else 1)
    # A dozen multiples rule out most periods, which saves nearly all of the time. They are spread
    # over the recording: the first of joined captures may be weak.
    counts = len(jumps) // periods
    chosen = np.arange(1, _MIN_CHIRPS) * counts[:, None] // _MIN_CHIRPS
    some = jumps[periods[:, None] * chosen]
    likely = (
        periods[np.median(some, axis=1) >= 0.5 * MIN_JUMP * usual_jump] if periods.size else periods
    )
    scores = {int(n): _jump_score(jumps, int(n)) / usual_jump for n in likely}
    best = max(scores.values(), default=1.0)
    if best < MIN_JUMP:
        return None, best
    strong = min(n for n, score in scores.items() if score >= max(_JUMP_SHARE * best, MIN_JUMP))
    # Joined captures and positions jump far more than the chirps within them.
    smallest = min(n for n in scores if strong % n == 0 and scores[n] >= MIN_JUMP)
    return smallest, scores[smallest]


def signal_jumps(words: Words, order: WordOrder) -> Floats:
    """Power of the prediction residual of each sample, (n_samples,)."""
    n_lags = _N_LAGS * order.per_complex
    errors = np.abs(prediction_error(channels(words, order), n_lags)).astype(np.float64) ** 2
    # Channels of different strength count alike; a dead one is ignored.
    usual = np.median(errors, axis=1, keepdims=True)
    ratios = np.divide(errors, usual, out=np.zeros_like(errors), where=usual > 0)
    return np.asarray(ratios.mean(axis=0))


def chirp_phase(words: Words, order: WordOrder, n_samples: int) -> int | None:
    """Sample as stored at which chirps begin; None where no jump shows it.

    n_samples: complex samples of a chirp. Words that begin with a chirp give 0.
    """
    jumps = signal_jumps(words, order)
    n_samples *= order.per_complex
    n_chirps = len(jumps) // n_samples
    if n_chirps < _MIN_CHIRPS:
        return None
    folded = np.median(jumps[: n_chirps * n_samples].reshape(n_chirps, n_samples)[1:], axis=0)
    # A chirp begins with a pair of samples where these are stored in pairs.
    latest = (
        int(folded.argmax()) // (step := 2 if order.layout == "2-lane-sequential" else 1) * step
    )
    # The error of a real sample after a jump may be larger than that of the first.
    latest = 0 if order.is_real and latest < _N_LAGS * order.per_complex else latest
    usual = float(np.median(jumps))
    if not usual > 0 or folded.max() < MIN_JUMP * usual:
        return None
    return latest if folded[latest : latest + step].max() >= MIN_JUMP * folded[0] else 0


def find_late_chirps(words: Words, order: WordOrder) -> tuple[int, int] | None:
    """Return the samples per chirp and those before the first whole one."""
    jumps = signal_jumps(words, order)
    jumps = jumps[: min(_MAX_SAMPLES, len(jumps) // 2)]
    if not jumps.any():
        return None
    # Samples behind a jump are predicted from before it, some worse than the first.
    largest = int(jumps.argmax())
    near = jumps[max(0, largest - _N_LAGS) : largest + 1]
    first = largest + 1 - len(near) + int(np.argmax(near > 0.1 * near[-1]))
    first -= first % 2 if order.layout == "2-lane-sequential" else 0
    n_samples, _ = find_n_samples(words[words_per_sample(order) * first :], order, None)
    return None if n_samples is None else (n_samples, first % n_samples)


def words_per_sample(order: WordOrder) -> int:
    """Words of one sample as stored, of the receivers that alternate."""
    return order.n_alternating * 2 // order.per_complex


def _jump_score(jumps: Floats, period: int) -> float:
    """Median jump at multiples of `period`, least over the four residues of the multiple."""
    # A fraction of a chirp therefore scores low.
    n_rounds = len(jumps) // (4 * period)
    if n_rounds == 0:
        return 0.0
    at = jumps[: n_rounds * 4 * period : period].reshape(n_rounds, 4)
    # The stream begins without a jump.
    return float(np.median(at[1:], axis=0).min()) if n_rounds > 1 else float(at[0, 1:].min())


def prediction_error(streams: Complexes, n_lags: int) -> Complexes:
    """Residual of a Yule-Walker linear prediction, (n_channels, n_samples)."""
    error = streams - streams.mean(axis=1, keepdims=True)
    n = streams.shape[1]
    for channel, stream in enumerate(error.copy()):
        lags = [np.vdot(stream[: n - lag], stream[lag:]) for lag in range(n_lags + 1)]
        if not abs(lags[0]) > 0:
            continue
        # A millionth on the diagonal: a pure tone makes the equations singular.
        noise = 1e-6 * lags[0] * np.eye(n_lags)
        weights = np.linalg.solve(toeplitz(lags[:-1]) + noise, np.array(lags[1:]))
        for lag, weight in enumerate(weights, start=1):
            error[channel, lag:] -= weight.astype(np.complex64) * stream[:-lag]
    error[:, :n_lags] = 0
    return np.asarray(error)
