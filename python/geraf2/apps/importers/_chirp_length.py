"""Number of samples per chirp, from where the signal jumps."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from geraf2._types import Floats
from geraf2.apps.importers._word_order import WordOrder, decode, real_words
from geraf2.errors import UserError

_MIN_SAMPLES, _MAX_SAMPLES = 16, 8192
# The signal jumps at the end of a chirp: least median jump there over that elsewhere; 29 and 83 on
# captures of real boards, about 1 at any other period.
MIN_JUMP = 3.0
# Order of the linear prediction.
_N_LAGS = 4
_JUMP_SHARE = 0.05
_MIN_CHIRPS = 12


def channels(words: NDArray[np.int16], order: WordOrder) -> NDArray[np.complex64]:
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


def find_n_samples(
    words: NDArray[np.int16], order: WordOrder, given: int | None
) -> tuple[int | None, float]:
    """Return the samples per chirp, from the jumps of the signal, and the ratio of these to others.

    Jumps are residuals of a linear prediction, so that a fast beat does not hide them. The chirp
    is the smallest period with a jump at every multiple.
    """
    jumps = _jumps(words, order)
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


def _jumps(words: NDArray[np.int16], order: WordOrder) -> Floats:
    """Power of the prediction residual of each sample, (n_samples,)."""
    n_lags = _N_LAGS * order.per_complex
    errors = np.abs(prediction_error(channels(words, order), n_lags)).astype(np.float64) ** 2
    # Channels of different strength count alike; a dead one is ignored.
    usual = np.median(errors, axis=1, keepdims=True)
    ratios = np.divide(errors, usual, out=np.zeros_like(errors), where=usual > 0)
    return np.asarray(ratios.mean(axis=0))


def late_samples(words: NDArray[np.int16], order: WordOrder, n_samples: int) -> int:
    """Delay of the chirps, in samples as stored, in words that should begin with a chirp."""
    jumps = _jumps(words, order)
    n_samples *= order.per_complex
    n_chirps = len(jumps) // n_samples
    if n_chirps < _MIN_CHIRPS:
        return 0
    folded = np.median(jumps[: n_chirps * n_samples].reshape(n_chirps, n_samples)[1:], axis=0)
    # A chirp begins with a pair of samples where these are stored in pairs.
    latest = (
        int(folded.argmax()) // (step := 2 if order.layout == "2-lane-sequential" else 1) * step
    )
    # The error of a real sample after a jump may be larger than that of the first.
    latest = 0 if order.is_real and latest < _N_LAGS * order.per_complex else latest
    usual = float(np.median(jumps))
    is_late = folded[latest] >= MIN_JUMP * max(usual, float(folded[0]))
    return latest if usual > 0 and is_late else 0


def begins_in_chirp(order: WordOrder, n_samples: int, late: int, where: object) -> UserError:
    """UserError for a recording whose first whole chirp begins `late` samples after its start.

    n_samples, late: samples as stored, two of which make a complex one where they are real.
    """
    n_bytes = 2 * words_per_sample(order) * late
    return UserError(
        what=f"begins in the middle of a chirp: one of {n_samples} samples begins after {late}",
        where=where,
        hint="is it a later part of a recording? name the folder with all parts"
        if order.layout == "2-lane-sequential"
        else f"name the folder with all parts of the recording, or leave out {n_bytes} bytes",
    )


def find_late_chirps(words: NDArray[np.int16], order: WordOrder) -> tuple[int, int] | None:
    """Return the samples per chirp and those before the first whole one."""
    jumps = _jumps(words, order)[:_MAX_SAMPLES]
    first = int(jumps.argmax()) // 2 * 2
    n_samples, _ = find_n_samples(words[words_per_sample(order) * first :], order, None)
    return None if n_samples is None else (n_samples, first % n_samples)


def words_per_sample(order: WordOrder) -> int:
    """Words of one sample as stored, of the receivers that alternate."""
    return order.n_alternating * 2 // order.per_complex


def _jump_score(jumps: Floats, period: int) -> float:
    """Median jump at multiples of `period`, least over the four residues of the multiple.

    A fraction of a chirp therefore scores low, and a large jump between the last and the first
    receiver does not hide smaller ones.
    """
    n_rounds = len(jumps) // (4 * period)
    if n_rounds == 0:
        return 0.0
    at = jumps[: n_rounds * 4 * period : period].reshape(n_rounds, 4)
    # The stream begins without a jump.
    return float(np.median(at[1:], axis=0).min()) if n_rounds > 1 else float(at[0, 1:].min())


def prediction_error(streams: NDArray[np.complex64], n_lags: int) -> NDArray[np.complex64]:
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
