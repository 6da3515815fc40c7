"""Byte stream of a raw capture: joined files of one recording, without packet headers.

A DCA1000 sends UDP packets: u32 sequence number from 1, six bytes that count the payload bytes
sent before, payload. Some recorders add u32 length before the count, or four bytes behind it. Kept
headers reveal lost packets: the byte count gives the position of the payload, and lost payload is
zero. The stream configuration of TI's demos (`lvdsStreamCfg -1 1 ...`) puts 64 bytes before each
chirp. They begin with the words 0ADC and 0CDA, twice each, in an order that depends on the lanes.
"""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Bytes, Ints
from geraf2.apps.importers._rows import note_omission
from geraf2.errors import UserError
from geraf2.io.regular import open_regular

CHIRP_HEADER_BYTES = 64
_SYNC_WORDS, _N_SYNC = (0x0ADC, 0x0CDA), 4
_SCAN_BYTES = 1 << 20
# Zeros beyond are no padding: 1 GiB, 10 s of a board at full rate.
_MAX_ZEROS = 1 << 30


class ByteStream(ABC):
    """Bytes of a recording, read at any position; as text the name of its file."""

    def __init__(self, n_bytes: int, where: object) -> None:
        self.n_bytes, self._where = n_bytes, where

    @abstractmethod
    def read_into(self, start: int, out: Bytes) -> None:
        """Fill `out` (n_bytes,) with the bytes from `start` on."""

    def read(self, start: int, most: int) -> Bytes:
        """At most so many bytes from `start` on."""
        out = np.empty(min(most, self.n_bytes - start), dtype=np.uint8)
        self.read_into(start, out)
        return out

    def __str__(self) -> str:
        return str(self._where)


