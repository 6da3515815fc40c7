"""Fields of frozen dataclasses as flags of a command line.

A nested dataclass is a group, whose flags have its name before theirs:
`--refine.silhouettes.max-tilt-deg`.
A field that is False is a flag that turns it on; one that is True has `no-` before its name.
"""

import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from geraf2._bounds import Arg
from geraf2.errors import UserError

T = TypeVar("T")

_METAVARS = {int: "INT", float: "FLOAT", str: "TEXT", Path: "PATH"}
_WRONG = {int: "not a whole number", float: "not a number"}


class _InPosition:
    """Marks a positional argument."""


Positional = Annotated[T, _InPosition()]


@dataclass(frozen=True)
class Flag:
    path: tuple[str, ...]
    """Names of the fields that lead to it."""
    name: str
    """As typed; the placeholder of the value of a positional argument."""
    kinds: tuple[Any, ...]
    """Type of each value, or of all; a tuple of words to choose from is one, too."""
    counts: tuple[int, int]
    """Fewest and most values."""
    default: Any
    metavar: str
    in_place: bool
    owner: type[Any]
    group: tuple[str, type[Any], str, str] | None
    """Prefix, the class and the field that hold it, and the command that explains it; None for the
    command's own flags."""
    hidden: bool

    @property
    def label(self) -> str:
        return f"{self.name} {self.metavar}".strip()

    @property
    def is_fixed(self) -> bool:
        """Whether it has one choice only, as the name of a preset among its constants."""
        return isinstance(self.kinds[0], tuple) and len(self.kinds[0]) == 1

    def split(self, word: str) -> list[str]:
        """Words of one: a flag of several numbers takes 0.2x0.2x0.1 and 0.2,0.2,0.1, too."""
        if self.counts[1] == 1 or not set(self.kinds) <= {int, float}:
            return [word]
        return [part for part in re.split(r"[x,]", word) if part] or [word]

    def read(self, words: Sequence[str]) -> Any:
        """Value of the words after the flag; UserError where they do not fit."""
        if self.counts == (0, 0):
            return not self.default
        if list(words) == ["None"] and self.default is None:
            return None
        if not self.counts[0] <= len(words) <= self.counts[1]:
            what = f"needs {self.counts[0]} value{'s' * (self.counts[0] > 1)}"
            raise self._error(what, " ".join(words) or "none")
        kinds = self.kinds * (len(words) if len(self.kinds) == 1 else 1)
        values = tuple(self._value(kind, word) for kind, word in zip(kinds, words, strict=True))
        return values[0] if self.counts[1] == 1 else values

    def _value(self, kind: Any, word: str) -> Any:
        if isinstance(kind, tuple):
            if word not in kind:
                near = did_you_mean(word, kind)
                raise self._error(what="no such choice", got=f"{word!r}{near}")
            return word
        try:
            return kind(word)
        except ValueError:
            raise self._error(_WRONG.get(kind, "wrong value"), repr(word)) from None

    def _error(self, what: str, got: str) -> UserError:
        return UserError(what, where=self.name, expected=self.metavar or None, got=got)


def walk(
    kind: type[Any],
    defaults: Mapping[str, Any],
    path: tuple[str, ...] = (),
    prefix: str = "--",
    group: tuple[str, type[Any], str, str] | None = None,
    hidden: bool = False,
) -> Iterator[Flag]:
    """Yield the flags of a dataclass, then those of its groups."""
    groups = []
    plain = get_type_hints(kind)  # without bounds, in unions and tuples, too
    for name, default, hint in fields_of(kind, defaults):
        notes = getattr(hint, "__metadata__", ())
        arg = next((note for note in notes if isinstance(note, Arg)), Arg())
        word = name.replace("_", "-") if arg.name is None else arg.name
        here = (*path, name)
        if is_dataclass(default):
            inner = f"{prefix}{word}." if word else prefix
            inner_group = (inner.rstrip("."), kind, name, arg.see) if word else group
            is_hidden = hidden or arg.hidden
            groups.append(
                walk(type(default), values_of(default), here, inner, inner_group, is_hidden)
            )
            continue
        kinds, counts, metavar = _read_type(plain[name])
        in_place = any(isinstance(note, _InPosition) for note in notes)
        if in_place:
            word = (arg.metavar or word.upper()).strip("[]")
        elif counts == (0, 0):
            word = f"{prefix}{'no-' * bool(default)}{word}"
        else:
            word = prefix + word
        metavar = "" if in_place else (arg.metavar or metavar)
        is_hidden = hidden or arg.hidden
        yield Flag(here, word, kinds, counts, default, metavar, in_place, kind, group, is_hidden)
    for flags in groups:
        yield from flags


def fields_of(kind: type[Any], defaults: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Name, default and type of each field."""
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        value, make = defaults.get(field.name, field.default), field.default_factory
        if value is MISSING and callable(make):
            value = make()
        if field.init:
            yield field.name, value, hints[field.name]


def part_of(config: Any, kind: type[T]) -> T:
    """Record of the fields that a config inherits from `kind`."""
    values: Any = {field.name: getattr(config, field.name) for field in fields(cast("Any", kind))}
    return kind(**values)


def values_of(default: Any) -> Mapping[str, Any]:
    """Fields of an instance by name."""
    if default is None or isinstance(default, Mapping):
        return default or {}
    return {field.name: getattr(default, field.name) for field in fields(default) if field.init}


def _read_type(hint: Any) -> tuple[tuple[Any, ...], tuple[int, int], str]:
    """Types of the values of a field, how many there may be, and their placeholder."""
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    options = tuple(option for option in options if option is not NoneType)
    if all(get_origin(option) is Literal for option in options):
        choices = tuple(word for option in options for word in get_args(option))
        return (choices,), (1, 1), f"{{{','.join(choices)}}}"
    kinds = get_args(options[0]) if get_origin(options[0]) is tuple else options
    if kinds == (bool,):
        return kinds, (0, 0), ""
    if kinds[-1] is Ellipsis:
        return kinds[:1], (0, sys.maxsize), f"{_METAVARS[kinds[0]]} ..."
    return kinds, (len(kinds), len(kinds)), " ".join(_METAVARS[kind] for kind in kinds)


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """Nearest name in brackets, to end a message; empty where none is near."""
    return "".join(f" (did you mean {name}?)" for name in get_close_matches(word, names, 1))
