"""Raw recordings of a TI board: files, order of the words, frames and samples."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from geraf2._types import Array, Complexes, Floats, Words
from geraf2.apps.importers import NO_OPTIONS, ImportOptions
from geraf2.apps.importers._lost_packets import PAYLOAD_BYTES, find_gaps, repaired_stream
from geraf2.apps.importers._raw_facts import dead_receivers, describe, describe_peak, first_chirps
from geraf2.apps.importers._raw_layout import LayoutEvidence, find_layout
from geraf2.apps.importers._raw_stream import (
    MAX_NAMED,
    ByteStream,
    FileStream,
    JoinedStream,
    PacketStream,
    StreamPart,
    find_packets,
    leading_zeros,
    position_files,
    recording_files,
    remove_chirp_headers,
    trailing_zeros,
)
from geraf2.apps.importers._robot_log import read_log
from geraf2.apps.importers._rows import note_omission
from geraf2.apps.importers._ti_config import find_ti_configs, read_ti_configs
from geraf2.apps.importers._ti_values import TiConfig
from geraf2.apps.importers._word_order import Layout, decode, decode_integers, words_per_sample
from geraf2.errors import UserError
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.manifest import RadarManifest
from geraf2.records import Samples

_SAMPLE_BYTES = 4  # I and Q of 16 bits, or two real samples
# Bytes of the file that a thread decodes at a time: 4 MiB take a tenth longer, and below 1 MiB the
# cost of a call shows (bench/python/import_raw.py).
BLOCK_BYTES = 1 << 21
# Bytes at the beginning of the file from which layout and samples per chirp are estimated.
_HEAD_BYTES = 1 << 21
# The beginning of a file of this size suffices for the layout: 16000 samples of each receiver.
_LONG_FILE_BYTES = 1 << 18


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """A raw recording with known layout, without positions."""

    source: Path
    stream: ByteStream
    evidence: LayoutEvidence
    config: TiConfig
    n_tx: int
    n_chirps_per_frame: int
    n_frames: int
    n_positions: int | None = None
    """Number of files, where each is a position."""
    missing_positions: tuple[int, ...] = ()
    """Omitted positions, whose files have a wrong size."""
    notes: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()

    @property
    def frame_bytes(self) -> int:
        """Bytes of one frame."""
        order = self.evidence.order
        chirp = self.evidence.n_samples * order.n_rx * _SAMPLE_BYTES
        return self.n_chirps_per_frame * chirp

    @property
    def decoder(self) -> Floats | None:
        """Matrix that separates transmitters which send together, (n_tx, n_tx); None: none do."""
        found = self.config.transmitters
        if found is None or found.take_turns or found.n_chirps != self.n_tx:
            return None
        return found.decoder

    @cached_property
    def gains(self) -> Complexes | None:
        """Factors of the channels by the configuration, (n_tx, n_rx); None: all are 1."""
        stated, n_rx = self.config.channel_gains, self.evidence.order.n_rx
        if stated is None:
            return None
        gains = np.array(stated[: self.n_tx * n_rx], dtype=np.complex64)
        if len(gains) < self.n_tx * n_rx or not gains.all():
            raise UserError(
                what="compRangeBiasAndRxChanPhase has too few factors, or factors of 0",
                where=self.source,
                expected=f"{self.n_tx} transmitters x {n_rx} receivers",
                got=f"{len(stated)} factors",
                hint="correct the profile, or delete that line to take the channels as they are",
            )
        return None if (gains == 1).all() else gains.reshape(self.n_tx, n_rx)

    @property
    def n_loops(self) -> int:
        """Chirps of each transmitter in a frame."""
        return self.n_chirps_per_frame // self.n_tx

    def read_frames(self, first: int, stop: int, *, integers: bool = False) -> Samples:
        """Read (n_frames, n_loops, n_tx, n_rx, n_samples); with `integers` (..., 2), as stored."""
        raw = self.stream.read(first * self.frame_bytes, (stop - first) * self.frame_bytes)
        read: Callable[..., Samples] = decode_integers if integers else decode
        chirps = read(raw.view("<i2"), self.evidence.order, self.evidence.n_samples)
        chirps = chirps.reshape(stop - first, self.n_loops, self.n_tx, *chirps.shape[1:])
        if integers:
            return chirps
        if self.decoder is not None:
            chirps = np.einsum("tc,flcrn->fltrn", self.decoder.astype(np.float32), chirps)
        return chirps if self.gains is None else np.asarray(chirps * self.gains[..., None])

    def blocks(self, first: int, stop: int, *, step: int = 1) -> Iterator[tuple[int, int]]:
        """Blocks of frames as (first, stop), multiples of `step` where memory allows."""
        n_frames = max(1, BLOCK_BYTES // self.frame_bytes)
        if n_frames >= step:
            n_frames -= n_frames % step
        for at in range(first, stop, n_frames):
            yield at, min(at + n_frames, stop)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Files:
    """Opened files of a recording: one stream, or one for each position."""

    streams: tuple[ByteStream, ...]
    zeros: tuple[int, ...]
    """Bytes of zeros at the beginning of each."""
    names: tuple[str, ...]
    per_position: bool = False
    notes: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()

    def head(self) -> Words:
        """Words at the beginning; several files of the usual size where these are short."""
        size = usual_bytes(self.streams)
        pairs = zip(self.streams, self.zeros, strict=True)
        usual = [pair for pair in pairs if pair[0].n_bytes == size]
        size -= max(zeros for _, zeros in usual)
        n_files = 1 if size >= _LONG_FILE_BYTES else -(-_LONG_FILE_BYTES // max(size, 1))
        n_bytes = min(_HEAD_BYTES, size) // 2 * 2
        parts = [stream.read(zeros, n_bytes) for stream, zeros in usual[:n_files]]
        return np.concatenate(parts).view("<i2")

    def without_zeros(self, frame_bytes: int) -> "_Files":
        """Files less the zeros at their beginning, unless these are whole frames."""
        streams, notes = [], []
        for stream, zeros, name in zip(self.streams, self.zeros, self.names, strict=True):
            is_padding = zeros % frame_bytes > 0
            streams.append(StreamPart(stream, zeros) if is_padding else stream)
            if zeros:
                text = f"the first {zeros} bytes of {name} are zero"
                whole = f", {zeros // frame_bytes} frames in which nothing was recorded"
                notes.append(f"{text} and were left out" if is_padding else f"{text}{whole}")
        return replace(self, streams=tuple(streams), notes=[*self.notes, *notes])


def usual_bytes(files: Sequence[ByteStream]) -> int:
    """Most common size of the files [bytes]; the largest of several."""
    counts = Counter(stream.n_bytes for stream in files)
    return max(counts, key=lambda size: (counts[size], size))


def _odd_positions(
    files: _Files, frame_bytes: int, keep_good: bool, where: Path
) -> tuple[tuple[int, ...], list[str]]:
    """Positions whose number of whole frames is not the usual one, and a note; see `left_out`."""
    n_frames = [stream.n_bytes // frame_bytes for stream in files.streams]
    usual = usual_bytes(files.streams) // frame_bytes
    odd = tuple(position for position, n in enumerate(n_frames) if n != usual)
    if not odd:
        return (), []
    named = ", ".join(f"{files.names[k]} ({n_frames[k]})" for k in odd[:MAX_NAMED])
    text = f"{len(odd)} of {len(n_frames)} files do not hold {usual} frames as the others do"
    note = f"{text}: {named}"
    note_omission(note, keep_good, where, hint="--keep-good leaves these positions out")
    return odd, [f"{note}; left out"]


def open_recording(
    source: Path,
    radar: RadarManifest,
    options: ImportOptions = NO_OPTIONS,
    *,
    stream: ByteStream | None = None,
) -> Recording:
    """Open a recording and estimate its layout; needs neither waveform nor positions.

    stream: words of the recording, where `source` is no raw file.
    """
    config = read_ti_configs(list(options.config) or find_ti_configs(source))
    if stream is None:
        files = _open_files(source, options)
    else:
        files = _Files(streams=(stream,), zeros=(0,), names=(str(stream),))
    head = files.head()
    n_rx = radar.raw.n_rx or config.n_rx
    evidence = _evidence(head, n_rx, radar, config, source)
    n_tx, n_chirps = _frame_structure(radar, config)
    chirp_bytes = evidence.n_samples * evidence.order.n_rx * _SAMPLE_BYTES
    frame_bytes = n_chirps * chirp_bytes
    files = files.without_zeros(frame_bytes)
    notes = [*files.notes, *evidence.notes]
    if n_rx is None and (evidence.order.is_sequential or evidence.order.n_rx == 1):
        notes.append(
            f"n_rx (receivers) is not known and was assumed to be {evidence.order.n_rx}; give it "
            "under [raw] of --radar if there are others, one after the other"
        )
    n_bytes, n_empty = usual_bytes(files.streams), 0
    stream = files.streams[0]
    if not files.per_position:
        stream, n_empty, more = _repaired(stream, evidence, frame_bytes, source)
        notes += more
        n_bytes = stream.n_bytes
    elif evidence.late:
        raise _begins_late(evidence, evidence.late, source)
    if n_empty >= chirp_bytes:
        share = f"{n_empty // chirp_bytes} of {n_bytes // chirp_bytes} chirps"
        text = f"the last {n_empty} bytes are zero ({share}): the recording stopped before its end"
        notes.append(text)
    n_frames = _count_frames(n_bytes, frame_bytes, config, source, options.keep_good, notes)
    missing: tuple[int, ...] = ()
    if files.per_position:
        missing, odd = _odd_positions(files, frame_bytes, options.keep_good, source)
        notes.extend(odd)
        n_bytes = n_frames * frame_bytes
        stream = JoinedStream([StreamPart(one, 0, n_bytes) for one in files.streams])
        n_frames *= len(files.streams)
    found = Recording(
        source=source,
        stream=stream,
        evidence=evidence,
        config=config,
        n_tx=n_tx,
        n_chirps_per_frame=n_chirps,
        n_frames=n_frames,
        n_positions=len(files.streams) if files.per_position else None,
        missing_positions=missing,
    )
    facts, more = _facts(head, files, radar, found)
    return replace(found, notes=(*notes, *more), facts=facts)


def _facts(
    head: Words, files: _Files, radar: RadarManifest, found: Recording
) -> tuple[tuple[tuple[str, str], ...], list[str]]:
    """Facts of a recording, and notes."""
    chirps, config = first_chirps(head, found.evidence), found.config
    dead, gains = dead_receivers(chirps), found.gains
    facts = [
        *files.facts,
        *describe(found.evidence, found.n_tx, found.n_chirps_per_frame, found.n_frames),
        describe_peak(chirps, found.evidence, radar, config),
    ]
    if config.transmitters:
        facts.append(("transmitters", str(config.transmitters)))
    if dead:
        facts.append(("dead receivers", ", ".join(f"{rx} ({why})" for rx, why in dead)))
    corrected = []
    if config.path_bias_m is not None:
        corrected.append(f"range bias {0.5 * config.path_bias_m:g} m")
    if gains is not None:
        factors = (f"{g:.3g}" if g.imag else f"{g.real:+.3g}" for g in gains.reshape(-1).tolist())
        corrected.append(f"factors of the channels {' '.join(factors)}")
    if corrected:
        facts.append(("compensation", f"{', '.join(corrected)}, as the profile states"))
    return tuple(facts), [f"receiver {rx} is dead: {reason}" for rx, reason in dead]


def _repaired(
    stream: ByteStream, evidence: LayoutEvidence, frame_bytes: int, source: Path
) -> tuple[ByteStream, int, list[str]]:
    """Stream with zeros where packets are missing, the bytes of zeros at its end, and notes."""
    # UserError if the recording begins within a chirp.
    order, n_samples = evidence.order, evidence.n_samples
    n_empty = trailing_zeros(stream)
    late, gaps = find_gaps(stream, order, n_samples, stream.n_bytes - n_empty)
    if late or (evidence.late and not gaps):
        raise _begins_late(evidence, late or evidence.late, source)
    notes = [
        f"{gap.n_packets} packet{'s' * (gap.n_packets > 1)} of {PAYLOAD_BYTES} bytes lost after "
        f"{gap.at // frame_bytes} whole frames ({gap.at} bytes): zeros were put there"
        if gap.n_packets
        else f"from byte {gap.at} on, chirps begin {gap.late} samples late: captures were joined "
        "that are no whole number of chirps long; from there on they are misread"
        for gap in gaps
    ]
    return repaired_stream(stream, gaps) if gaps else stream, n_empty, notes


def _begins_late(evidence: LayoutEvidence, late: int, source: Path) -> UserError:
    """UserError for a recording whose first whole chirp begins `late` stored samples after it."""
    order, n_bytes = evidence.order, 2 * words_per_sample(evidence.order) * late
    n_samples = order.per_complex * evidence.n_samples
    return UserError(
        what=f"begins in the middle of a chirp: one of {n_samples} samples begins after {late}",
        where=source,
        hint="is it a later part of a recording? name the folder with all parts"
        if order.layout == "2-lane-sequential"
        else f"name the folder with all parts of the recording, or leave out {n_bytes} bytes",
    )


def _open_files(source: Path, options: ImportOptions) -> _Files:
    """Files of a recording, or of the positions of a scan, without packet headers."""
    named = None
    if options.positions is not None and source.is_dir():
        named = read_log(options.positions, keep_good=options.keep_good).files
    per_position = options.file_per_position or named is not None
    notes: list[str] = []
    facts: list[tuple[str, str]] = []
    if per_position:
        groups = [[path] for path in position_files(source, named)]
        facts.append(("files", f"{len(groups)}, one for each position"))
    else:
        paths, notes = recording_files(source)
        groups = [paths]
        if len(paths) > 1:
            facts.append(("files", f"{len(paths)} parts, {paths[0].name} to {paths[-1].name}"))
    streams: list[ByteStream] = []
    for group in groups:
        for path in group:
            refuse_other_kind(path, is_raw=True)
        plain = JoinedStream([FileStream(path) for path in group])
        if not plain.n_bytes and not (per_position and options.keep_good):
            raise UserError(what="is empty", where=group[0])
        stream, more, found = _remove_headers(plain, options.keep_good)
        stream, headers = remove_chirp_headers(stream)
        more += headers
        if stream.n_bytes % 2:
            details = {"expected": "samples of 16 bits", "got": stream.n_bytes}
            hint = "--keep-good leaves out what is cut short"
            text = "has an odd number of bytes"
            note_omission(text, options.keep_good, group[0], hint, **details)
            more.append(f"odd number of bytes ({stream.n_bytes}): the last one was left out")
        streams.append(stream)
        notes += [f"{group[0].name}: {note}" for note in more] if per_position else more
        facts += [] if per_position else found
    return _Files(
        streams=tuple(streams),
        # Zeros of lost packets belong to the recording.
        zeros=tuple(
            0
            if isinstance(stream, PacketStream) or (per_position and not stream.n_bytes)
            else leading_zeros(stream)
            for stream in streams
        ),
        names=tuple(group[0].name for group in groups),
        per_position=per_position,
        notes=notes,
        facts=facts,
    )


def _evidence(
    head: Words, n_rx: int | None, radar: RadarManifest, config: TiConfig, source: Path
) -> LayoutEvidence:
    evidence = find_layout(
        head,
        n_rx=n_rx,
        layout=radar.raw.layout or _layout_of(config),
        offset_binary=radar.raw.offset_binary,
        n_samples=radar.n_samples or config.n_samples,
        is_real=None if radar.raw.layout else config.is_real,
        where=source,
    )
    is_known = evidence.order.is_real or evidence.order.layout.startswith("2-lane")
    if config.n_lanes == 2 and not is_known:
        raise UserError(
            what="the samples contradict the configuration, which states 2 lanes",
            where=source,
            expected="2-lane-pairs or 2-lane-sequential",
            got=f"{evidence.order} with {evidence.energy_ratio:.3g} : 1",
        )
    return evidence


def _remove_headers(
    plain: ByteStream, keep_good: bool
) -> tuple[ByteStream, list[str], list[tuple[str, str]]]:
    packets = find_packets(plain)
    if packets is None:
        return plain, [], []
    stream = PacketStream(plain, packets, keep_good=keep_good)
    found = f"headers of {packets.header} bytes found, {packets.payload} bytes each"
    facts = [("packets", f"{stream.loss} ({found})")]
    notes = list(stream.notes)
    if stream.n_lost:
        notes.append(f"{stream.loss}: expect noise where they belong")
    return stream, notes, facts


def _layout_of(config: TiConfig) -> Layout | None:
    if config.is_real:
        names: dict[bool | None, Layout] = {True: "real-alternating", False: "real-sequential"}
        return names.get(config.interleaved)
    if config.n_lanes == 4:
        return "4-lane"
    if config.n_lanes == 2 and config.interleaved is not None:
        return "2-lane-pairs" if config.interleaved else "2-lane-sequential"
    return None


def _frame_structure(radar: RadarManifest, config: TiConfig) -> tuple[int, int]:
    is_known = radar.raw.n_tx or config.transmitters
    if not is_known and (config.n_chirps_per_loop or 1) > 1:
        n = config.n_chirps_per_loop
        raise UserError(
            what=f"the transmitters of the {n} chirps of a loop are not known",
            expected="n_tx under [raw] of --radar, or LogFile.txt of mmWave Studio",
        )
    n_tx = radar.raw.n_tx or (config.transmitters.n_chirps if config.transmitters else 1)
    n_chirps = radar.raw.n_chirps_per_frame or config.n_chirps_per_frame or n_tx
    if n_chirps % n_tx:
        raise UserError(
            what="n_chirps_per_frame is no multiple of n_tx",
            expected=f"a multiple of {n_tx}",
            got=n_chirps,
        )
    return n_tx, n_chirps


def _count_frames(
    n_bytes: int, frame_bytes: int, config: TiConfig, where: Path, keep_good: bool, notes: list[str]
) -> int:
    n_frames, rest = divmod(n_bytes, frame_bytes)
    if n_frames == 0:
        raise UserError(
            what="is shorter than one frame",
            where=where,
            expected=f"{frame_bytes} bytes or more",
            got=n_bytes,
        )
    if rest > 1:  # a single byte was reported already
        text = f"the last frame is cut short after {rest} of {frame_bytes} bytes"
        hint = (
            f"--keep-good keeps the {n_frames} whole ones, which are right if the recording was "
            "stopped, and not if packets were lost"
        )
        wrong = {"expected": f"a multiple of {frame_bytes}", "got": n_bytes}
        note = note_omission(text, keep_good, where, hint, **wrong)
        notes.append(f"{note} and was left out")
    if config.n_frames is not None and config.n_frames != n_frames:
        text = f"the configuration states {config.n_frames} frames, the file holds {n_frames}"
        hint = "--keep-good takes what is there"
        notes.append(note_omission(text, keep_good, where, hint=hint))
    return n_frames


def is_kept(recording: Recording, per_position: int) -> bool:
    """Whether samples are kept as integers, as without averaging."""
    averaged = per_position > 1 or recording.n_loops > 1
    changed = recording.decoder is not None or recording.gains is not None
    return not (averaged or changed or recording.evidence.order.is_real)


def read_positions(
    recording: Recording, first: int, stop: int, per_position: int
) -> Iterator[tuple[int, Samples]]:
    """First index and mean samples (n_positions, n_tx, n_rx, n_samples); see also `is_kept`."""
    pending: Array | None = None
    blocks = recording.blocks(first * per_position, stop * per_position, step=per_position)
    for begin, end in blocks:
        frames = recording.read_frames(begin, end, integers=is_kept(recording, per_position))
        loops = frames[:, 0] if frames.shape[1] == 1 else np.asarray(frames.mean(axis=1))
        if per_position == 1:
            yield begin, loops
        elif begin % per_position == 0 and (end - begin) % per_position == 0:
            grouped = loops.reshape(-1, per_position, *loops.shape[1:])
            yield begin // per_position, grouped.mean(axis=1)
        else:  # a position larger than a block, summed in double precision
            for frame, one in enumerate(loops, start=begin):
                if pending is None:
                    pending = np.zeros(one.shape, dtype=np.complex128)
                pending += one
                if (frame + 1) % per_position == 0:
                    yield frame // per_position, (pending[None] / per_position).astype(np.complex64)
                    pending = None
