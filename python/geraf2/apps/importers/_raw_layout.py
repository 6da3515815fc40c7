"""Order of the 16-bit words in a raw capture of a TI board, and how to find it out.

An echo has a positive delay, so that the beat of a complex receiver lies on one side of its
spectrum. Words in the wrong order mirror it: the energy of one side over that of the other is
about 1 to 5 for a wrong layout, and 25 to 4000 for the right one on captures of real boards.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.io.samples import complex_samples

Layout = Literal["4-lane", "2-lane-pairs", "2-lane-sequential", "iq"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

# Energy of one side over the other below which no layout is believed, and how much better than
# another one it must be to contradict it. Wrong layouts of real captures reach 5; right ones are
# 5, 11 and 1000 times better than those.
MIN_RATIO = 8.0
CONTRADICTION = 3.0
# Samples in sequence, read as receivers that take turns, look like receivers at a lower rate, with
# a spectrum as one-sided as the true one. So fewer receivers are preferred where they do nearly as
# well; read the other way round, receivers in turn are no signal at all.
_FASTER_SHARE = 0.1
_COUNTED_N_RX = (1, 2, 4)
_USUAL_N_RX = 4
# Segments that need not begin with a chirp: short against it, long against the beat. Strong
# coupling near DC leaks over their whole spectrum: on a real capture they give the right order
# 1.9 : 1, whole chirps 24 : 1. So where segments decide nothing, whole chirps do.
_SEGMENT = 64
# The Hann window spreads what stands still in the receiver (DC) over one bin to each side.
_GUARD_BINS = 1
# Words whose spectra are compared between layouts: 16000 samples of each of four receivers.
_LAYOUT_WORDS = 1 << 17
_MIN_SAMPLES, _MAX_SAMPLES = 16, 8192
# Below these there is no spectrum to speak of.
_MIN_WORDS, _FEWEST_SAMPLES = 1024, 8
# Words that are decoded at a time: with their copies they fit into the second-level cache, and
# threads do not wait for the interpreter too often.
_DECODE_WORDS = 1 << 18
_SIGN_BIT = np.int16(-0x8000)
# The signal jumps where a chirp ends: median jump there over that elsewhere; 29 and 83 on captures
# of real boards, about 1 at any other place.
_MIN_JUMP = 3.0
# Samples that the prediction looks back.
_N_LAGS = 4
_JUMP_SHARE = 0.05
_MIN_CHIRPS = 12


@dataclass(frozen=True, kw_only=True)
class WordOrder:
    """How 16-bit words become complex samples."""

    layout: Layout
    n_rx: int
    offset_binary: bool = False
    swap_iq: bool = False

    def __post_init__(self) -> None:
        if self.layout == "2-lane-pairs" and self.n_rx % 2:
            msg = f"2-lane-pairs needs an even n_rx, got {self.n_rx}"
            raise ValueError(msg)

    def __str__(self) -> str:
        return (
            f"{self.layout}, {'offset binary' if self.offset_binary else 'two-complement'}"
            f"{', I and Q swapped' if self.swap_iq else ''}"
        )


@dataclass(frozen=True, kw_only=True)
class LayoutEvidence:
    """The order of the words, and what speaks for it."""

    order: WordOrder
    n_samples: int
    energy_ratio: float
    """Energy at positive beat frequencies over that at negative ones."""
    next_layout: str
    next_ratio: float
    """The best other layout with as many receivers in turn or fewer, and its ratio."""
    jump_ratio: float
    """Jump of the signal from chirp to chirp over that from sample to sample."""
    n_samples_found: bool
    """Whether the number of samples was found out and not given."""
    notes: tuple[str, ...] = ()
    """What the user should know."""


def decode(words: NDArray[np.int16], order: WordOrder, n_samples: int) -> NDArray[np.complex64]:
    """Complex samples of whole chirps, (n_chirps, n_rx, n_samples); see `decode_integers`."""
    return complex_samples(decode_integers(words, order, n_samples))


def decode_integers(
    words: NDArray[np.int16], order: WordOrder, n_samples: int
) -> NDArray[np.int16]:
    """Put I and Q of whole chirps in order, (n_chirps, n_rx, n_samples, 2).

    words: (n_chirps * n_samples * n_rx * 2,) as they lie in the file.
    order: their order.
    n_samples: samples per chirp.
    """
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
            some ^= _SIGN_BIT
    return signal


def _pack(
    words: NDArray[np.int16], packed: NDArray[np.int16], order: WordOrder, n_samples: int
) -> None:
    """Words into the order (n_chirps, n_rx, n_samples, I and Q), as integers.

    Each part of each receiver is one copy in long strides: NumPy takes 2 to 4 times as long for
    the same in one call, whose inner loop is the short axis (bench/python/import_raw.py).
    """
    n_rx = order.n_rx
    if order.layout == "iq" and not order.swap_iq:  # I and Q of a sample move together
        pairs = words.view(np.uint32).reshape(-1, n_samples, n_rx)
        packed.view(np.uint32).reshape(-1, n_rx, n_samples)[...] = pairs.transpose(0, 2, 1)
        return
    lanes: list[tuple[NDArray[np.int16], NDArray[np.int16]]]
    target: NDArray[np.int16]
    if order.layout == "2-lane-sequential":  # I(n) I(n+1) Q(n) Q(n+1), receiver after receiver
        target = packed.reshape(-1, 2, 2)
        quads = words.reshape(-1, 2, 2)
        lanes = [(quads[:, 0, side], quads[:, 1, side]) for side in range(2)]
    else:
        target = packed.reshape(-1, n_rx, n_samples, 2).transpose(0, 2, 1, 3)
        n_chirps = words.size // (2 * n_rx * n_samples)
        # Groups of receivers, I and Q, receivers of a group.
        if order.layout == "4-lane":  # I0 I1 I2 I3 Q0 Q1 Q2 Q3
            both = words.reshape(n_chirps, n_samples, 1, 2, n_rx)
        elif order.layout == "iq":  # I0 Q0 I1 Q1 ...
            both = words.reshape(n_chirps, n_samples, n_rx, 2, 1)
        else:  # I0 I1 Q0 Q1 I2 I3 Q2 Q3
            both = words.reshape(n_chirps, n_samples, n_rx // 2, 2, 2)
        lanes = [
            (both[:, :, group, 0, side], both[:, :, group, 1, side])
            for group, side in np.ndindex(both.shape[2], both.shape[4])
        ]
    for lane, (in_phase, quadrature) in enumerate(lanes):
        target[..., lane, int(order.swap_iq)] = in_phase
        target[..., lane, 1 - int(order.swap_iq)] = quadrature


def side_energies(signal: NDArray[np.complex64]) -> tuple[float, float]:
    """Energy at positive and at negative beat frequencies, of (..., n_samples)."""
    n = signal.shape[-1]
    window = np.hanning(n + 1)[:n]
    centred = signal - signal.mean(axis=-1, keepdims=True)
    spectrum = np.abs(np.fft.fft(centred * window, axis=-1)) ** 2
    power = spectrum.reshape(-1, n).sum(axis=0, dtype=np.float64)
    half = n // 2
    return (
        float(power[1 + _GUARD_BINS : half].sum()),
        float(power[n - half + 1 : n - _GUARD_BINS].sum()),
    )


def _ratio(signal: NDArray[np.complex64]) -> float:
    positive, negative = side_energies(signal)
    if positive == negative:  # both zero, too
        return 1.0
    return positive / negative if negative > 0 else float("inf")


def _channels(words: NDArray[np.int16], order: WordOrder) -> NDArray[np.complex64]:
    """Unbroken streams before chirps are known, (n_channels, n_samples)."""
    if order.layout == "2-lane-sequential":
        one = WordOrder(
            layout=order.layout, n_rx=1, offset_binary=order.offset_binary, swap_iq=order.swap_iq
        )
        return np.asarray(decode(words[: words.size // 4 * 4], one, words.size // 4 * 2)[0])
    n_samples = words.size // (2 * order.n_rx)
    return np.asarray(decode(words[: 2 * order.n_rx * n_samples], order, n_samples)[0])


def _segment_ratio(words: NDArray[np.int16], order: WordOrder, length: int) -> float:
    streams = _channels(words, order)
    n_segments = streams.shape[1] // length
    if n_segments == 0:
        return 1.0
    return _ratio(streams[:, : n_segments * length].reshape(-1, length))


def _chirp_ratio(
    words: NDArray[np.int16], order: WordOrder, n_samples: int | None, otherwise: float
) -> float:
    """Ratio over whole chirps, as long as given or as the jumps say; `otherwise` without jumps."""
    if n_samples is None:
        n_samples, _ = _find_n_samples(words, order, None)
    if n_samples is None or (order.layout == "2-lane-sequential" and n_samples % 2):
        return otherwise
    return _segment_ratio(words, order, n_samples)


def _one_sided(ratio: float) -> float:
    return max(ratio, 1 / ratio) if ratio > 0 else float("inf")


def _find_n_samples(
    words: NDArray[np.int16], order: WordOrder, given: int | None
) -> tuple[int | None, float]:
    """Find the samples per chirp from where the signal jumps, and how much more it jumps there.

    The jump is measured against a linear prediction from the samples before, so that a fast
    beat does not hide it. The smallest period with a jump at every multiple is the chirp.
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
    # Most periods drop out at a dozen multiples, which saves nearly all of the time. These are
    # spread over all: the first of joined captures may be weak.
    counts = len(jumps) // periods
    chosen = np.arange(1, _MIN_CHIRPS) * counts[:, None] // _MIN_CHIRPS
    some = jumps[periods[:, None] * chosen]
    likely = (
        periods[np.median(some, axis=1) >= 0.5 * _MIN_JUMP * usual_jump]
        if periods.size
        else periods
    )
    scores = {int(n): _jump_score(jumps, int(n)) / usual_jump for n in likely}
    best = max(scores.values(), default=1.0)
    if best < _MIN_JUMP:
        return None, best
    strong = min(n for n, score in scores.items() if score >= max(_JUMP_SHARE * best, _MIN_JUMP))
    # Joined captures and places jump far more than the chirps within; a part of a chirp does not.
    smallest = min(n for n in scores if strong % n == 0 and scores[n] >= _MIN_JUMP)
    return smallest, scores[smallest]


