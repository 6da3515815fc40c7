"""Frames and poses of a ROS 2 bag: words of the radar, and positions of its antennas."""

import os
import re
import weakref
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
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
from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers._raw_stream import ByteStream, JoinedStream, StreamPart, ZeroStream
from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import note_omission
from geraf2.errors import UserError
from geraf2.io.ros import open_bag

_TF = "tf2_msgs/msg/TFMessage"
_POSES = ("geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry")
# Their arrays of bytes are no samples.
_NO_SAMPLES = ("sensor_msgs", "nav_msgs", "visualization_msgs", "rcl_interfaces", "map_msgs")
_WORDS = {"uint8": "u1", "int8": "i1", "int16": "<i2", "uint16": "<u2"}
_ARRAY, _SEQUENCE, _NAME = 3, 4, 2  # kinds of fields in rosbags
_MAX_DEPTH = 3
_W_FIRST = [0, 1, 2, 3, 7, 4, 5, 6]  # of time, position and quaternion x y z w
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
        topics = _topics(reader)
        samples, poses = _samples_topics(reader, topics), _poses_topics(topics)
        start = datetime.fromtimestamp(1e-9 * reader.start_time, UTC)
        recorded = f"{start:%Y-%m-%d %H:%M:%S} UTC, {1e-9 * reader.duration:.4g} s"
        rows = [("recorded", recorded)] if reader.start_time else []
        for name, kind in topics.items():
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
        topics = _topics(reader)
        samples = _samples_topic(reader, topics, options, source)
        table, frame_id, field = _copy_frames(reader, samples, file, source)
        log, origin = _read_log(reader, topics, options, frame_id, int(table[0, 0]), source)
        frame_bytes = int(np.median(table[:, 1]))
        notes, good = _usable_messages(table, frame_bytes, samples, options, source)
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
            ("frames from", f"{field} of {samples} ({topics[samples]}), {len(times)} messages"),
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


def _usable_messages(
    table: Ints, frame_bytes: int, topic: str, options: ImportOptions, where: Path
) -> tuple[list[str], Bools]:
    """Mask of the usable messages, after notes on the others."""
    notes = []
    odd = table[:, 1] != frame_bytes
    if odd.any():
        text = f"{int(odd.sum())} of {len(odd)} messages of {topic} have another size"
        sizes = {"expected": f"{frame_bytes} bytes", "got": f"{table[odd][0, 1]} bytes"}
        notes.append(note_omission(text, options.keep_good, where, **sizes))
    latest = np.maximum.accumulate(np.concatenate([[-1], table[:-1, 0]]))
    back = table[:, 0] <= latest
    if back.any():
        at = f"{int(back.sum())} of {len(back)} messages"
        text = f"time stamps of {topic} do not increase at {at}"
        notes.append(note_omission(text, options.keep_good, where))
    return notes, np.asarray(~odd & ~back)


def _listing(topics: dict[str, str]) -> str:
    return ", ".join(f"{name} ({kind})" for name, kind in topics.items()) or "no topic"


def _given_topic(
    topics: dict[str, str],
    topic: str,
    flag: str,
    where: Path,
    contents: tuple[str, str, Callable[[str], object]],
) -> str:
    """Topic that a flag names, whose type must have `contents`: name, what has it, its test."""
    if topic not in topics:
        what = f"has no topic {topic}, which {flag} names"
        raise UserError(what=what, where=where, expected=_listing(topics))
    name, expected, has_them = contents
    if not has_them(topics[topic]):
        what = f"{topic} holds no {name}"
        raise UserError(what=what, where=where, expected=expected, got=topics[topic])
    return topic


def _topics(reader: Any) -> dict[str, str]:
    """Types of the topics by their names."""
    return {name: info.msgtype or "?" for name, info in sorted(reader.topics.items())}


def _samples_topics(reader: Any, topics: dict[str, str]) -> list[str]:
    """Topics with an array of words in each message."""
    fields = reader.typestore.fielddefs
    return [
        name
        for name, kind in topics.items()
        if kind.split("/")[0] not in _NO_SAMPLES and _arrays_of(fields, kind)
    ]


