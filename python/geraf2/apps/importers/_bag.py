"""Frames and poses of a ROS 2 bag: words of the radar, and positions of its antennas."""

import os
import re
import weakref
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Bools, Bytes, Floats, Ints
from geraf2.apps.importers import NO_OPTIONS, ImportOptions
from geraf2.apps.importers._raw_stream import ByteStream, JoinedStream, StreamPart, ZeroStream
from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import note_omission
from geraf2.errors import UserError
from geraf2.io.ros import open_bag

_TF = "tf2_msgs/msg/TFMessage"
_POSES = ("geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry")
_KINDS = (_TF, *_POSES)
# Their arrays of bytes are no samples.
_NO_SAMPLES = ("sensor_msgs", "nav_msgs", "visualization_msgs", "rcl_interfaces", "map_msgs")
_WORDS = {"uint8": "u1", "int8": "i1", "int16": "<i2", "uint16": "<u2"}
_ARRAY, _SEQUENCE, _NAME = 3, 4, 2  # kinds of fields in rosbags
_MAX_DEPTH = 3
# Names of arrays that hold the real or the imaginary parts of samples.
_REAL = re.compile(r"(?:.*_)?(?:re|real|i|in_?phase)(?:_.*|data|part)?", re.IGNORECASE)
_IMAGINARY = re.compile(
    r"(?:.*_)?(?:im|imag|imaginary|q|quad|quadrature)(?:_.*|data|part)?", re.IGNORECASE
)


class _Stored(ByteStream):
    """What was written to a file, which is kept until the stream is gone."""

    def __init__(self, file: IO[bytes], where: object) -> None:
        super().__init__(file.tell(), where)
        file.flush()
        self._descriptor = os.dup(file.fileno())
        weakref.finalize(self, os.close, self._descriptor)

    def read_into(self, start: int, out: Bytes) -> None:
        os.preadv(self._descriptor, [out.data], start)


@dataclass(frozen=True, kw_only=True, eq=False)
class Bag:
    """Frames of the radar and positions of its board; times begin at the first frame."""

    frames: ByteStream
    """Words of all frames, with zeros where a frame was lost."""
    frame_bytes: int
    lost: tuple[int, ...]
    """Numbers of the frames that are missing; their words are zero."""
    start_s: float
    period_s: float
    log: RobotLog
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def list_bag(source: Path) -> tuple[list[tuple[str, str]], list[str]]:
    """Names and values of a bag's contents, and what it lacks for an import."""
    with open_bag(source) as reader:
        bag = _Messages(reader, NO_OPTIONS, source)
        samples, poses = bag.of_samples, bag.of_poses
        start = datetime.fromtimestamp(1e-9 * reader.start_time, UTC)
        recorded = f"{start:%Y-%m-%d %H:%M:%S} UTC, {1e-9 * reader.duration:.4g} s"
        rows = [("recorded", recorded)] if reader.start_time else []
        for name, kind in bag.topics.items():
            use = "samples of a radar" if name in samples else "poses" if name in poses else ""
            n = reader.topics[name].msgcount
            text = f"{kind}, {n} message{'s' * (n != 1)}"
            rows.append((name, f"{text}: {use}" if use else text))
    lacks = [(samples, "no topic with samples of a radar"), (poses, "no topic with poses")]
    return rows, [text for found, text in lacks if not found]


def read_bag(source: Path, options: ImportOptions, period_s: float | None) -> Bag:
    """Read frames and poses of a bag; UserError where either is missing.

    period_s: time between frames where the radar's configuration states it.
    """
    with open_bag(source, is_cut=options.keep_good) as reader, TemporaryFile() as file:
        bag = _Messages(reader, options, source)
        samples = bag.samples_topic()
        table, frame_id, field = bag.copy_frames(samples, file)
        log, origin = bag.read_log(frame_id, int(table[0, 0]))
        frame_bytes = int(np.median(table[:, 1]))
        notes, good = bag.usable(table, frame_bytes, samples)
        table = table[good]
        times = (table[:, 0] - table[0, 0]) * 1e-9
        numbers, start_s, period_s = frame_clock(times, period_s, samples, source)
        offsets = np.full(numbers[-1] + 1, -1, dtype=np.int64)
        offsets[numbers] = table[:, 2]
        stored, zeros = _Stored(file, source), ZeroStream(frame_bytes, source)
    parts = (StreamPart(stored, at, frame_bytes) if at >= 0 else zeros for at in offsets.tolist())
    lost = np.flatnonzero(offsets < 0)
    if len(lost):
        text = f"{len(lost)} of {len(offsets)} frames are missing from {samples}"
        details = {
            "expected": f"a message every {1e3 * period_s:.4g} ms",
            "got": f"none {times[np.searchsorted(numbers, lost[0]) - 1]:.4g} s after the first",
            "hint": "--keep-good imports the others",
        }
        notes.append(note_omission(text, options.keep_good, source, **details))
    return Bag(
        frames=JoinedStream(list(parts)),
        frame_bytes=frame_bytes,
        lost=tuple(lost.tolist()),
        start_s=start_s,
        period_s=period_s,
        log=log,
        facts=(
            ("frames from", f"{field} of {samples} ({bag.topics[samples]}), {len(times)} messages"),
            ("positions from", origin),
        ),
        notes=tuple(notes),
    )