def _jumps(words: NDArray[np.int16], order: WordOrder) -> Floats:
    """Power by which each sample differs from what those before predict, (n_samples,)."""
    errors = np.abs(_prediction_error(_channels(words, order))).astype(np.float64) ** 2
    # Channels of different strength count alike. A dead one says nothing.
    usual = np.median(errors, axis=1, keepdims=True)
    ratios = np.divide(errors, usual, out=np.zeros_like(errors), where=usual > 0)
    return np.asarray(ratios.mean(axis=0))


def late_samples(words: NDArray[np.int16], order: WordOrder, n_samples: int) -> int:
    """Count by how many samples chirps begin late in words that should begin with one."""
    jumps = _jumps(words, order)
    n_chirps = len(jumps) // n_samples
    if n_chirps < _MIN_CHIRPS:
        return 0
    folded = np.median(jumps[: n_chirps * n_samples].reshape(n_chirps, n_samples)[1:], axis=0)
    latest = int(folded.argmax())
    usual = float(np.median(jumps))
    is_late = folded[latest] >= _MIN_JUMP * max(usual, float(folded[0]))
    return latest if usual > 0 and is_late else 0


def _jump_score(jumps: Floats, period: int) -> float:
    """Median jump at multiples of `period`; of every fourth of them, the fourth that jumps least.

    So a part of a chirp scores nothing, and a large jump from the last receiver to the first
    does not hide smaller ones between them.
    """
    n_rounds = len(jumps) // (4 * period)
    if n_rounds == 0:
        return 0.0
    at = jumps[: n_rounds * 4 * period : period].reshape(n_rounds, 4)
    # The stream begins without a jump.
    return float(np.median(at[1:], axis=0).min()) if n_rounds > 1 else float(at[0, 1:].min())


