"""Parts of a byte stream that are no samples: headers of chirps, and zeros at either end.

The stream configuration of TI's demos (`lvdsStreamCfg -1 1 ...`) puts 64 bytes before each chirp.
They begin with the words 0ADC and 0CDA, twice each, in an order that depends on the lanes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Ints
from geraf2.errors import UserError

CHIRP_HEADER_BYTES = 64
_SYNC_WORDS, _N_SYNC = (0x0ADC, 0x0CDA), 4
_SCAN_BYTES = 1 << 20
# Zeros beyond are no padding: 1 GiB, 10 s of a board at full rate.
_MAX_ZEROS = 1 << 30


class ByteStream(Protocol):
    """Bytes of a recording, read at any position."""

    @property
    def n_bytes(self) -> int:
        """Number of bytes."""

    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        """Fill `out` (n_bytes,) with the bytes from `start` on."""


@dataclass(frozen=True, kw_only=True)
class StreamPart:
    """Bytes of another stream from `start` to `stop`."""

    base: ByteStream
    start: int
    stop: int

    @property
    def n_bytes(self) -> int:
        """Number of bytes."""
        return self.stop - self.start

    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        """Fill `out` (n_bytes,) with the bytes from `start` on."""
        self.base.read_into(self.start + start, out)

    def __str__(self) -> str:
        return str(self.base)


@dataclass(frozen=True, kw_only=True)
class ChirpHeaderStream:
    """Samples of a stream that has a header at every `period` bytes."""

    base: ByteStream
    period: int

    @property
    def payload(self) -> int:
        """Bytes of samples between two headers."""
        return self.period - CHIRP_HEADER_BYTES

    @property
    def n_bytes(self) -> int:
        """Number of bytes of samples."""
        full, rest = divmod(self.base.n_bytes, self.period)
        return full * self.payload + max(0, rest - CHIRP_HEADER_BYTES)

    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        """Fill `out` (n_bytes,) with the samples from byte `start` on."""
        first, stop = start // self.payload, -(-(start + len(out)) // self.payload)
        raw = np.zeros((stop - first) * self.period, dtype=np.uint8)
        n_bytes = min(len(raw), self.base.n_bytes - first * self.period)
        self.base.read_into(first * self.period, raw[:n_bytes])
        slots = raw.reshape(-1, self.period)
        heads = np.ascontiguousarray(slots[:, : 2 * _N_SYNC]).view("<u2")
        is_header = _is_sync(heads)
        if not is_header.all():
            raise UserError(
                what=f"chirp {first + int(np.argmin(is_header))} has no header as those before it",
                where=self,
                expected=f"{CHIRP_HEADER_BYTES} bytes before each chirp",
                hint="packets were lost: record again, or without headers (lvdsStreamCfg -1 0 1 0)",
            )
        samples = slots[:, CHIRP_HEADER_BYTES:].reshape(-1)
        at = start - first * self.payload
        out[:] = samples[at : at + len(out)]

    def __str__(self) -> str:
        return str(self.base)


def _is_sync(words: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Whether rows (n, 4) hold each sync word twice."""
    first, second = ((words == word).sum(axis=1) for word in _SYNC_WORDS)
    return np.asarray((first == 2) & (second == 2))


def without_chirp_headers(stream: ByteStream) -> tuple[ByteStream, list[str]]:
    """Stream without headers of chirps, and notes on what was removed."""
    head = np.zeros(min(stream.n_bytes, _SCAN_BYTES) // 2 * 2, dtype=np.uint8)
    stream.read_into(0, head)
    words = head.view("<u2")
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
        base = StreamPart(base=stream, start=first, stop=stream.n_bytes)
    return ChirpHeaderStream(base=base, period=period), notes


def _sync_starts(words: NDArray[np.uint16]) -> Ints:
    is_word = np.isin(words, _SYNC_WORDS)
    runs = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(is_word, _N_SYNC).all(axis=1))
    rows = words[runs[:, None] + np.arange(_N_SYNC)]
    return np.asarray(runs[_is_sync(rows)], dtype=np.int64)


def leading_zeros(stream: ByteStream) -> int:
    """Count the bytes of padding before the samples; UserError where all are zero.

    Zeros of a dead receiver, or of a weak signal, are samples: as many follow again soon.
    """
    for start, block in _blocks(stream, range(0, min(stream.n_bytes, _MAX_ZEROS), _SCAN_BYTES)):
        if block.any():
            n_zeros = start + int(np.argmax(block != 0)) // 2 * 2
            size = min(_SCAN_BYTES, stream.n_bytes - n_zeros) // 2 * 2
            after = np.zeros(size, dtype=np.uint8)
            stream.read_into(n_zeros, after)
            longest = np.diff(np.flatnonzero(after.view("<i2"))).max(initial=2)
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
    for first in firsts:
        block = np.zeros(min(_SCAN_BYTES, stream.n_bytes - first), dtype=np.uint8)
        stream.read_into(first, block)
        yield first, block