def frame_clock(
    times_s: Floats, period_s: float | None, topic: str, where: object
) -> tuple[Ints, float, float]:
    """Find the number of each frame, the time of the first and the period from jittered stamps.

    The radar sends at equal intervals; a straight line through the stamps is its clock.
    """
    if len(times_s) < 2:
        raise UserError(what=f"{topic} has a single usable message", where=where)
    period_s = period_s or float(np.median(np.diff(times_s)))
    numbers = np.arange(len(times_s))
    missing = (times_s[-1] - times_s[0]) / period_s - numbers[-1]
    if missing > 0.01 * len(numbers) or np.diff(times_s).max() > (2 - 0.1) * period_s:
        numbers = np.cumsum([0, *np.maximum(1, np.rint(np.diff(times_s) / period_s))]).astype(int)
    period_s, start_s = np.polyfit(numbers, times_s, 1)
    late = np.abs(times_s - start_s - period_s * numbers)
    near = late <= max(4 * float(np.median(late)), 1e-6)
    period_s, start_s = np.polyfit(numbers[near], times_s[near], 1)
    return numbers, float(start_s), float(period_s)


class _Messages:
    """Messages of an open bag, and the topics that an import uses."""

    def __init__(self, reader: Any, options: ImportOptions, where: Path) -> None:
        self._reader, self._options, self._where = reader, options, where
        self.topics: dict[str, str] = {
            name: info.msgtype or "?" for name, info in sorted(reader.topics.items())
        }
        """Types of the topics by their names."""
        self._arrays_of = partial(_arrays_of, reader.typestore.fielddefs)
        kinds = {n: k for n, k in self.topics.items() if k.split("/")[0] not in _NO_SAMPLES}
        self.of_samples = [name for name, kind in kinds.items() if self._arrays_of(kind)]
        """Topics with an array of words in each message."""
        self.of_poses = [name for name, kind in self.topics.items() if kind in _KINDS]

    def _listing(self, names: Sequence[str]) -> str:
        """List some topics with their types, or all."""
        shown = [f"{name} ({self.topics[name]})" for name in names or self.topics]
        return ", ".join(shown) or "no topic"

    def _given(self, topic: str, flag: str, holds: str, expected: str, is_right: object) -> str:
        """Topic that a flag names; UserError where it is missing, or holds something else."""
        if topic not in self.topics:
            what = f"has no topic {topic}, which {flag} names"
            raise UserError(what=what, where=self._where, expected=self._listing(()))
        if not is_right:
            what, got = f"{topic} holds no {holds}", self.topics[topic]
            raise UserError(what=what, where=self._where, expected=expected, got=got)
        return topic

    def samples_topic(self) -> str:
        """Topic of the radar's samples: the given one, or the only one that may hold them."""
        given, found = self._options.adc_topic, self.of_samples
        if given is not None:
            arrays = self._arrays_of(self.topics.get(given, "?"))
            expected = "an array of uint8, int16 or uint16"
            return self._given(given, "--adc-topic", "samples of a radar", expected, arrays)
        if len(found) != 1:
            several = "has several topics that may hold the radar's samples"
            raise UserError(
                what=several if found else "has no topic with samples of a radar",
                where=self._where,
                expected="a message with an array of uint8, int16 or uint16 for each frame",
                got=self._listing(found),
                hint="--adc-topic names it",
            )
        return found[0]

    def _all_of(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Time [ns] and content of each message, by the header's stamp where there is one."""
        connections = self._reader.topics[topic].connections
        for connection, logged, data in self._reader.messages(connections):
            message = self._reader.deserialize(data, connection.msgtype)
            yield _stamp(message) or logged, message

    def copy_frames(self, topic: str, file: Any) -> tuple[Ints, str, str]:
        """Stamp [ns], size and offset in the file of each message, the radar's frame, the field."""
        rows, frame_id, field = [], "", ""
        used: list[tuple[str, str]] = []
        for stamp, message in self._all_of(topic):
            if not used:
                used = self._used_arrays(message, topic)
                field = " and ".join(name for name, _ in used)
                frame_id = str(getattr(getattr(message, "header", None), "frame_id", ""))
            parts = [np.asarray(attrgetter(name)(message)).astype(word) for name, word in used]
            if len({part.size for part in parts}) > 1:
                what = f"{field} of a message of {topic} differ in length"
                raise UserError(what=what, where=self._where)
            data = np.stack(parts, axis=-1).tobytes()  # I and Q of each sample
            rows.append((stamp, len(data), file.tell()))
            file.write(data)
        if not rows:
            raise UserError(what=f"{topic} holds no message", where=self._where)
        return np.array(rows, dtype=np.int64), frame_id, field

    def usable(self, table: Ints, frame_bytes: int, topic: str) -> tuple[list[str], Bools]:
        """Mask of the usable messages, after notes on the others."""
        notes, keep_good = [], self._options.keep_good
        odd = table[:, 1] != frame_bytes
        if odd.any():
            text = f"{int(odd.sum())} of {len(odd)} messages of {topic} have another size"
            sizes = {"expected": f"{frame_bytes} bytes", "got": f"{table[odd][0, 1]} bytes"}
            notes.append(note_omission(text, keep_good, self._where, **sizes))
        latest = np.maximum.accumulate(np.concatenate([[-1], table[:-1, 0]]))
        back = table[:, 0] <= latest
        if back.any():
            at = f"{int(back.sum())} of {len(back)} messages"
            text = f"time stamps of {topic} do not increase at {at}"
            notes.append(note_omission(text, keep_good, self._where))
        return notes, np.asarray(~odd & ~back)

    def _used_arrays(self, message: Any, topic: str) -> list[tuple[str, str]]:
        """Array of samples, the longest: others hold shapes and settings; or I and Q."""
        arrays = self._arrays_of(self.topics[topic])
        sizes = [len(attrgetter(name)(message)) for name, _ in arrays]
        longest = [array for array, n in zip(arrays, sizes, strict=True) if n == max(sizes)]
        parts = [
            [array for array in arrays if name.fullmatch(array[0].split(".")[-1])]
            for name in (_REAL, _IMAGINARY)
        ]
        both = [part[0] for part in parts if len(part) == 1]
        if len(both) == 2 and all(array in both for array in longest):
            return both
        if len(longest) == 1:
            return longest
        names = ", ".join(name for name, _ in longest)
        raise UserError(
            what=f"a message of {topic} has {len(longest)} arrays of {max(sizes)} values: {names}",
            where=self._where,
            expected="one array of samples, or two whose names say real and imaginary part",
        )

    def read_log(self, frame_id: str, zero_ns: int) -> tuple[RobotLog, str]:
        """Poses of the radar at times from `zero_ns` on, and their origin."""
        topics, given, found = self.topics, self._options.pose_topic, self.of_poses
        expected = " or ".join(_KINDS)
        if given is not None:
            is_right = topics.get(given) in _KINDS
            found = [self._given(given, "--pose-topic", "poses", expected, is_right)]
        trees = [name for name in topics if topics[name] == _TF]
        single = [name for name in found if topics[name] != _TF]
        if not found or (len(single) > 1 and not trees):
            raise UserError(
                what="has several topics of poses" if found else "has no poses of the radar",
                where=self._where,
                expected=expected,
                got=self._listing(single),
                hint="--pose-topic names one",
            )
        if any(topics[name] == _TF for name in found):
            return self._log_of_tree(trees, frame_id, zero_ns)
        rows, name = [], single[0]
        for stamp, message in self._all_of(name):
            pose = message.pose.pose if topics[name] == _POSES[1] else message.pose
            rows.append(_row(stamp, zero_ns, pose.position, pose.orientation))
        log = self._log(rows, name)
        return log, f"{name} ({topics[name]}), {len(log.rows)} poses"

    def _log(self, rows: list[list[float]], name: str) -> RobotLog:
        """Poses in rising order of time, without repetitions; UserError for broken ones."""
        table = np.array(rows, dtype=np.float64).reshape(-1, 8)
        sizes = np.linalg.norm(table[:, 4:], axis=1)
        bad = ~np.isfinite(table).all(axis=1) | (np.abs(sizes - 1) > 0.01)
        times = table[:, 0]
        latest = np.maximum.accumulate(np.concatenate([[-np.inf], times[:-1]]))
        for wrong, reason in (
            (bad, "are no numbers, or have a quaternion that is not 1 long"),
            (times < latest, "have time stamps that do not increase"),
        ):
            if wrong.any():
                text = f"{int(wrong.sum())} of {len(wrong)} poses of {name} {reason}"
                note_omission(text, self._options.keep_good, self._where)
        good = table[~bad & (times > latest)]
        if not len(good):
            raise UserError(what=f"{name} holds no usable pose", where=self._where)
        return RobotLog.of_poses(self._where, good)

    def _log_of_tree(self, topics: list[str], frame_id: str, zero_ns: int) -> tuple[RobotLog, str]:
        """Poses of the radar's frame in the fixed frame, over a chain of transforms."""
        links: dict[tuple[str, str], list[list[float]]] = defaultdict(list)
        for topic in topics:
            for _, message in self._all_of(topic):
                for one in message.transforms:
                    names = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
                    move = one.transform
                    row = _row(_stamp(one), zero_ns, move.translation, move.rotation)
                    links[names].append(row)
        parent_of = {child: parent for parent, child in links}
        fixed, radar = self._options.frames or ("", frame_id.lstrip("/"))
        known = sorted({name for pair in links for name in pair})
        chain = [radar]
        while chain[-1] != fixed and chain[-1] in parent_of and len(chain) <= len(known):
            chain.append(parent_of[chain[-1]])
        if radar not in parent_of or (fixed and chain[-1] != fixed):
            raise UserError(
                what=f"no transforms lead from frame {fixed or 'of the room'!r} to {radar!r}",
                where=self._where,
                expected=f"two of {', '.join(known)}",
                hint="--frames FIXED RADAR names them",
            )
        moves = [self._log(links[b, a], f"{b} to {a}") for a, b in pairwise(chain)]
        spans = [move.times_s for move in moves if move.times_s is not None and len(move.rows) > 1]
        if not spans:
            what = f"the radar does not move: no transform from {chain[-1]!r} to {radar!r} changes"
            hint = "--frames FIXED RADAR names others"
            raise UserError(what=what, where=self._where, hint=hint)
        times = max(spans, key=len)
        times = times[(times >= max(t[0] for t in spans)) & (times <= min(t[-1] for t in spans))]
        if not len(times):
            what = f"the transforms from {chain[-1]!r} to {radar!r} have no time in common"
            raise UserError(what=what, where=self._where, hint="record all of them with the radar")
        position, turn = np.zeros((len(times), 3)), Rotation.identity(len(times))
        for move in moves:  # from the radar to the fixed frame
            own = move.rotations_at(times)
            position, turn = own.apply(position) + move.positions_at(times), own * turn
        whole = np.column_stack([times, position, np.roll(turn.as_quat(), 1, axis=1)])
        text = f"{' and '.join(topics)}, {chain[-1]} to {radar}, {len(times)} poses"
        return RobotLog.of_poses(self._where, whole), text


def _arrays_of(fields: Any, kind: str, depth: int = 0) -> list[tuple[str, str]]:
    """Paths of the arrays of words in a type of message, with their kinds of numbers."""
    found: list[tuple[str, str]] = []
    for name, (node, inner) in fields[kind][1] if kind in fields else ():
        if node in (_ARRAY, _SEQUENCE) and inner[0][0] != _NAME:
            word = _WORDS.get(inner[0][1][0])
            found += [(name, word)] if word else []
        elif node == _NAME and depth < _MAX_DEPTH:
            found += [(f"{name}.{n}", word) for n, word in _arrays_of(fields, inner, depth + 1)]
    return found


def _stamp(message: Any) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _row(stamp: int, zero_ns: int, position: Any, turn: Any) -> list[float]:
    """Time [s], position [m], quaternion w x y z."""
    at = [position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z]
    return [(stamp - zero_ns) * 1e-9, *at]