def _prediction_error(streams: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Take off what the samples before predict, (n_channels, n_samples), by Yule-Walker."""
    error = streams - streams.mean(axis=1, keepdims=True)
    n = streams.shape[1]
    for channel, stream in enumerate(error.copy()):
        lags = [np.vdot(stream[: n - lag], stream[lag:]) for lag in range(_N_LAGS + 1)]
        if not abs(lags[0]) > 0:
            continue
        # A millionth on the diagonal: a pure tone makes the equations singular.
        noise = 1e-6 * lags[0] * np.eye(_N_LAGS)
        weights = np.linalg.solve(toeplitz(lags[:-1]) + noise, np.array(lags[1:]))
        for lag, weight in enumerate(weights, start=1):
            error[channel, lag:] -= weight.astype(np.complex64) * stream[:-lag]
    error[:, :_N_LAGS] = 0
    return np.asarray(error)


def _orders(
    layout: Layout | None, n_rx: int | None, offset_binary: bool | None
) -> Iterator[WordOrder]:
    offsets = (False, True) if offset_binary is None else (offset_binary,)
    layouts = LAYOUTS if layout is None else (layout,)
    for one, offset in product(layouts, offsets):
        # Receivers that follow each other chirp by chirp cannot be counted.
        unknown = (_USUAL_N_RX,) if one == "2-lane-sequential" else _COUNTED_N_RX
        for n in unknown if n_rx is None else (n_rx,):
            if one == "2-lane-pairs" and n % 2:
                continue
            same_as_4_lane = (one == "iq" and n == 1) or (one == "2-lane-pairs" and n == 2)
            if same_as_4_lane and layout is None:
                continue
            yield WordOrder(layout=one, n_rx=n, offset_binary=offset)


def find_layout(
    words: NDArray[np.int16],
    *,
    n_rx: int | None = None,
    layout: Layout | None = None,
    offset_binary: bool | None = None,
    swap_iq: bool | None = None,
    n_samples: int | None = None,
    where: object = None,
) -> LayoutEvidence:
    """Find out what is not given; refuse what is given and plainly wrong.

    words: the beginning of a capture, from the start of a chirp on; some chirps.
    n_rx, layout, offset_binary, swap_iq, n_samples: what is known; layout, offset_binary and
        n_samples are checked against the alternatives.
    where: the file, for messages.
    """
    _require_possible(words, layout, n_rx, n_samples, where)
    # A recording that was stopped, and a sparse file, end in zeros: they say nothing.
    n_said = len(words) - int(np.argmax(words[::-1] != 0)) if words.any() else 0
    words = words[: -(-n_said // 64) * 64]
    length = min(_SEGMENT, n_samples) if n_samples else _SEGMENT
    beginning = words[:_LAYOUT_WORDS]
    allowed = list(_orders(layout, n_rx, offset_binary))
    ratios = {
        order: _segment_ratio(beginning, order, length)
        for order in (*_orders(None, n_rx, None), *_orders(None, None, None), *allowed)
    }
    if max(map(_one_sided, ratios.values())) < MIN_RATIO:
        ratios = {
            order: _chirp_ratio(beginning, order, n_samples, ratio)
            for order, ratio in ratios.items()
        }
    chosen, notes = _chosen_order(ratios, allowed, where)
    is_open = layout is None or offset_binary is None or n_rx is None
    if is_open and _one_sided(ratios[chosen]) < MIN_RATIO:
        raise UserError(
            what="the layout cannot be found out: no order of the words gives a one-sided "
            f"spectrum (best is {chosen} with {_one_sided(ratios[chosen]):.3g} : 1)",
            where=where,
            expected=f"{MIN_RATIO:g} : 1 or more",
            hint="give layout, offset_binary and n_rx under [raw] of --radar; real (not complex) "
            "samples are not supported",
        )
    evidence = _with_samples(words, chosen, ratios, swap_iq, n_samples, where)
    return replace(evidence, notes=notes)


def _chosen_order(
    ratios: Mapping[WordOrder, float], allowed: Sequence[WordOrder], where: object
) -> tuple[WordOrder, tuple[str, ...]]:
    """Best order of those that the user allows, and notes; refuse what another contradicts."""
    one_sided = {order: _one_sided(ratio) for order, ratio in ratios.items()}
    best = _best(one_sided)
    chosen = _best({order: one_sided[order] for order in allowed})
    if one_sided[best] <= CONTRADICTION * one_sided[chosen]:
        return chosen, ()
    names = (
        (str(chosen), str(best))
        if chosen.n_rx == best.n_rx
        else tuple(f"{order}, {order.n_rx} receivers," for order in (chosen, best))
    )
    text = (
        f"as {names[0]} the energy of the two sides of the spectrum is {one_sided[chosen]:.3g} : "
        f"1, as {names[1]} {one_sided[best]:.3g} : 1"
    )
    if one_sided[best] > MIN_RATIO:
        raise UserError(
            what=f"the samples contradict the layout given: {text}",
            where=where,
            hint="correct it, or leave it out to have it found",
        )
    return chosen, (f"the layout given is doubtful: {text}",)


def _require_possible(
    words: NDArray[np.int16],
    layout: Layout | None,
    n_rx: int | None,
    n_samples: int | None,
    where: object,
) -> None:
    if len(words) < _MIN_WORDS:
        raise UserError(
            what="is too short to find out how it is stored",
            where=where,
            expected=f"{2 * _MIN_WORDS} bytes or more",
            got=2 * len(words),
        )
    if not words.any():
        raise UserError(what="begins with nothing but zeros", where=where)
    if layout == "2-lane-pairs" and n_rx is not None and n_rx % 2:
        raise UserError(what="2-lane-pairs needs an even n_rx", where=where, got=n_rx)
    if n_samples is not None and n_samples < _FEWEST_SAMPLES:
        raise UserError(
            what="too few samples per chirp",
            where=where,
            expected=f"{_FEWEST_SAMPLES} or more",
            got=n_samples,
        )
    _require_pairs(layout, n_samples, where)


def _require_pairs(layout: Layout | None, n_samples: int | None, where: object) -> None:
    if layout == "2-lane-sequential" and n_samples is not None and n_samples % 2:
        raise UserError(
            what="2-lane-sequential needs an even number of samples", where=where, got=n_samples
        )


def _best(one_sided: dict[WordOrder, float]) -> WordOrder:
    best = max(one_sided, key=lambda order: one_sided[order])
    enough = max(MIN_RATIO, _FASTER_SHARE * one_sided[best])
    for order in sorted(one_sided, key=_n_alternating):
        same_kind = order.offset_binary == best.offset_binary
        if (
            same_kind
            and one_sided[order] >= enough
            and _n_alternating(order) < _n_alternating(best)
        ):
            return order
    return best


def _n_alternating(order: WordOrder) -> int:
    """Receivers that take turns from sample to sample."""
    return 1 if order.layout == "2-lane-sequential" else order.n_rx


def _with_samples(
    words: NDArray[np.int16],
    chosen: WordOrder,
    ratios: Mapping[WordOrder, float],
    swap_iq: bool | None,
    n_samples: int | None,
    where: object,
) -> LayoutEvidence:
    _require_pairs(chosen.layout, n_samples, where)
    found, jump = _find_n_samples(words, chosen, None)
    if n_samples is None:
        if found is None:
            raise UserError(
                what="the number of samples per chirp cannot be found out: the signal jumps "
                f"nowhere regularly ({jump:.3g} times the mean at best)",
                where=where,
                expected=f"{_MIN_JUMP:g} times or more where a chirp ends",
                hint="give n_samples in --radar, or the radar's --config",
            )
        n_samples = found
    elif found is not None and found != n_samples:
        _, given_jump = _find_n_samples(words, chosen, n_samples)
        if jump > CONTRADICTION * given_jump or n_samples % found == 0:
            raise UserError(
                what="the samples contradict the number of samples per chirp",
                where=where,
                expected=f"{found}, where the signal jumps {jump:.3g} times as much as elsewhere",
                got=f"{n_samples} ({given_jump:.3g} times)",
                hint="correct n_samples, or leave it out to have it found",
            )
    else:
        _, jump = _find_n_samples(words, chosen, n_samples)
    # I and Q swapped turn the spectrum round.
    order = WordOrder(
        layout=chosen.layout,
        n_rx=chosen.n_rx,
        offset_binary=chosen.offset_binary,
        swap_iq=ratios[chosen] < 1 if swap_iq is None else swap_iq,
    )
    n_chirps = words.size // (2 * order.n_rx * n_samples)
    whole = words[: n_chirps * 2 * order.n_rx * n_samples]
    # What alternates more is the same samples at a lower rate, and says nothing.
    others = {
        other: _one_sided(ratio)
        for other, ratio in ratios.items()
        if other.layout != chosen.layout and _n_alternating(other) <= _n_alternating(chosen)
    }
    runner_up = max(others, key=lambda other: others[other], default=None)
    return LayoutEvidence(
        order=order,
        n_samples=n_samples,
        energy_ratio=_ratio(decode(whole, order, n_samples)),
        next_layout="" if runner_up is None else str(runner_up),
        next_ratio=0.0 if runner_up is None else others[runner_up],
        jump_ratio=jump,
        n_samples_found=found == n_samples,
    )