def _poses_topics(topics: dict[str, str]) -> list[str]:
    return [name for name, kind in topics.items() if kind in (_TF, *_POSES)]


def _samples_topic(reader: Any, topics: dict[str, str], options: ImportOptions, where: Path) -> str:
    """Topic of the radar's samples: the given one, or the only one that may hold them."""
    found = _samples_topics(reader, topics)
    if options.adc_topic is not None:
        has_arrays = partial(_arrays_of, reader.typestore.fielddefs)
        contents = ("samples of a radar", "an array of uint8, int16 or uint16", has_arrays)
        return _given_topic(topics, options.adc_topic, "--adc-topic", where, contents)
    if len(found) != 1:
        several = "has several topics that may hold the radar's samples"
        raise UserError(
            what=several if found else "has no topic with samples of a radar",
            where=where,
            expected="a message with an array of uint8, int16 or uint16 for each frame",
            got=_listing({name: topics[name] for name in found} or topics),
            hint="--adc-topic names it",
        )
    return found[0]


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


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    """Time [ns] and content of each message, by the header's stamp where there is one."""
    for connection, logged, data in reader.messages(reader.topics[topic].connections):
        message = reader.deserialize(data, connection.msgtype)
        yield _stamp(message) or logged, message


def _stamp(message: Any) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _copy_frames(reader: Any, topic: str, file: Any, where: Path) -> tuple[Ints, str, str]:
    """Stamp [ns], size and offset in the file of each message, the radar's frame, and the field."""
    rows, frame_id, field = [], "", ""
    used: list[tuple[str, str]] = []
    arrays = _arrays_of(reader.typestore.fielddefs, reader.topics[topic].msgtype)
    for stamp, message in _messages(reader, topic):
        if not used:
            used = _used_arrays(message, arrays, topic, where)
            field = " and ".join(name for name, _ in used)
            frame_id = str(getattr(getattr(message, "header", None), "frame_id", ""))
        parts = [np.asarray(attrgetter(name)(message)).astype(word) for name, word in used]
        if len({part.size for part in parts}) > 1:
            raise UserError(what=f"{field} of a message of {topic} differ in length", where=where)
        data = np.stack(parts, axis=-1).tobytes()  # I and Q of each sample
        rows.append((stamp, len(data), file.tell()))
        file.write(data)
    if not rows:
        raise UserError(what=f"{topic} holds no message", where=where)
    return np.array(rows, dtype=np.int64), frame_id, field


def _used_arrays(
    message: Any, arrays: Sequence[tuple[str, str]], topic: str, where: Path
) -> list[tuple[str, str]]:
    """Array of samples in a message, the longest: others hold shapes and settings; or I and Q."""
    sizes = [len(attrgetter(name)(message)) for name, _ in arrays]
    longest = [array for array, n in zip(arrays, sizes, strict=True) if n == max(sizes)]
    parts = [
        [a for a in arrays if name.fullmatch(a[0].split(".")[-1])] for name in (_REAL, _IMAGINARY)
    ]
    both = [part[0] for part in parts if len(part) == 1]
    if len(both) == 2 and all(array in both for array in longest):
        return both
    if len(longest) == 1:
        return longest
    names = ", ".join(name for name, _ in longest)
    raise UserError(
        what=f"a message of {topic} has {len(longest)} arrays of {max(sizes)} values: {names}",
        where=where,
        expected="one array of samples, or two whose names say real and imaginary part",
    )


