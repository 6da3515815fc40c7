"""Notes in the types of fields: bounds of numbers, once for flags, TOML and Python, and flags.

A record that is made in Python checks itself (:class:`Bounded`); flags make it so, and TOML files
are checked by the same types (`geraf2.io.toml`). Bounds are broad: they keep out what crashes,
fills the memory or never ends, not a poor choice.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Interval, MinLen

from geraf2.errors import UserError

LengthM = Annotated[float, Interval(gt=0.0, le=1e3)]
MarginM = Annotated[float, Interval(ge=0.0, le=1e3)]
SignedM = Annotated[float, Interval(ge=-1e3, le=1e3)]
CellM = Annotated[float, Interval(ge=1e-5, le=1.0)]
"""Side of a voxel, a facet, a cell."""
ApertureM = Annotated[float, Interval(ge=1e-3, le=10.0)]
CoordinateM = Annotated[float, Interval(ge=-1e6, le=1e6)]
Triple = tuple[CoordinateM, CoordinateM, CoordinateM]
SideM = Annotated[float, Interval(ge=1e-3, le=1e3)]
Sides = tuple[SideM, SideM, SideM]
Degrees = Annotated[float, Interval(ge=-3600.0, le=3600.0)]
MarginRad = Annotated[float, Interval(ge=0.0, le=math.pi)]
Decibels = Annotated[float, Interval(gt=0.0, le=300.0)]
SignedDb = Annotated[float, Interval(ge=-300.0, le=300.0)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
OpenShare = Annotated[float, Interval(gt=0.0, lt=1.0)]
Power = Annotated[float, Interval(ge=0.0, le=100.0)]
Positive = Annotated[float, Interval(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Interval(ge=0.0, le=1e9)]
Seconds = Annotated[float, Interval(gt=0.0, le=1e6)]
Few = Annotated[int, Interval(ge=1, le=10_000)]
Count = Annotated[int, Interval(ge=1, le=10**9)]
CountOrZero = Annotated[int, Interval(ge=0, le=10**9)]
SampleCount = Annotated[int, Interval(ge=1, le=10**7)]
ChannelCount = Annotated[int, Interval(ge=2, le=4096)]
Rounds = Annotated[int, Interval(ge=0, le=1000)]
Seed = Annotated[int, Interval(ge=0, le=2**63 - 1)]
MAX_THREADS = 1024
"""A thousand threads are more than any machine has cores; a million end the process."""
ThreadCount = Annotated[int, Interval(ge=1, le=MAX_THREADS)]

Check = Callable[[str, Any], None]


@dataclass(frozen=True)
class Arg:
    """How a field appears on the command line; part of its `Annotated`."""

    metavar: str | None = None
    """Placeholder of the value; derived from the type when not given."""
    name: str | None = None
    """Name instead of the field's; "" of a group: its flags have no group's name."""
    hidden: bool = False
    """Whether a group is read, but not shown by `--help`."""
    see: str = ""
    """Command that explains the flags of a group; `--help` lists only their names."""


class BoundsError(UserError, ValueError):
    """A value lies outside the bounds of its field, whose name the message begins with."""


class Bounded:
    """Base of dataclasses that check their fields; one with a `__post_init__` calls this one."""

    def __post_init__(self) -> None:
        """Raise BoundsError for a value out of bounds."""
        check_bounds(self)


def check_bounds(record: object) -> None:
    """Raise BoundsError where a field of a dataclass is out of the bounds of its type."""
    kind: Any = type(record)
    for name, check in _checks_of(kind):
        check(name, getattr(record, name))


@cache
def _checks_of(kind: Any) -> tuple[tuple[str, Check], ...]:
    """Names of the fields with bounds, each with its check."""
    hints = get_type_hints(kind, include_extras=True)
    checks = ((name, _check_of(hint)) for name, hint in hints.items())
    return tuple((name, check) for name, check in checks if check is not None)


def _check_of(hint: Any) -> Check | None:
    """Check of a type; None where it has no bounds."""
    if get_origin(hint) is Annotated:
        bare, *notes = get_args(hint)
        found = [_note_check(bare, note) for note in notes if isinstance(note, Interval | MinLen)]
        return _all_of([_check_of(bare), *found])
    if get_origin(hint) is Literal:
        return lambda name, value: _check_choice(name, value, get_args(hint))
    if get_origin(hint) in (Union, UnionType):
        others = [kind for kind in get_args(hint) if get_origin(kind) is not Literal]
        options = [_check_of(kind) for kind in others if kind is not NoneType]
        inner = _all_of(options)
        if inner is None:
            return None
        return lambda name, value: None if value is None else inner(name, value)
    if get_origin(hint) is tuple:
        kinds = get_args(hint)
        each = [_check_of(kind) for kind in kinds if kind is not Ellipsis]
        if not any(each):
            return None
        length = None if kinds[-1] is Ellipsis else len(kinds)
        return lambda name, value: _check_tuple(name, value, each, length)
    return None


def _all_of(checks: list[Check | None]) -> Check | None:
    some = [check for check in checks if check is not None]
    if len(some) < 2:
        return some[0] if some else None

    def check(name: str, value: Any) -> None:
        for one in some:
            one(name, value)

    return check


def _check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    if value not in choices:
        msg = f"{name} must be one of {', '.join(map(str, choices))}, got {value!r}"
        raise BoundsError(msg)


def _check_tuple(name: str, value: Any, each: list[Check | None], length: int | None) -> None:
    if not hasattr(value, "__len__") or length not in (None, len(value)):
        msg = f"{name} must be {length or 'some'} numbers, got {value!r}"
        raise BoundsError(msg)
    for number, entry in enumerate(value):
        check = each[number if length else 0]
        if check is not None:
            check(name, entry)


def _note_check(bare: Any, note: Interval | MinLen) -> Check:
    if isinstance(note, MinLen):
        return lambda name, value: _check_length(name, value, note.min_length)
    whole, limits = bare is int, note

    def check(name: str, value: Any) -> None:
        kind = Integral if whole else Real
        if isinstance(value, bool) or not isinstance(value, kind):
            msg = f"{name} must be a {'whole ' * whole}number, got {value!r}"
            raise BoundsError(msg)
        if not _is_inside(value, limits):
            msg = f"{name} must be {_in_words(limits, value)}, got {value!r}"
            raise BoundsError(msg)

    return check


def _check_length(name: str, value: Any, least: int) -> None:
    if len(value) < least:
        msg = f"{name} must have at least {least} value{'s' * (least > 1)}, got {len(value)}"
        raise BoundsError(msg)


def _is_inside(value: Any, limits: Interval) -> bool:
    """Whether a number lies in an interval; NaN lies in none."""
    return bool(
        value == value  # noqa: PLR0124 - false of NaN alone
        and (limits.gt is None or value > limits.gt)
        and (limits.ge is None or value >= limits.ge)
        and (limits.lt is None or value < limits.lt)
        and (limits.le is None or value <= limits.le)
    )


def _in_words(limits: Interval, value: Any) -> str:
    """Interval in words, without the end that a value keeps; NaN keeps neither."""
    low = "" if limits.gt is None else f"above {_short(limits.gt)}"
    low = low if limits.ge is None else f"at least {_short(limits.ge)}"
    high = "" if limits.lt is None else f"below {_short(limits.lt)}"
    high = high if limits.le is None else f"at most {_short(limits.le)}"
    if low and high and value == value:  # noqa: PLR0124 - no NaN
        least = limits.gt if limits.ge is None else limits.ge
        return low if value <= least else high
    return " and ".join(filter(None, (low, high)))


def _short(value: Any) -> str:
    return f"{value:g}"
