"""Detection of the word order in a raw capture of a TI board.

An echo has a positive delay, so that the beat of a complex receiver lies on one side of its
spectrum. Words in the wrong order mirror it: the ratio of the energies of the two sides is about 1
to 5 for a wrong layout, and 25 to 4000 for the right one on captures of real boards.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from geraf2._types import Complexes, Words
from geraf2.apps.importers._lost_packets import jumps_with_packets, packets_are_missing
from geraf2.apps.importers._number_kinds import other_numbers, require_words
from geraf2.apps.importers._real_samples import is_predicted_as_real, real_advantage
from geraf2.apps.importers._word_order import (
    LAYOUTS,
    MIN_JUMP,
    REAL_LAYOUTS,
    Layout,
    WordOrder,
    channels,
    decode,
    find_late_chirps,
    find_n_samples,
)
from geraf2.errors import UserError

# Least ratio of the sides at which a layout is accepted, and the factor by which a layout must be
# better than another one to contradict it. Wrong layouts of real captures reach 5; right ones are
# 5, 11 and 1000 times better than those.
MIN_RATIO = 8.0
CONTRADICTION = 3.0
# Samples in sequence, read as alternating receivers, have a spectrum as one-sided as the true one,
# at a lower rate. Fewer receivers are therefore preferred where they do nearly as well. Alternating
# receivers read as a sequence are no signal at all.
_FASTER_SHARE = 0.1
# Numbers of receivers tried. That of receivers which follow each other chirp by chirp cannot be
# estimated, and alternating real samples of a single receiver are sequential.
_UNKNOWN_N_RX: dict[Layout, tuple[int, ...]] = {
    **dict.fromkeys(LAYOUTS, (1, 2, 4)),
    **dict.fromkeys(("2-lane-sequential", "iq-sequential", "real-sequential"), (4,)),
    "real-alternating": (2, 4),
}
# Least ratio of pairs in sequence over that of the same ones read as alternating receivers; above 1
# but for long chirps, where both are one line, and below .2 where receivers alternate.
_IN_TURN_SHARE = 0.5
_PAIRS: tuple[Layout, ...] = ("iq-sequential", "iq")
# Segments that need not begin with a chirp: short against it, long against the beat. Strong
# coupling near DC leaks over their whole spectrum: on a real capture they give the right order
# 1.9 : 1, whole chirps 24 : 1. So where segments decide nothing, whole chirps do.
_SEGMENT = 64
# The Hann window spreads DC over one bin to each side.
_GUARD_BINS = 1
# Words whose spectra are compared between layouts: 16000 samples of each of four receivers.
_LAYOUT_WORDS = 1 << 17
# Advantage of the best real order at which samples are real. With one to three echoes at 0 to 20 dB
# over noise 216 of 244 recordings of real samples reach it, and 1 of 488 of complex ones, most of
# which stay below .05. Captures of three real boards, all complex, have -1.6 to -2.1.
_REAL_ADVANTAGE = 0.1
# Ratio of the sides from which on blocks of I and Q are told from real samples: phases of two real
# receivers then differ by 90 degrees within 11.
_BLOCK_RATIO = 100.0
# That at which a configuration is not believed.
_CONTRADICTING_ADVANTAGE = 0.2
# Parts of the words whose chirps are looked for by themselves.
_N_PARTS = 8
# Words of these parts where they are short: each of six packets.
_FEW_WORDS = _N_PARTS * 6 * 728
# Fewest words and samples from which a spectrum is estimated.
_MIN_WORDS, _MIN_SAMPLES = 1024, 8


Orders = Sequence[WordOrder]
Ratios = Mapping[WordOrder, float]
"""Energies of the two sides of the spectrum, one over the other, by the order of the words."""


@dataclass(frozen=True, kw_only=True)
class LayoutEvidence:
    """Order of the words, with its evidence."""

    order: WordOrder
    n_samples: int
    """Complex samples of a chirp; half of those stored where these are real."""
    energy_ratio: float
    """Energy at positive beat frequencies over that at negative ones; infinite for real samples."""
    next_layout: str
    next_ratio: float
    """Best other layout with as many alternating receivers or fewer, and its ratio."""
    jump_ratio: float
    """Jump of the signal between chirps over that between samples."""
    n_samples_found: bool
    """Whether the number of samples was estimated and not given."""
    late: int = 0
    """Stored samples before the first whole chirp, where no chirp begins with the words."""
    notes: tuple[str, ...] = ()
    """Warnings for the user."""


def side_energies(signal: Complexes) -> tuple[float, float]:
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


def _ratio(signal: Complexes) -> float:
    positive, negative = side_energies(signal)
    if positive == negative:  # both zero, too
        return 1.0
    return positive / negative if negative > 0 else float("inf")


def _segment_ratio(words: Words, order: WordOrder, length: int) -> float:
    streams = channels(words, order)
    n_segments = streams.shape[1] // length
    if n_segments == 0:
        return 1.0
    return _ratio(streams[:, : n_segments * length].reshape(-1, length))


def _chirp_ratio(words: Words, order: WordOrder, n_samples: int | None, otherwise: float) -> float:
    """Ratio over whole chirps of the given or estimated length; `otherwise` without jumps."""
    if n_samples is None:
        n_samples, _ = find_n_samples(words, order, None)
    if n_samples is None or (order.layout == "2-lane-sequential" and n_samples % 2):
        return otherwise
    return _segment_ratio(words, order, n_samples)


def _one_sided(ratio: float) -> float:
    return max(ratio, 1 / ratio) if ratio > 0 else float("inf")


def _orders(
    layouts: Sequence[Layout], n_rx: int | None = None, offset_binary: bool | None = None
) -> Iterator[WordOrder]:
    offsets = (False, True) if offset_binary is None else (offset_binary,)
    for layout, offset in product(layouts, offsets):
        for n in _UNKNOWN_N_RX[layout] if n_rx is None else (n_rx,):
            if layout == "2-lane-pairs" and n % 2:
                continue
            same_as_4_lane = (layout, n) in (("iq", 1), ("2-lane-pairs", 2), ("iq-sequential", 1))
            # Pairs of several receivers in sequence are those of a single one.
            same_as_4_lane |= layout == "iq-sequential" and n_rx is None
            if not same_as_4_lane or len(layouts) == 1:
                yield WordOrder(layout=layout, n_rx=n, offset_binary=offset)


def find_layout(
    words: Words,
    *,
    n_rx: int | None,
    layout: Layout | None,
    offset_binary: bool | None,
    n_samples: int | None,
    is_real: bool | None,
    where: object,
) -> LayoutEvidence:
    """Estimate the unknown parts of the layout; UserError where the given ones contradict the data.

    words: some chirps from the beginning of a capture.
    n_rx, layout, offset_binary, n_samples: known parts; layout, offset_binary and
        n_samples are checked against the alternatives. n_samples counts samples as stored.
    is_real: whether a configuration states real samples, or complex ones.
    where: the file, for messages.
    """
    _require_possible(words, layout, n_rx, n_samples, where)
    # Stopped recordings and sparse files end in zeros, which are no evidence.
    n_used = len(words) - int(np.argmax(words[::-1] != 0)) if words.any() else 0
    words = words[: -(-n_used // 64) * 64]
    known: tuple[Layout, ...] = () if layout is None else (layout,)
    candidates = list(_orders(known if layout in REAL_LAYOUTS else REAL_LAYOUTS, n_rx))
    real = _real_order(words, layout, candidates, is_real, where)
    if real is not None:
        if offset_binary not in (None, real.offset_binary):
            what = f"offset_binary contradicts the samples, which are read as {real}"
            raise UserError(what=what, where=where, got=offset_binary)
        if layout is None:
            _refuse_blocks(words, n_rx or real.n_rx, n_samples, where)
        if layout is None and n_rx != 1:
            real = _order_of_receivers(words, candidates, real, n_samples, where)
        return _with_samples(words, real, {}, n_samples, where)
    length = min(_SEGMENT, n_samples) if n_samples else _SEGMENT
    beginning = words[:_LAYOUT_WORDS]
    allowed = list(_orders(known or LAYOUTS, n_rx, offset_binary))
    ratios = {
        order: _segment_ratio(beginning, order, length)
        for order in (*_orders(LAYOUTS, n_rx), *_orders(LAYOUTS), *allowed)
    }
    if max(map(_one_sided, ratios.values())) < MIN_RATIO:
        ratios = {
            order: _chirp_ratio(beginning, order, n_samples, ratio)
            for order, ratio in ratios.items()
        }
    chosen, notes = _choose_order(ratios, allowed, where)
    if layout is None:
        chosen = _order_of_pairs(words, ratios, chosen, n_samples)
    if layout is None and is_predicted_as_real(words, chosen):
        raise _unclear_receivers(n_samples, where)
    is_open = layout is None or offset_binary is None or n_rx is None
    if is_open and _one_sided(ratios[chosen]) < MIN_RATIO:
        swapped = beginning.byteswap()
        orders = _orders(LAYOUTS, n_rx)
        if max(_one_sided(_segment_ratio(swapped, one, length)) for one in orders) > MIN_RATIO:
            raise other_numbers(where, kind="big-endian integers of 16 bits")
        raise UserError(
            what="the layout cannot be found out: no order of the words gives a one-sided "
            f"spectrum (best is {chosen} with {_one_sided(ratios[chosen]):.3g} : 1)",
            where=where,
            expected=f"{MIN_RATIO:g} : 1 or more",
            hint="give layout, offset_binary and n_rx under [raw] of --radar, or --config",
        )
    evidence = _with_samples(words, chosen, ratios, n_samples, where)
    return replace(evidence, notes=notes)


def _real_order(
    words: Words, layout: Layout | None, candidates: Orders, is_real: bool | None, where: object
) -> WordOrder | None:
    """Order of real samples; None where they are complex, or a complex layout is given."""
    if layout in LAYOUTS and is_real is None:
        return None
    known = [*_orders(LAYOUTS), *_orders(LAYOUTS, candidates[0].n_rx)]
    order, advantage = real_advantage(words, known, candidates)
    if layout is not None and is_real is None:
        return order
    if advantage < _REAL_ADVANTAGE or is_real is False:
        sides = {
            one: _one_sided(_segment_ratio(words[:_LAYOUT_WORDS], one, _SEGMENT)) for one in known
        }
        best = _best_order(sides)
        if sides[best] >= MIN_RATIO:
            # At a quarter of the rate complex words have the lines of real ones, too.
            is_predicted = is_predicted_as_real(words, best)
            advantage = max(advantage, _REAL_ADVANTAGE) if is_predicted else min(advantage, 0.0)
    if is_real is None:
        return order if advantage >= _REAL_ADVANTAGE else None
    if (advantage if is_real else -advantage) < -_CONTRADICTING_ADVANTAGE:
        names = ("complex", "real")
        raise UserError(
            what=f"the samples contradict the configuration, which states {names[is_real]} ones",
            where=where,
            expected=f"{names[is_real]} samples",
            got=f"{names[not is_real]} ones",
            hint="correct the configuration, or give layout under [raw] of --radar",
        )
    return order if is_real else None


def _refuse_blocks(words: Words, n_rx: int, n_samples: int | None, where: object) -> None:
    """Raise UserError where words are I of a whole chirp, then Q, of one receiver or of all."""
    if n_samples is None:
        return
    for n_together in (1, n_rx):
        n_chirps = words.size // (2 * n_together * n_samples)
        parts = words[: n_chirps * 2 * n_together * n_samples].astype(np.float32)
        in_phase, quadrature = parts.reshape(n_chirps, 2, -1, n_samples).swapaxes(0, 1)
        if _one_sided(_ratio(in_phase + 1j * quadrature)) > _BLOCK_RATIO:
            raise UserError(
                what=f"holds {n_together * n_samples} words of I and then as many of Q in turn, or "
                "real samples of receivers whose phases differ by 90 degrees",
                where=where,
                expected="I and Q of each sample beside each other",
                hint="write I and Q as arrays for 'geraf2 import geraf-sens' or 'geraf2 import "
                "mat'; if the samples are real, give layout under [raw] of --radar",
            )


def _order_of_receivers(
    words: Words, candidates: Orders, best: WordOrder, n_samples: int | None, where: object
) -> WordOrder:
    """Order of real samples whose chirps have the given length; UserError where that is unclear."""
    if n_samples is None:
        raise UserError(
            what="the samples are real, so their number per chirp cannot be found out",
            where=where,
            expected="the radar's --config, or n_samples of --radar with n_rx under its [raw]",
        )
    others = [order for order in candidates if order.offset_binary == best.offset_binary]
    for order in (best, *others):
        if find_n_samples(words, order, None)[0] == n_samples:
            return order
    raise _unclear_receivers(n_samples, where)


def _order_of_pairs(
    words: Words, ratios: Ratios, chosen: WordOrder, n_samples: int | None
) -> WordOrder:
    """Order of I Q pairs of several receivers: sample after sample, or receiver after receiver."""
    # The given length of a chirp decides, or else the ratios: receivers with similar phases that
    # alternate are a signal of several lines when read in sequence.
    kin = [replace(chosen, layout=layout) for layout in _PAIRS]
    if chosen.layout not in _PAIRS or any(order not in ratios for order in kin):
        return chosen
    in_turn, alternating = (_one_sided(ratios[order]) for order in kin)
    # Alternating receivers take a segment of as many times the length.
    long = _segment_ratio(words[:_LAYOUT_WORDS], kin[0], _SEGMENT * chosen.n_rx)
    if max(in_turn, _one_sided(long)) < _IN_TURN_SHARE * alternating:
        kin.reverse()
    fitting = (order for order in kin if find_n_samples(words, order, None)[0] == n_samples)
    return next(fitting, kin[0]) if n_samples else kin[0]


def _unclear_receivers(n_samples: int | None, where: object) -> UserError:
    """UserError for real samples of which the order of the receivers is not known."""
    return UserError(
        what="the samples are real, and whether the receivers alternate cannot be found out",
        where=where,
        expected=f"a signal that jumps every {n_samples or 'n'} samples",
        hint="give layout under [raw] of --radar: real-alternating on xWR12xx and xWR14xx, "
        "real-sequential on others",
    )


def _choose_order(
    ratios: Ratios, allowed: Orders, where: object
) -> tuple[WordOrder, tuple[str, ...]]:
    """Best allowed order, and notes; UserError where another one contradicts it."""
    one_sided = {order: _one_sided(ratio) for order, ratio in ratios.items()}
    best = _best_order(one_sided)
    chosen = _best_order({order: one_sided[order] for order in allowed})
    if one_sided[best] <= CONTRADICTION * one_sided[chosen]:
        return chosen, ()
    names = [
        str(order) if chosen.n_rx == best.n_rx else f"{order}, {order.n_rx} receivers,"
        for order in (chosen, best)
    ]
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


def _found_samples(
    words: Words, order: WordOrder, given: int | None, where: object
) -> tuple[int | None, float]:
    """Return the samples per chirp, and the jumps there; UserError where packets are missing."""
    found, jump = find_n_samples(words, order, None)
    if found is None or found != given:
        found = _of_most_parts(words, order, len(words)) or found
        short = _of_most_parts(words, order, _FEW_WORDS)
        is_cut = found is not None and short is not None and found % short > 0
        if found != given and (is_cut or jumps_with_packets(words, order, found)):
            raise packets_are_missing(where)
    return found, jump


def _of_most_parts(words: Words, order: WordOrder, n_words: int) -> int | None:
    """Return the samples per chirp that most parts of the words have; None where they differ."""
    # n_words: of all parts. Behind a missing packet chirps begin elsewhere, so that none may be
    # seen in longer parts, or losses at equal distances are taken for the ends of chirps.
    size = n_words // _N_PARTS // 64 * 64
    starts = [k * len(words) // _N_PARTS // 64 * 64 for k in range(_N_PARTS)]
    parts = [words[start : start + size] for start in starts]
    found = [late[0] for part in parts if (late := find_late_chirps(part, order))]
    n_samples, count = Counter(found).most_common(1)[0] if found else (None, 0)
    return n_samples if 2 * count >= _N_PARTS else None


def _require_possible(
    words: Words, layout: Layout | None, n_rx: int | None, n_samples: int | None, where: object
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
    require_words(words, where)
    if layout == "2-lane-pairs" and n_rx is not None and n_rx % 2:
        raise UserError(what="2-lane-pairs needs an even n_rx", where=where, got=n_rx)
    if n_samples is not None and n_samples < _MIN_SAMPLES:
        raise UserError(
            what="too few samples per chirp",
            where=where,
            expected=f"{_MIN_SAMPLES} or more",
            got=n_samples,
        )
    _require_pairs(layout, n_samples, where)


def _require_pairs(layout: Layout | None, n_samples: int | None, where: object) -> None:
    if layout == "2-lane-sequential" and n_samples is not None and n_samples % 2:
        raise UserError(
            what="2-lane-sequential needs an even number of samples", where=where, got=n_samples
        )


def _best_order(one_sided: dict[WordOrder, float]) -> WordOrder:
    best = max(one_sided, key=lambda order: one_sided[order])
    enough = max(MIN_RATIO, _FASTER_SHARE * one_sided[best])
    for order in sorted(one_sided, key=lambda order: order.n_alternating):
        is_kin = order.offset_binary == best.offset_binary
        is_slower = order.n_alternating < best.n_alternating
        if is_kin and is_slower and one_sided[order] >= enough:
            return order
    return best


def _with_samples(
    words: Words, chosen: WordOrder, ratios: Ratios, n_samples: int | None, where: object
) -> LayoutEvidence:
    _require_pairs(chosen.layout, n_samples, where)
    found, jump = _found_samples(words, chosen, n_samples, where)
    late = 0
    if n_samples is None:
        if found is None:
            found, late = find_late_chirps(words, chosen) or (None, 0)
        if found is None:
            raise UserError(
                what="the number of samples per chirp cannot be found out: the signal jumps "
                f"nowhere regularly ({jump:.3g} times the mean at best)",
                where=where,
                expected=f"{MIN_JUMP:g} times or more where a chirp ends",
                hint="give n_samples in --radar, or the radar's --config",
            )
        n_samples = found
    elif found is not None and found != n_samples:
        _, given_jump = find_n_samples(words, chosen, n_samples)
        if jump > CONTRADICTION * given_jump or n_samples % found == 0:
            raise UserError(
                what="the samples contradict the number of samples per chirp",
                where=where,
                expected=f"{found}, where the signal jumps {jump:.3g} times as much as elsewhere",
                got=f"{n_samples} ({given_jump:.3g} times)",
                hint="correct n_samples, or leave it out to have it found",
            )
    else:
        _, jump = find_n_samples(words, chosen, n_samples)
    if n_samples % chosen.per_complex:
        what = "an odd number of real samples per chirp is not read"
        raise UserError(what=what, where=where, got=n_samples)
    is_found, n_samples = found == n_samples, n_samples // chosen.per_complex
    # Swapping I and Q mirrors the spectrum.
    order = replace(chosen, swap_iq=bool(ratios) and ratios[chosen] < 1)
    n_chirps = words.size // (2 * order.n_rx * n_samples)
    whole = words[: n_chirps * 2 * order.n_rx * n_samples]
    # Layouts with more alternating receivers are the same samples at a lower rate.
    others = {
        other: _one_sided(ratio)
        for other, ratio in ratios.items()
        if other.layout != chosen.layout and other.n_alternating <= chosen.n_alternating
    }
    runner_up = max(others, key=lambda other: others[other], default=None)
    return LayoutEvidence(
        order=order,
        n_samples=n_samples,
        energy_ratio=np.inf if order.is_real else _ratio(decode(whole, order, n_samples)),
        next_layout="" if runner_up is None else str(runner_up),
        next_ratio=0.0 if runner_up is None else others[runner_up],
        jump_ratio=jump,
        n_samples_found=is_found,
        late=late,
    )