class FileStream(ByteStream):
    """Bytes of a file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.stat().st_size, path)
        self._path = path

    def read_into(self, start: int, out: Bytes) -> None:
        with open_regular(self._path) as handle:
            handle.seek(start)
            if handle.readinto(out.data) < len(out):
                raise UserError(what="the file became shorter while it was read", where=self._path)


class ZeroStream(ByteStream):
    """Zeros, in the place of what was lost."""

    def read_into(self, start: int, out: Bytes) -> None:
        out[:] = 0


class StreamPart(ByteStream):
    """Bytes of another stream from `start` on, all or so many."""

    def __init__(self, base: ByteStream, start: int, n_bytes: int | None = None) -> None:
        super().__init__(base.n_bytes - start if n_bytes is None else n_bytes, base)
        self._base, self._start = base, start

    def read_into(self, start: int, out: Bytes) -> None:
        self._base.read_into(self._start + start, out)


class JoinedStream(ByteStream):
    """Streams one after the other, named as the first."""

    def __init__(self, parts: Sequence[ByteStream]) -> None:
        self._parts = parts
        self._ends = np.cumsum([part.n_bytes for part in parts], dtype=np.int64)
        super().__init__(int(self._ends[-1]), parts[0])

    def read_into(self, start: int, out: Bytes) -> None:
        at = 0
        while at < len(out):
            number = int(np.searchsorted(self._ends, start + at, side="right"))
            part, left = self._parts[number], int(self._ends[number]) - start - at
            n = min(left, len(out) - at)
            part.read_into(part.n_bytes - left, out[at : at + n])
            at += n


class ChirpHeaderStream(ByteStream):
    """Samples of a stream that has a header at every `period` bytes."""

    def __init__(self, base: ByteStream, period: int) -> None:
        self._base, self._period, self._payload = base, period, period - CHIRP_HEADER_BYTES
        full, rest = divmod(base.n_bytes, period)
        super().__init__(full * self._payload + max(0, rest - CHIRP_HEADER_BYTES), base)

    def read_into(self, start: int, out: Bytes) -> None:
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


def _is_sync(words: NDArray[np.uint16]) -> Bools:
    """Whether rows (n, 4) hold each sync word twice."""
    first, second = ((words == word).sum(axis=1) for word in _SYNC_WORDS)
    return np.asarray((first == 2) & (second == 2))


def remove_chirp_headers(stream: ByteStream) -> tuple[ByteStream, list[str]]:
    """Stream without headers of chirps, and notes on what was removed."""
    words = stream.read(0, min(stream.n_bytes, _SCAN_BYTES) // 2 * 2).view("<u2")
    if len(words) < _N_SYNC:
        return stream, []
    is_word = np.isin(words, _SYNC_WORDS)
    runs = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(is_word, _N_SYNC).all(axis=1))
    starts = runs[_is_sync(words[runs[:, None] + np.arange(_N_SYNC)])]
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


def leading_zeros(stream: ByteStream) -> int:
    """Count the bytes of padding before the samples, which no zeros of a weak signal are."""
    for start in range(0, min(stream.n_bytes, _MAX_ZEROS), _SCAN_BYTES):
        block = stream.read(start, _SCAN_BYTES)
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
    for start in range((stream.n_bytes - 1) // _SCAN_BYTES * _SCAN_BYTES, -1, -_SCAN_BYTES):
        block = stream.read(start, _SCAN_BYTES)
        if block.any():
            return n_zeros + int(np.argmax(block[::-1] != 0))
        if n_zeros > _MAX_ZEROS:
            break
        n_zeros += len(block)
    return n_zeros


# Bytes of a header, and where its byte count begins.
_HEADERS = ((10, 4), (14, 8), (14, 4))
_MAX_HEADER_BYTES = 14
# 1456 is what the board sends; a jumbo frame is the largest that Ethernet carries.
_MIN_PAYLOAD, _MAX_PAYLOAD = 46, 9000
_PACKET_SCAN_BYTES = 1 << 24
# Names that mmWave Studio and the DCA1000 command line give to the parts of one recording.
_STUDIO_PART = re.compile(r".*_Raw_\d+", re.IGNORECASE)
# Files of a TI cascade (MMWCAS): master_0000_data.bin, slave1_0000_data.bin, or by numbers of the
# chips, and _idx.bin of each.
_CHIP = re.compile(
    r"(?:.*[^a-z])?(master|slave\d*|dev\d+|device\d+|chip\d+)(?:[^a-z].*)?", re.IGNORECASE
)
_INDEX = re.compile(r".*_idx", re.IGNORECASE)
MAX_NAMED = 4
# A gap beyond this is a broken header and no loss: 1 GiB, 10 s of a board at full rate.
_MAX_GAP_BYTES = 1 << 30


class Packets(NamedTuple):
    """Sizes of packets [bytes]."""

    payload: int
    header: int
    count_at: int
    """Where the byte count begins in a header."""


class PacketStream(ByteStream):
    """Payload of packets at the positions in their headers; lost payload reads as zero."""

    def __init__(self, plain: ByteStream, packets: Packets, *, keep_good: bool) -> None:
        self._plain = plain
        self._payload, self._header, self._count_at = packets
        payload_bytes, header_bytes, _ = packets
        self._step = payload_bytes + header_bytes
        full, rest = divmod(plain.n_bytes, self._step)
        self._n_slots = full + (rest > header_bytes)
        self._last_bytes = rest - header_bytes if rest > header_bytes else payload_bytes
        sequence, n_good = self._read_headers()
        self.notes: tuple[str, ...] = ()
        if n_good < self._n_slots:
            text = note_omission(
                f"packet {n_good} of {self._n_slots} has a broken header",
                keep_good,
                plain,
                expected="sequence number and byte count to increase together",
                hint="--keep-good keeps the packets before it",
            )
            self.notes = (f"{text}; it and what follows were left out",)
        sequence = sequence[:n_good]
        n_late = int((sequence[1:] < sequence[:-1]).sum())
        # Packets in the order of their numbers; the first of repeated ones is used.
        self._sequence, self._slots = np.unique(sequence, return_index=True)
        last_is_short = int(self._slots[-1]) == self._n_slots - 1
        size = self._last_bytes if last_is_short else payload_bytes
        total = int(self._sequence[-1]) + 1
        super().__init__((total - 1) * payload_bytes + size, plain)
        self.n_lost = total - len(self._sequence)
        share = f"{self.n_lost} lost ({100 * self.n_lost / total:.2g} %)"
        self.loss = f"{len(self._sequence)} packets, {share}"
        """Numbers of received and lost packets, by their headers."""
        if self.n_lost:
            self.loss += f", {self.n_lost * payload_bytes} bytes zero-filled"
        if n_late:
            self.loss += f", {n_late} out of order and put in order"

    def read_into(self, start: int, out: Bytes) -> None:
        stop = start + len(out)
        first = int(np.searchsorted(self._sequence, start // self._payload))
        last = int(np.searchsorted(self._sequence, -(-stop // self._payload)))
        numbers = self._sequence[first:last].astype(np.int64)
        slots = self._slots[first:last].astype(np.int64)
        if len(numbers) * self._payload < len(out):
            out[:] = 0
        breaks = np.flatnonzero((np.diff(numbers) != 1) | (np.diff(slots) != 1)) + 1
        for run in np.split(np.arange(len(numbers)), breaks):
            if not len(run):
                continue
            payload = self._read_slots(int(slots[run[0]]), len(run))
            at = int(numbers[run[0]]) * self._payload
            begin, end = max(at, start), min(at + len(payload), stop)
            out[begin - start : end - start] = payload[begin - at : end - at]

    def _read_slots(self, first: int, n_slots: int) -> Bytes:
        """Payload of packets that follow each other in the file, (n_bytes,)."""
        missing = self._payload - self._last_bytes if first + n_slots == self._n_slots else 0
        raw = np.zeros(n_slots * self._step, dtype=np.uint8)
        self._plain.read_into(first * self._step, raw[: len(raw) - missing])
        payload = raw.reshape(n_slots, self._step)[:, self._header :].reshape(-1)
        return payload[: len(payload) - missing]

    def _read_headers(self) -> tuple[NDArray[np.uint32], int]:
        """Numbers of all packets from 0, and the number before the first broken header."""
        sequence = np.empty(self._n_slots, dtype=np.uint32)
        per_block = max(1, _PACKET_SCAN_BYTES // self._step)
        block = np.zeros(per_block * self._step, dtype=np.uint8)
        for first in range(0, self._n_slots, per_block):
            n_slots = min(per_block, self._n_slots - first)
            n_bytes = min(n_slots * self._step, self._plain.n_bytes - first * self._step)
            self._plain.read_into(first * self._step, block[:n_bytes])
            packets = block[: n_slots * self._step].reshape(n_slots, self._step)
            numbers, counts = _headers(packets, self._count_at)
            here = numbers - 1
            good = (counts == here * self._payload) & (here >= 0)
            good &= here * self._payload < self._n_slots * self._payload + _MAX_GAP_BYTES
            if not good.all():
                bad = int(np.argmin(good))
                sequence[first : first + bad] = here[:bad]
                return sequence, first + bad
            sequence[first : first + n_slots] = here
        return sequence, self._n_slots


def _headers(packets: Bytes, count_at: int) -> tuple[Ints, Ints]:
    """Sequence numbers and byte counts of packets (n_packets, n_bytes)."""
    numbers = np.ascontiguousarray(packets[:, :4]).view("<u4")[:, 0].astype(np.int64)
    wide = np.zeros((len(packets), 8), dtype=np.uint8)
    wide[:, :6] = packets[:, count_at : count_at + 6]
    return numbers, wide.view("<i8")[:, 0]


def find_packets(plain: ByteStream) -> Packets | None:
    """Sizes of the packets, from the first two headers; None where the file has none."""
    head = plain.read(0, 2 * (_MAX_PAYLOAD + _MAX_HEADER_BYTES))
    for header, count_at in _HEADERS:
        payload = _payload_of(head, header, count_at)
        if payload is not None:
            return Packets(payload, header, count_at)
    return None


def _payload_of(head: Bytes, header: int, count_at: int) -> int | None:
    """Payload of each packet, if its header has this size and its byte count begins there."""
    if len(head) < header + _MIN_PAYLOAD:
        return None
    (first,), (first_count,) = _headers(head[None, :header], count_at)
    if first == 1 and first_count == 0:
        candidates = range(_MIN_PAYLOAD, _MAX_PAYLOAD + 1)
    elif first > 1 and first_count % (first - 1) == 0:  # the first packets were lost
        payload = int(first_count // (first - 1))
        candidates = range(payload, payload + 1)
    else:
        return None
    for payload in candidates:
        at = payload + header
        if payload < _MIN_PAYLOAD or at + header > len(head):
            break
        (number,), (count,) = _headers(head[None, at : at + header], count_at)
        # A few packets may be lost between the first and the second of the file.
        if number > first and count == (number - 1) * payload:
            return payload
    return None


def bin_files(folder: Path) -> list[Path]:
    """All .bin files of a folder; UserError without any."""
    files = [path for path in folder.glob("*.bin") if path.is_file()]
    # A cascade writes the offsets of its frames beside them.
    files = [path for path in files if not _INDEX.fullmatch(path.stem)]
    if not files:
        raise UserError(what="has no .bin file", where=folder, expected="adc_data.bin, or _0, _1")
    chips = {match[1].lower() for path in files if (match := _CHIP.fullmatch(path.stem))}
    if len(chips) > 1:
        raise UserError(
            what=f"is of a cascade of {len(chips)} chips, which record the same frames: "
            f"{', '.join(sorted(chips))}",
            where=folder,
            expected="the files of one chip",
            hint=f"name one file, as {min(files).name}, and give the places of its receivers "
            "as rx_offsets_m under [antennas] of --radar",
        )
    return files


def recording_files(source: Path) -> tuple[list[Path], list[str]]:
    """Files of one recording, and notes: `source` itself, or the parts in a folder, in order.

    Parts are numbered, of one size, the last is shorter; UserError for separate captures.
    """
    if not source.exists():
        raise UserError(what="no such file or folder", where=source)
    if source.is_file():
        return [source], []
    files = bin_files(source)
    if len(files) == 1:
        return files, []
    numbered = {path: re.fullmatch(r"(.*?)(\d+)", path.stem) for path in files}
    files = sorted(files, key=lambda path: (int(m[2]) if (m := numbered[path]) else 0, path.name))
    more = ["..."] if len(files) > MAX_NAMED else []
    names = ", ".join([*(path.name for path in files[:MAX_NAMED]), *more])
    reason = _why_separate(files, numbered)
    if reason:
        raise UserError(
            what=f"holds more than one recording ({reason}): {names}",
            where=source,
            hint="name one file, or give --file-per-position where each is of one position",
        )
    if all(_STUDIO_PART.fullmatch(path.stem) for path in files):
        return files, []
    return files, [f"{len(files)} files were joined as the parts of one recording: {names}"]


def _why_separate(files: list[Path], numbered: Mapping[Path, re.Match[str] | None]) -> str | None:
    """Reason why files are not the parts of one recording; None if they are."""
    matches = [match for path in files if (match := numbered[path])]
    if len(matches) < len(files) or len({match[1] for match in matches}) > 1:
        return "the names differ in more than a last number"
    numbers = [int(match[2]) for match in matches]
    if numbers != list(range(numbers[0], numbers[0] + len(numbers))):
        return "the numbers in the names do not follow each other"
    *sizes, last = (path.stat().st_size for path in files)
    if len(set(sizes)) > 1 or last > sizes[0]:
        return "parts are of one size, but for a smaller last one"
    if last == sizes[0] and not all(_STUDIO_PART.fullmatch(path.stem) for path in files):
        return "all are of one size, where the last part of a recording is smaller"
    if all(map(_begins_anew, files[1:])):
        return "the packet numbers begin anew in each"
    return None


def _begins_anew(path: Path) -> bool:
    """Whether a file begins with the first packet of a capture."""
    plain = FileStream(path)
    packets = find_packets(plain)
    if packets is None:
        return False
    (number,), _ = _headers(plain.read(0, packets.header)[None], packets.count_at)
    return bool(number == 1)


def position_files(source: Path, names: Sequence[str] | None) -> list[Path]:
    """Files of the positions, in their order.

    source: folder of the files.
    names: file of each position; None: all *.bin, by the numbers in their names.
    """
    if not source.is_dir():
        raise UserError(what="is no folder with one file for each position", where=source)
    if names is None:
        return sorted(bin_files(source), key=_by_numbers)
    bad = [name for name in names if not name or Path(name).name != name or "\\" in name]
    if bad:
        raise UserError(
            what="a file of the positions is not named plainly",
            where=source,
            expected="names of files in this folder",
            got=repr(bad[0]),
        )
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError(what="two positions name the same file", where=source, got=twice[0])
    missing = [name for name in names if not (source / name).is_file()]
    if missing:
        raise UserError(
            what=f"{len(missing)} of {len(names)} files that the positions name are not there",
            where=source,
            got=", ".join(missing[:MAX_NAMED]),
        )
    return [source / name for name in names]


def _by_numbers(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Sort key in which scan_2 comes before scan_10."""
    parts = re.findall(r"\d+|\D+", path.stem)
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts)