def _read_log(
    reader: Any,
    topics: dict[str, str],
    options: ImportOptions,
    frame_id: str,
    zero_ns: int,
    where: Path,
) -> tuple[RobotLog, str]:
    """Poses of the radar at times from `zero_ns` on, and their origin."""
    given, kinds = options.pose_topic, (_TF, *_POSES)
    found = _poses_topics(topics)
    if given is not None:
        contents = ("poses", " or ".join(kinds), kinds.__contains__)
        found = [_given_topic(topics, given, "--pose-topic", where, contents)]
    trees = [name for name in topics if topics[name] == _TF]
    single = [name for name in found if topics[name] != _TF]
    if not found or (len(single) > 1 and not trees):
        raise UserError(
            what="has several topics of poses" if found else "has no poses of the radar",
            where=where,
            expected=" or ".join(kinds),
            got=_listing({name: topics[name] for name in single} or topics),
            hint="--pose-topic names one",
        )
    if any(topics[name] == _TF for name in found):
        return _log_of_tree(reader, trees, options, frame_id, zero_ns, where)
    rows = []
    for stamp, message in _messages(reader, single[0]):
        pose = message.pose.pose if topics[single[0]] == _POSES[1] else message.pose
        rows.append(_row(stamp, zero_ns, pose.position, pose.orientation))
    link = _check_rows(rows, single[0], options, where)
    return RobotLog.of_poses(
        where, link[:, _W_FIRST]
    ), f"{single[0]} ({topics[single[0]]}), {len(link)} poses"


def _row(stamp: int, zero_ns: int, position: Any, turn: Any) -> list[float]:
    """Time [s], position [m], quaternion x y z w."""
    at = [position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w]
    return [(stamp - zero_ns) * 1e-9, *at]


def _check_rows(rows: list[list[float]], name: str, options: ImportOptions, where: Path) -> Floats:
    """Poses (n, 8) in rising order of time, without repetitions; UserError for broken ones."""
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
            note_omission(text, options.keep_good, where)
    good = table[~bad & (times > latest)]
    if not len(good):
        raise UserError(what=f"{name} holds no usable pose", where=where)
    return np.asarray(good)


def _log_of_tree(
    reader: Any, topics: list[str], options: ImportOptions, frame_id: str, zero_ns: int, where: Path
) -> tuple[RobotLog, str]:
    """Poses of the radar's frame in the fixed frame, over a chain of transforms."""
    links: dict[tuple[str, str], list[list[float]]] = defaultdict(list)
    for topic in topics:
        for _, message in _messages(reader, topic):
            for one in message.transforms:
                stamp, move = _stamp(one), one.transform
                names = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
                links[names].append(_row(stamp, zero_ns, move.translation, move.rotation))
    parent_of = {child: parent for parent, child in links}
    fixed, radar = options.frames or ("", frame_id.lstrip("/"))
    known = sorted({name for pair in links for name in pair})
    chain = [radar]
    while chain[-1] != fixed and chain[-1] in parent_of and len(chain) <= len(known):
        chain.append(parent_of[chain[-1]])
    if radar not in parent_of or (fixed and chain[-1] != fixed):
        raise UserError(
            what=f"no transforms lead from frame {fixed or 'of the room'!r} to {radar!r}",
            where=where,
            expected=f"two of {', '.join(known)}",
            hint="--frames FIXED RADAR names them",
        )
    tables = [
        _check_rows(links[parent, child], f"{parent} to {child}", options, where)
        for child, parent in pairwise(chain)
    ]
    moving = [table for table in tables if len(table) > 1]
    if not moving:
        what = f"the radar does not move: no transform from {chain[-1]!r} to {radar!r} changes"
        raise UserError(what=what, where=where, hint="--frames FIXED RADAR names others")
    begin, end = max(t[0, 0] for t in moving), min(t[-1, 0] for t in moving)
    times = max(moving, key=len)[:, 0]
    times = times[(times >= begin) & (times <= end)]
    position, turn = np.zeros((len(times), 3)), Rotation.identity(len(times))
    for table in tables:  # from the radar to the fixed frame
        link = RobotLog.of_poses(where, table[:, _W_FIRST])
        own = link.rotations_at(times)
        position, turn = own.apply(position) + link.positions_at(times), own * turn
    text = f"{' and '.join(topics)}, {chain[-1]} to {radar}, {len(times)} poses"
    whole = np.column_stack([times, position, turn.as_quat()])
    return RobotLog.of_poses(where, whole[:, _W_FIRST]), text
