"""Parts of a byte stream that are no samples: headers of chirps, and zeros at either end.

The stream configuration of TI's demos (`lvdsStreamCfg -1 1 ...`) puts 64 bytes before each chirp.
They begin with the words 0ADC and 0CDA, twice each, in an order that depends on the lanes.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Ints
from geraf2.errors import UserError

CHIRP_HEADER_BYTES = 64
_SYNC_WORDS, _N_SYNC = (0x0ADC, 0x0CDA), 4
_SCAN_BYTES = 1 << 20
# Zeros beyond are no padding: 1 GiB, 10 s of a board at full rate.
_MAX_ZEROS = 1 << 30


class ByteStream(ABC):
    """Bytes of a recording, read at any position."""

    n_bytes: int

    @abstractmethod
    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        """Fill `out` (n_bytes,) with the bytes from `start` on."""

    def read(self, start: int, most: int) -> NDArray[np.uint8]:
        """At most so many bytes from `start` on."""
        out = np.empty(min(most, self.n_bytes - start), dtype=np.uint8)
        self.read_into(start, out)
        return out


class StreamPart(ByteStream):
    """Bytes of another stream from `start` on."""

    def __init__(self, base: ByteStream, start: int) -> None:
        self._base, self._start, self.n_bytes = base, start, base.n_bytes - start

    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        self._base.read_into(self._start + start, out)

    def __str__(self) -> str:
        return str(self._base)


class ChirpHeaderStream(ByteStream):
    """Samples of a stream that has a header at every `period` bytes."""

    def __init__(self, base: ByteStream, period: int) -> None:
        self._base, self._period, self._payload = base, period, period - CHIRP_HEADER_BYTES
        full, rest = divmod(base.n_bytes, period)
        self.n_bytes = full * self._payload + max(0, rest - CHIRP_HEADER_BYTES)

    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        first, stop = start // self._payload, -(-(start + len(out)) // self._payload)
        raw = np.zeros((stop - first) * self._period, dtype=np.uint8)
        n_bytes = min(len(raw), self._base.n_bytes - first * self._period)
        self._base.read_into(first * self._period, raw[:n_bytes])
        slots = raw.reshape(-1, self._period)
        is_header = _is_sync(np.ascontiguousarray(slots[:, : 2 * _N_SYNC]).view("<u2"))
        if not is_header.all():
            raise UserError(
                what=f"chirp {first + int(np.argmin(is_header))} has no header as those before it",
                where=self._base,
                expected=f"{CHIRP_HEADER_BYTES} bytes before each chirp",
                hint="packets were lost: record again, or without headers (lvdsStreamCfg -1 0 1 0)",
            )
        at = start - first * self._payload
        out[:] = slots[:, CHIRP_HEADER_BYTES:].reshape(-1)[at : at + len(out)]

    def __str__(self) -> str:
        return str(self._base)


class PlaceStream(ByteStream):
    """Concatenation of the first `bytes_per_place` bytes of each file."""

    def __init__(self, files: Sequence[ByteStream], bytes_per_place: int) -> None:
        self._files, self._per_place = files, bytes_per_place
        self.n_bytes = len(files) * bytes_per_place

    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        at = 0
        while at < len(out):
            place, begin = divmod(start + at, self._per_place)
            n = min(self._per_place - begin, len(out) - at)
            self._files[place].read_into(begin, out[at : at + n])
            at += n


def _is_sync(words: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Whether rows (n, 4) hold each sync word twice."""
    first, second = ((words == word).sum(axis=1) for word in _SYNC_WORDS)
    return np.asarray((first == 2) & (second == 2))


def without_chirp_headers(stream: ByteStream) -> tuple[ByteStream, list[str]]:
    """Stream without headers of chirps, and notes on what was removed."""
    words = stream.read(0, min(stream.n_bytes, _SCAN_BYTES) // 2 * 2).view("<u2")
    if len(words) < _N_SYNC:
        return stream, []
    starts = _sync_starts(words)
    if len(starts) < 2:
        return stream, []
    first, period = 2 * int(starts[0]), 2 * int(starts[1] - starts[0])
    if period <= CHIRP_HEADER_BYTES or (np.diff(starts) != starts[1] - starts[0]).any():
        raise UserError(
            what="has headers of the stream configuration at irregular distances",
            where=stream,
            expected=f"{CHIRP_HEADER_BYTES} bytes before each chirp, or none",
            got=", ".join(f"{2 * step} bytes" for step in np.unique(np.diff(starts))[:3]),
            hint="record the samples alone (lvdsStreamCfg -1 0 1 0)",
        )
    notes = [f"{CHIRP_HEADER_BYTES} bytes before each {period - CHIRP_HEADER_BYTES} were removed"]
    base = stream
    if first:
        notes.append(f"{first} bytes before the first header were left out")
        base = StreamPart(stream, first)
    return ChirpHeaderStream(base, period), notes


def _sync_starts(words: NDArray[np.uint16]) -> Ints:
    is_word = np.isin(words, _SYNC_WORDS)
    runs = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(is_word, _N_SYNC).all(axis=1))
    rows = words[runs[:, None] + np.arange(_N_SYNC)]
    return np.asarray(runs[_is_sync(rows)], dtype=np.int64)


def leading_zeros(stream: ByteStream) -> int:
    """Count the bytes of padding before the samples, which no zeros of a weak signal are."""
    for start, block in _blocks(stream, range(0, min(stream.n_bytes, _MAX_ZEROS), _SCAN_BYTES)):
        if block.any():
            n_zeros = start + int(np.argmax(block != 0)) // 2 * 2
            size = min(_SCAN_BYTES, stream.n_bytes - n_zeros) // 2 * 2
            after = stream.read(n_zeros, size).view("<i2")
            longest = np.diff(np.flatnonzero(after)).max(initial=2)
            return n_zeros if n_zeros > 3 * longest else 0
    raise UserError(what="begins with nothing but zeros", where=stream)


def trailing_zeros(stream: ByteStream) -> int:
    """Count the bytes behind the last that is not zero, up to 1 GiB."""
    n_zeros = 0
    firsts = range((stream.n_bytes - 1) // _SCAN_BYTES * _SCAN_BYTES, -1, -_SCAN_BYTES)
    for _, block in _blocks(stream, firsts):
        if block.any():
            return n_zeros + int(np.argmax(block[::-1] != 0))
        if n_zeros > _MAX_ZEROS:
            break
        n_zeros += len(block)
    return n_zeros


def _blocks(stream: ByteStream, firsts: range) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    yield from ((first, stream.read(first, _SCAN_BYTES)) for first in firsts)
