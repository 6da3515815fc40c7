"""Columns of robot logs: which quantity and unit the name of each one means.

Robots name them differently: `x_mm`, `Pos X [mm]`, `pose.position.x`, `actual_TCP_pose_0`. A name
is split into words; all but the axis must be words that go with a position or an orientation, so
that velocities, forces, joints and targets are no positions.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
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
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds", "millis"), 1e-3),
    **dict.fromkeys(("us", "usec", "microsecond", "microseconds", "micros"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds", "nanos"), 1e-9),
}
_UNITS = {**_LENGTHS, **_TIMES, "rad": 1.0, "radian": 1.0, "radians": 1.0}
_TIME_WORDS = {"time", "t", "timestamp", "timestamps", "stamp", "secs", "seconds"}
_TIME_CONTEXT = {"header", "field", "elapsed", "robot", "log", "msg", "controller"}
_POSITION_WORD = re.compile(
    "pos|position|tcp|pose|translation|trans|actual|current|measured|robot|tool|ee|eef|end|effector"
    "|endeffector|base|world|field|cartesian|cart|point|coord|coordinates?|location|msg|data"
    "|transform|flange|sensor|radar|p"
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
    {"o", "a", "t"},
)
# A rotation vector is at most half a turn long, and some robots count on to a whole one.
_LONGEST_RAD = 2.1 * np.pi
_SMALLEST_TURN = 1e-9


@dataclass(frozen=True)
class Columns:
    """Column and factor to SI of each quantity, and the names of columns that are not read."""

    of: dict[str, tuple[int, float]]
    unread: tuple[str, ...]

    def take(self, table: Floats, wanted: Sequence[str]) -> Floats:
        """Values of some quantities in SI units, (n_rows, n_wanted)."""
        pairs = [self.of[name] for name in wanted]
        return np.stack([scale * table[:, index] for index, scale in pairs], axis=1)


def find_columns(names: Sequence[str], path: Path) -> Columns:
    """Return what the columns hold; UserError where positions are missing or ambiguous."""
    found: dict[str, tuple[int, float]] = {}
    unread = []
    for index, name in enumerate(names):
        quantity = quantity_of(name)
        if quantity is None or (quantity[0] == "time" and "time" in found):
            unread.append(name)
            continue
        if quantity[0] in found:
            other = names[found[quantity[0]][0]]
            what = f"two columns are {quantity[0]}: {other!r} and {name!r}"
            raise UserError(what=what, where=path)
        found[quantity[0]] = (index, quantity[1])
    turns = [sum(name in found for name in names) for names in (QUATERNION, VECTOR)]
    if any(axis not in found for axis in "xyz") or turns[0] not in (0, 4) or turns[1] not in (0, 3):
        raise UserError(
            what="columns are missing",
            where=path,
            expected="time_s, x_m, y_m, z_m, optionally qw, qx, qy, qz or rx, ry, rz",
            got=", ".join(names)[:80],
        )
    if turns[0]:
        unread += [names[found.pop(name)[0]] for name in VECTOR if name in found]
    return Columns(found, tuple(unread))


def quantity_of(name: str) -> tuple[str, float] | None:
    """Quantity and factor to SI of a column of this name; None for what is not read."""
    split = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name.strip())
    words = [word for word in re.split(r"[^a-z0-9]+", split.lower().replace("\u00b5", "u")) if word]
    unit = words.pop() if len(words) > 1 and words[-1] in _UNITS else None
    return _named(words, unit)


def _named(words: list[str], unit: str | None) -> tuple[str, float] | None:
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
    degrees = [name for name in columns.unread if re.match("[^a-z]*r[xyz]([^a-z]|$)", name.lower())]
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
