"""Columns of robot logs: which quantity and unit the name of each one means.

Robots name them differently: `x_mm`, `Pos X [mm]`, `pose.position.x`, `actual_TCP_pose_0`. A name
is split into words; all but the axis must be words that go with a position or an orientation, so
that velocities, forces, joints and targets are no positions.

The time may be two columns, seconds and their fraction in nanoseconds, and a time without a unit
that is too large for seconds since 1970 is in milliseconds, microseconds or nanoseconds.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError

_LENGTHS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), 1e-3),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), 1e-2),
    "um": 1e-6,
}
_TIMES = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds", "millis"), 1e-3),
    **dict.fromkeys(("us", "usec", "usecs", "microsecond", "microseconds", "micros"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecond", "nanoseconds", "nanos"), 1e-9),
}
_UNITS = {**_LENGTHS, **_TIMES, "rad": 1.0, "radian": 1.0, "radians": 1.0}
# Units that are the name of a time by themselves.
_LONG_TIMES = {name for name in _TIMES if len(name) > 2}
_TIME_WORDS = {"time", "t", "timestamp", "timestamps", "stamp"}
_TIME_CONTEXT = {
    *("header", "field", "elapsed", "robot", "log", "msg", "controller", "transform", "transforms0")
}
_POSITION_WORD = re.compile(
    "pos|position|tcp|pose|translation|trans|actual|current|measured|robot|tool|ee|eef|end|effector"
    "|endeffector|base|world|field|cartesian|cart|point|coord|coordinates?|location|msg|data"
    "|transform|transforms0|flange|sensor|radar|p"
)
_TURN_WORDS = {"orientation", "orient", "ori", "quat", "quaternion", "rotation", "rot", "q"}
_VECTOR_WORDS = {"rotvec", "rvec", "rotationvector", "axisangle"}
QUATERNION = ("qw", "qx", "qy", "qz")
VECTOR = ("rx", "ry", "rz")
# Angles of other conventions: each robot turns in an order of its own.
_ANGLES = (
    {"roll", "pitch", "yaw"},
    {"a", "b", "c"},
    {"w", "p", "r"},
    {"alpha", "beta", "gamma"},
    {"phi", "theta", "psi"},
    {"q1", "q2", "q3", "q4"},
    {"q0", "q1", "q2", "q3"},
    {"r11", "r12", "r13"},
    {"yaw"},
    {"o", "a", "t"},
)
# A rotation vector is at most half a turn long, and some robots count on to a whole one.
_LONGEST_RAD = 2.1 * np.pi
_SMALLEST_TURN = 1e-9


# Units of times beyond the year 5000 when read as seconds since 1970, by the largest such time.
_OF_1970 = ((1e11, "seconds", 1.0), (1e14, "milliseconds", 1e-3), (1e17, "microseconds", 1e-6))
_NANOSECONDS = ("nanoseconds", 1e-9)


Row = list[str]


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTable:
    """Numbers of a log, and what its head says of them."""

    values: Floats
    """(n_rows, n_columns). Cells that are no numbers are NaN, in columns that are not read."""
    names: Row
    bodies: Row
    """Body of each column, where motion capture names several; else empty."""
    rate_hz: float | None = None
    """Rows per second, where the head states it."""
    files: Row | None = None
    """Column `file`, where there is one."""
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Columns:
    """Column and factor to SI of each quantity but the time."""

    of: dict[str, tuple[int, float]]
    times_s: Floats | None
    """(n_rows,)."""
    unread: tuple[str, ...]
    """Names of columns that are not read."""
    notes: tuple[str, ...] = ()

    def take(self, table: Floats, wanted: Sequence[str]) -> Floats:
        """Values of some quantities in SI units, (n_rows, n_wanted)."""
        pairs = [self.of[name] for name in wanted]
        return np.stack([scale * table[:, index] for index, scale in pairs], axis=1)


def find_columns(log: LogTable, path: Path) -> Columns:
    """Return what the columns hold; UserError where positions are missing or ambiguous."""
    names, times = log.names, list[int]()
    found: dict[str, tuple[int, float]] = {}
    quantities = [quantity_of(name) for name in names]
    body, notes = _body_of_radar(log, quantities, path)
    for index, (quantity, own) in enumerate(zip(quantities, log.bodies, strict=True)):
        if quantity is not None and quantity[0] == "time":
            times.append(index)
        elif quantity is not None and own == body:
            if quantity[0] in found:
                other = names[found[quantity[0]][0]]
                what = f"two columns are {quantity[0]}: {other!r} and {names[index]!r}"
                raise UserError(what=what, where=path)
            found[quantity[0]] = (index, quantity[1])
    if "qw" not in found:  # 'Rotation X' may be an angle
        found = {name: at for name, at in found.items() if name not in QUATERNION}
    turns = [sum(name in found for name in names) for names in (QUATERNION, VECTOR)]
    if any(axis not in found for axis in "xyz") or turns[0] not in (0, 4) or turns[1] not in (0, 3):
        raise UserError(
            what="columns are missing",
            where=path,
            expected="time_s, x_m, y_m, z_m, optionally qw, qx, qy, qz or rx, ry, rz",
            got=", ".join(names)[:80],
        )
    if turns[0]:
        found = {name: at for name, at in found.items() if name not in VECTOR}
    times_s, used, more = _times(log, times)
    read = {index for index, _ in found.values()} | used
    unread = tuple(name for index, name in enumerate(names) if name and index not in read)
    return Columns(found, times_s, unread, (*notes, *more))


def _body_of_radar(
    log: LogTable, quantities: Sequence[tuple[str, float] | None], path: Path
) -> tuple[str, list[str]]:
    """Body whose columns are read, and notes: the only one, or the only one with an orientation."""
    of: dict[str, set[str]] = {}
    for body, quantity in zip(log.bodies, quantities, strict=True):
        of.setdefault(body, set()).update(quantity[:1] if quantity else ())
    placed = [body for body in of if {*"xyz"} <= of[body]]
    turning = [body for body in placed if {*QUATERNION} <= of[body] or {*VECTOR} <= of[body]]
    if len(placed) < 2:
        return (placed or [""])[0], []
    if len(turning) != 1:
        raise UserError(
            what=f"holds {len(turning or placed)} bodies: {', '.join(turning or placed)[:200]}",
            where=path,
            expected="the radar alone",
            hint="delete the columns of the others",
        )
    return turning[0], [f"of {len(placed)} bodies in {path.name} that with an orientation was read"]


def _times(log: LogTable, candidates: Sequence[int]) -> tuple[Floats | None, set[int], list[str]]:
    """Return the times [s] of the rows, the columns they are from, and notes."""
    stems: dict[tuple[str, ...], list[int]] = {}
    for index in candidates:
        stems.setdefault(_split(log.names[index])[0], []).append(index)
    # The stamp of a message is that of the measurement; another column says when it was stored.
    for stem, columns in sorted(stems.items(), key=lambda item: "header" not in item[0]):
        scales = [_TIMES[_split(log.names[index])[1] or "s"] for index in columns]
        values = [log.values[:, index] * s for index, s in zip(columns, scales, strict=True)]
        if len(columns) == 2 and scales[0] == 1 > scales[1] and _is_fraction(*values):
            return values[0] + values[1], set(columns), []
        if _split(log.names[columns[0]])[1] is None and (scale := _since_1970(values[0])):
            unit, factor = scale
            note = f"{log.names[columns[0]] or stem} was read as {unit} since 1970"
            return factor * values[0], {columns[0]}, [note]
        return values[0], {columns[0]}, []
    frame = next((k for k, name in enumerate(log.names) if name.lower() == "frame"), None)
    if log.rate_hz is None or frame is None:
        return None, set(), []
    note = f"times were counted by frames, from frame 1 on, {log.rate_hz:g} in a second"
    return (log.values[:, frame] - 1) / log.rate_hz, {frame}, [note]


def _is_fraction(seconds: Floats, more_s: Floats) -> bool:
    """Whether times are whole seconds and what is beyond them."""
    with np.errstate(invalid="ignore"):
        return not ((seconds % 1 > 0) | (more_s < 0) | (more_s >= 1)).any()


def _since_1970(times: Floats) -> tuple[str, float] | None:
    """Return unit and factor of times that are too large for seconds; None for others."""
    typical = float(np.nanmedian(times)) if np.isfinite(times).any() else 0.0
    if typical < _OF_1970[0][0]:
        return None
    return next(((unit, factor) for most, unit, factor in _OF_1970 if typical < most), _NANOSECONDS)


def is_unit(text: str) -> bool:
    """Whether a cell holds a unit alone."""
    return text.strip("[]() ").lower() in {*_UNITS, "deg", "degree", "degrees"}


def is_context(text: str) -> bool:
    """Whether a cell names a position or an orientation, as a word before that of the axis."""
    words = _split(text)[0]
    known = _TURN_WORDS | _VECTOR_WORDS
    return all(word in known or _POSITION_WORD.fullmatch(word) for word in words)


def _split(name: str) -> tuple[tuple[str, ...], str | None]:
    """Words of a name, and its unit."""
    split = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name.strip())
    words = [word for word in re.split(r"[^a-z0-9]+", split.lower().replace("\u00b5", "u")) if word]
    known = _UNITS if len(words) > 1 else _LONG_TIMES
    unit = words.pop() if words and words[-1] in known else None
    return tuple(words), unit


def quantity_of(name: str) -> tuple[str, float] | None:
    """Quantity and factor to SI of a column of this name; None for what is not read."""
    words, unit = _split(name)
    if unit and not words:
        return "time", _TIMES[unit]
    others, last = set(words[:-1]), words[-1] if words else ""
    if last in _TIME_WORDS and others <= _TIME_WORDS | _TIME_CONTEXT:
        return ("time", _TIMES[unit or "s"]) if unit is None or unit in _TIMES else None
    if "pose" in others and re.fullmatch("[0-5]", last):
        last = (*"xyz", *VECTOR)[int(last)]
    compact = re.fullmatch(r"(pos|position|tcp|pose|coord|[tp])?([xyz])(pos)?", last)
    axis = compact[2] if compact else last
    if words and words[0] in ("w", *"xyz") and axis not in ("w", *"xyz"):  # x_pos
        axis, others = words[0], set(words[1:])
    is_vector, is_turn = others & _VECTOR_WORDS, others & _TURN_WORDS
    others -= _VECTOR_WORDS | _TURN_WORDS
    if not all(_POSITION_WORD.fullmatch(word) for word in others):
        return None
    if axis in ("w", *"xyz"):
        axis = f"r{axis}" if is_vector else f"q{axis}" if is_turn else axis
    return _scaled(axis, unit)


def _scaled(quantity: str, unit: str | None) -> tuple[str, float] | None:
    if quantity not in ("x", "y", "z", *QUATERNION, *VECTOR):
        return None
    if unit is None:
        return quantity, 1.0
    if quantity in "xyz":
        return (quantity, _LENGTHS[unit]) if unit in _LENGTHS else None
    return (quantity, 1.0) if quantity in VECTOR and unit.startswith("rad") else None


def require_read_turns(names: Sequence[str], table: Floats, columns: Columns, path: Path) -> None:
    """Raise UserError where an orientation is given in a form that is not read, and turns."""
    plain = {re.split(r"[^a-z0-9]", name.strip().lower())[0]: name for name in columns.unread}
    ends = {re.split(r"[^a-z0-9]", name.strip().lower())[-1]: name for name in columns.unread}
    degrees = [
        name
        for name in columns.unread
        if re.match("[^a-z]*r[xyz]([^a-z]|$)", name.lower())
        or (quantity_of(name) or [""])[0] in QUATERNION
    ]
    if "qw" not in columns.of and "rx" not in columns.of:
        for angles in _ANGLES:
            for named in (plain, ends):
                if angles <= set(named):
                    _refuse_turn([named[angle] for angle in sorted(angles)], names, table, path)
        _refuse_turn(degrees, names, table, path)
    if "rx" in columns.of:
        longest = float(np.nanmax(np.linalg.norm(columns.take(table, VECTOR), axis=1), initial=0.0))
        if longest > _LONGEST_RAD:
            raise UserError(
                what=f"rx, ry, rz are up to {longest:.4g} long, no rotation vectors in radians",
                where=path,
                expected=f"at most {_LONGEST_RAD:.3g}",
                hint="are they angles in degrees? give qw, qx, qy, qz",
            )


def _refuse_turn(turning: Sequence[str], names: Sequence[str], table: Floats, path: Path) -> None:
    values = table[:, [list(names).index(name) for name in turning]]
    if turning and not (np.abs(np.nan_to_num(values)) < _SMALLEST_TURN).all():
        raise UserError(
            what=f"holds an orientation that is not read: {', '.join(turning)}",
            where=path,
            expected="qw, qx, qy, qz, or a rotation vector rx, ry, rz in radians",
            hint="convert it, or delete these columns if the radar did not turn",
        )
