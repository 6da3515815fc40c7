"""Packets that are missing from a recording without headers, with nothing in their place.

The signal jumps where a chirp begins. Behind a missing packet the chirps begin at another sample,
which is looked for at places all over the recording; where it changes, the packets in between are
searched. As many packets are taken to be missing as the smallest number that shifts the chirps so.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from geraf2._types import Words
from geraf2.apps.importers._raw_stream import ByteStream, JoinedStream, StreamPart, ZeroStream
from geraf2.apps.importers._word_order import (
    MIN_JUMP,
    WordOrder,
    chirp_phase,
    signal_jumps,
    words_per_sample,
)
from geraf2.errors import UserError

# Bytes of samples in a packet of the DCA1000.
PAYLOAD_BYTES = 1456
# Places at which the beginning of the chirps is looked for, and chirps at each.
_N_PROBES, _N_CHIRPS = 64, 32
# More losses than a quarter of the places are not told from each other.
_MAX_LOSSES = _N_PROBES // 4
# Captures that are joined, with other places where chirps begin elsewhere than packets explain.
_MAX_JOINED = 4
# Packets that are lost at once; more shift the chirps as captures do that were joined.
_MAX_PACKETS = 16
# Share of the packets that begin with a jump, over that of all samples which are one, from which on
# packets are missing everywhere.
_MIN_SHARE, _MIN_EXCESS = 0.15, 4.0
# Jumps for each chirp or packet from which on there are others, and samples of a single jump.
_MIN_RUNS, _RUN = 1.25, 8


class Gap(NamedTuple):
    """Place behind which chirps begin elsewhere."""

    at: int
    """Byte of the file."""
    n_packets: int
    """Missing packets; 0 where none explain it."""
    late: int
    """Sample as stored at which chirps begin from there on."""
    is_seen: bool = True
    """Whether a jump shows the place."""


def repaired_stream(base: ByteStream, gaps: Sequence[Gap]) -> ByteStream:
    """Stream with zeros in place of what is missing."""
    parts, at = list[ByteStream](), 0
    for gap in gaps:
        zeros = ZeroStream(gap.n_packets * PAYLOAD_BYTES, base)
        parts += [StreamPart(base, at, gap.at - at), zeros]
        at = gap.at
    return JoinedStream([*parts, StreamPart(base, at)])


def find_gaps(
    stream: ByteStream, order: WordOrder, n_samples: int, n_bytes: int
) -> tuple[int, list[Gap]]:
    """Find the sample at which the first chirp begins, and what is missing from the stream.

    n_samples: complex samples of a chirp.
    n_bytes: bytes before the zeros at the end of the stream.

    UserError where more is missing than can be told.
    """
    chirps = _Chirps(stream, order, n_samples)
    n_probes = max(1, min(_N_PROBES, n_bytes // chirps.probe_bytes))
    last = max(0, n_bytes - chirps.probe_bytes)
    starts = np.linspace(0, last, n_probes).astype(int).tolist()
    if n_probes > 1:  # a loss before the last place is seen twice
        starts.insert(-1, max(starts[-2], last - chirps.probe_bytes // 2))
    found = [(start, chirps.phase(start)) for start in starts]
    known = [(start, phase) for start, phase in found if phase is not None]
    if 2 * len(known) < len(found):
        words = stream.read(0, min(n_bytes, 1 << 21) // 16 * 16).view("<i2")
        if jumps_with_packets(words, order):
            raise packets_are_missing(stream)
    # One place between two of the same beginning errs, as losses seldom cancel; and one between
    # others where half a window before and after it the chirps do not begin so, either.
    half = chirps.probe_bytes // 2
    odd = [
        place
        for before, place, after in zip(known, known[1:], known[2:], strict=False)
        if place[1] not in (before[1], after[1])
        and (
            before[1] == after[1]
            or place[1] not in map(chirps.phase, (place[0] - half, place[0] + half))
        )
    ]
    known = [place for place in known if place not in odd]
    if known[-2:-1] and known[-2][1] != known[-1][1]:
        known.pop()
    if not known:
        return 0, []
    if known[0][1]:
        at, is_seen = chirps.place(0, 0, 0, known[0][1])
        if at > 0 and is_seen:  # it begins with a chirp, and a gap lies in the first window
            known.insert(0, (0, 0))
    changes = [pair for pair in pairwise(known) if pair[0][1] != pair[1][1]]
    if len(changes) > _MAX_LOSSES:
        raise packets_are_missing(stream)
    late, gaps = known[0][1], list(chirps.gaps(changes))
    if late and chirps.n_missing(0, late) == 1:  # the first packet
        whole = chirps.whole([Gap(0, 1, late), *gaps])
        if whole[0].n_packets == 1:
            return 0, whole
    return late, chirps.whole(gaps)


def jumps_with_packets(words: Words, order: WordOrder, n_samples: int | None = None) -> bool:
    """Whether the signal jumps between packets much more often than elsewhere, but there as well.

    n_samples: samples as stored of a chirp as they were found; of real chirps the signal jumps
        nowhere else.
    """
    jumps = signal_jumps(words, order)
    step = PAYLOAD_BYTES // (2 * words_per_sample(order))
    strong = jumps > MIN_JUMP**2 * np.median(jumps)
    n_runs = int((np.diff(np.flatnonzero(strong)) > _RUN).sum())
    share = float(strong[step::step].mean()) if len(jumps) > step else 0.0
    is_excess = share > max(_MIN_SHARE, _MIN_EXCESS * float(strong.mean()))
    return is_excess and n_runs > _MIN_RUNS * len(jumps) / (n_samples or step)


def packets_are_missing(where: object) -> UserError:
    """UserError for a recording that lacks packets everywhere."""
    return UserError(
        what=f"packets are missing at many places: the signal jumps every {PAYLOAD_BYTES} bytes, "
        "the payload of a packet",
        where=where,
        expected="a recording of all packets",
        hint="record again with fewer bytes per second or a larger receive buffer, or keep the "
        "headers of the packets",
    )


class _Chirps:
    """Beginnings of the chirps in a stream, in samples as stored."""

    def __init__(self, stream: ByteStream, order: WordOrder, n_samples: int) -> None:
        self._stream, self._order, self._n_samples = stream, order, n_samples
        self._n = n_samples * order.per_complex
        self._sample_bytes = 2 * words_per_sample(order)
        self._chirp_bytes = self._n * self._sample_bytes
        self.probe_bytes = _N_CHIRPS * self._chirp_bytes
        self._step = PAYLOAD_BYTES // self._sample_bytes

    def phase(self, start: int) -> int | None:
        """Sample at which chirps begin behind a byte; None where they are not seen to begin."""
        first = start // self._chirp_bytes * self._chirp_bytes
        words = self._stream.read(first, self.probe_bytes).view("<i2")
        return chirp_phase(words, self._order, self._n_samples)

    def n_missing(self, before: int, after: int) -> int:
        """Least number of packets without which chirps begin elsewhere; 0 where none does."""
        shift = (before - after) % self._n
        numbers = range(1, _MAX_PACKETS + 1)
        fitting = (k for k in numbers if (k * self._step - shift) % self._n == 0)
        return next(fitting, 0) if PAYLOAD_BYTES % self._sample_bytes == 0 else 0

    def gaps(self, changes: Sequence[tuple[tuple[int, int], tuple[int, int]]]) -> Iterator[Gap]:
        """Missing packets between places at which chirps begin at different samples.

        Where no number of packets shifts the chirps so, none is stated.
        """
        for (low, before), (high, after) in changes:
            n_packets = self.n_missing(before, after)
            at, is_seen = self.place(low, high, before, after) if n_packets else (0, False)
            yield Gap(at or high, n_packets if at else 0, after, is_seen)

    def whole(self, gaps: list[Gap]) -> list[Gap]:
        """Gaps that make the stream a whole number of chirps; none of known length otherwise.

        Numbers of packets that shift chirps alike may shift receivers otherwise. Most places must
        be seen: captures are joined anywhere.
        """
        if 2 * sum(gap.is_seen for gap in gaps) < len(gaps):
            return [gap._replace(n_packets=0) for gap in gaps]
        n_bytes, whole = self._stream.n_bytes, self._chirp_bytes * self._order.n_rx
        whole //= self._order.n_alternating
        period = self._n // math.gcd(self._step, self._n)
        for more in range(0, _MAX_PACKETS, period) if len(gaps) == 1 else (0,):
            tried = [gap._replace(n_packets=gap.n_packets + more) for gap in gaps]
            n_lost = sum(gap.n_packets for gap in tried)
            if (n_bytes + n_lost * PAYLOAD_BYTES) % whole == 0 and all(g.n_packets for g in gaps):
                return tried
        if len(gaps) >= _MAX_JOINED:
            raise packets_are_missing(self._stream)
        return [gap._replace(n_packets=0) for gap in gaps]

    def place(self, low: int, high: int, before: int, after: int) -> tuple[int, bool]:
        """Byte of a packet from which on chirps begin elsewhere; and whether they jump there."""
        first, last = low // PAYLOAD_BYTES, high // PAYLOAD_BYTES + 1
        while last - first > 1:
            middle = (first + last) // 2
            is_before = self.phase(middle * PAYLOAD_BYTES) == before
            first, last = (middle, last) if is_before else (first, middle)
        # A window that begins before the gap may have most of its chirps behind it.
        begin = max(0, first - 1) * PAYLOAD_BYTES
        n_bytes = self.probe_bytes + 4 * PAYLOAD_BYTES
        words = self._stream.read(begin, n_bytes // PAYLOAD_BYTES * PAYLOAD_BYTES).view("<i2")
        jumps = signal_jumps(words, self._order)
        jumps = np.log(np.maximum(jumps / np.median(jumps), 1.0))
        numbers = begin // self._sample_bytes + np.arange(len(jumps))
        seen = [np.cumsum(np.where(numbers % self._n == p, jumps, 0)) for p in (before, after)]
        scores = np.append(0, seen[0]) + seen[1][-1] - np.append(0, seen[1])
        # The jump at the gap itself may count for either side.
        places = np.arange(0, len(scores) - _RUN, self._step)
        near = np.max([scores[places + k] for k in range(_RUN)], axis=0)
        best = int(np.argmax(near))
        is_seen = bool(near[best] >= scores.max() - 2 * np.log(MIN_JUMP))
        return begin + int(places[best]) * self._sample_bytes, is_seen
