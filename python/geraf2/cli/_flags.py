"""Command lines of frozen dataclasses: each field is a flag, its docstring the help."""

import ast
import inspect
import re
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, is_dataclass
from difflib import get_close_matches
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

from geraf2._bounds import check_bounds
from geraf2.cli._fields import Flag, fields_of, values_of, walk
from geraf2.errors import UserError

T = TypeVar("T")


def parse(
    kind: type[T],
    arguments: Sequence[str],
    *,
    prog: str,
    description: str = "",
    default: T | Mapping[str, Any] | None = None,
) -> T:
    """Read a command line into a dataclass.

    kind: frozen dataclass of scalars, `Literal`s, tuples of such, all these or None, dataclasses.
    prog: as users call it, for messages. description: first lines of the help.
    default: values instead of the fields' own: an instance, or some of the fields by name. A group
    has the type of its default, whatever union its field allows.

    Raises UserError, one line, where the arguments do not fit, and SystemExit after `--help`.
    """
    if not {"--help", "-h"}.isdisjoint(arguments):
        print(help_text(kind, prog=prog, description=description, default=default))
        raise SystemExit(0)
    defaults = values_of(default)
    flags = list(walk(kind, defaults))
    try:
        given = _read_given(flags, arguments)
        missing = [f.label for f in flags if f.default is MISSING and f.path not in given]
        if missing:
            raise UserError(what=f"missing from {prog}: {', '.join(missing)}")
        start = {name: value for name, value, _ in fields_of(kind, defaults)}
        made: T = _make(kind, start, given, (), {flag.path: flag.name for flag in flags})
    except UserError as error:
        raise UserError(what=str(error), hint=f"see '{prog} --help'") from error.__cause__
    return made


def value_of(flag: str, arguments: Sequence[str]) -> str | None:
    """Value of one flag, before the others can be read; None where it is not given."""
    found = None
    for word, following in pairwise([*arguments, ""]):
        if word == flag:
            found = following
        elif word.startswith(f"{flag}="):
            found = word.partition("=")[2]
    return found


def help_text(
    kind: type[Any], *, prog: str, description: str = "", default: Any = None, hidden: bool = False
) -> str:
    """Help of a command; if `hidden`, of its hidden groups alone, a sentence each."""
    flags = [flag for flag in walk(kind, values_of(default)) if flag.hidden == hidden]
    flags = [flag for flag in flags if not flag.is_fixed]
    width = min(shutil.get_terminal_size().columns, 100)
    usage = [f.name if f.default is MISSING else f"[{f.name}]" for f in flags if f.in_place]
    lines = [" ".join(["usage:", prog, *usage, "[FLAGS]"]), "", description, ""]
    shown: object = ()
    for flag in sorted(flags, key=lambda flag: not flag.in_place):
        if not flag.in_place and flag.group != shown:
            shown = flag.group
            lines += ["", *textwrap.wrap(_title(flags, flag.group), width)]
        if flag.group and flag.group[3]:
            continue
        text = _text(flag.owner, flag.path[-1])
        if hidden:
            text = re.split(r"(?<=[.])\s(?=[A-Z])", text)[0]
        lines.append(f"  {flag.label}")
        lines += [
            f"      {line}"
            for line in textwrap.wrap(f"{text} {_show_default(flag.default)}".strip(), width - 6)
        ]
    return "\n".join(lines)


def _title(flags: Sequence[Flag], group: tuple[str, type[Any], str, str] | None) -> str:
    """Heading of a group's flags, or one line where another command explains them."""
    if group is None:
        return "flags, in any order:"
    prefix, owner, name, see = group
    title = ": ".join(filter(None, (prefix, _text(owner, name)))).rstrip(".")
    if not see:
        return f"{title}:"
    names = [flag.name.removeprefix(f"{prefix}.") for flag in flags if flag.group == group]
    return f"{title}, explained by `{see} --help`: {', '.join(names)}."


def _show_default(default: Any) -> str:
    """Default of a flag for its help; nothing where it is nothing."""
    if default in (MISSING, None, (), "") or isinstance(default, bool):
        return ""
    words = default if isinstance(default, tuple) else (default,)
    return f"(default: {' '.join(map(str, words))})"


def _text(owner: type[Any], name: str) -> str:
    return next((texts[name] for texts in map(_texts, owner.__mro__) if name in texts), "")


@cache
def _texts(kind: type[Any]) -> dict[str, str]:
    """Docstrings of the fields that a dataclass adds to those it inherits."""
    if not is_dataclass(kind):
        return {}
    tree = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    texts = {}
    for pair in pairwise(tree.body if isinstance(tree, ast.ClassDef) else ()):
        match pair:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                texts[name] = " ".join(text.split())
    return texts


def _read_given(flags: Sequence[Flag], arguments: Sequence[str]) -> dict[tuple[str, ...], Any]:
    """Values that a command line gives, by path."""
    # The name of a preset among its constants is hidden by the flag that chooses the preset.
    fixed_first = sorted(flags, key=lambda flag: not flag.is_fixed)
    named = {flag.name: flag for flag in fixed_first if not flag.in_place}
    positional = [flag for flag in flags if flag.in_place]
    given: dict[tuple[str, ...], Any] = {}
    rest, in_place = list(arguments), list[str]()
    while rest:
        word = rest.pop(0)
        name, equals, value = word.partition("=")
        name = name.replace("_", "-")
        if not _is_flag(word):
            in_place.append(word)
            continue
        if name not in named:
            raise UserError(what=f"unknown flag {name}{_suggestion(name, named)}")
        flag, words = named[name], [value] if equals else []
        if equals and flag.counts[1] == 0:
            raise UserError(what=f"{name} takes no value", got=repr(value))
        while not equals and rest and len(words) < flag.counts[1] and not _is_flag(rest[0]):
            words += flag.split(rest.pop(0))
        given[flag.path] = flag.read(flag.split(words[0]) if equals else words)
    for index, flag in enumerate(positional[: len(in_place)]):
        # A flag of several words leaves one word to each positional flag after it.
        n = len(in_place) - (len(positional) - index - 1) if flag.counts[1] > 1 else 1
        given[flag.path] = flag.read(in_place[:n])
        del in_place[: max(n, 1)]
    if in_place:
        raise UserError(what=f"unexpected argument {in_place[0]!r}")
    return given


def _suggestion(name: str, named: Mapping[str, Flag]) -> str:
    """Suggest flags of groups with this ending, else the nearest flag, in brackets."""
    near = [flag.label for end, flag in named.items() if end.endswith(f".{name.lstrip('-')}")]
    if near:
        return f" (did you mean {' or '.join(near[:3])}?)"
    return "".join(
        f" (did you mean {named[close].label}?)" for close in get_close_matches(name, named, 1)
    )


def _is_flag(word: str) -> bool:
    """Whether it starts with a dash and is no number."""
    if len(word) < 2 or not word.startswith("-"):
        return False
    try:
        float(word)
    except ValueError:
        return True
    return False


def _make(
    kind: type[Any],
    start: Mapping[str, Any],
    given: Mapping[tuple[str, ...], Any],
    at: tuple[str, ...],
    names: Mapping[tuple[str, ...], str],
) -> Any:
    """Make a dataclass of values to start with and those given, by path below `at`."""
    values = dict(start)
    for name in {path[0] for path in given}:
        inner = {path[1:]: value for path, value in given.items() if path[0] == name}
        if () in inner:
            values[name] = inner[()]
        else:
            group = start[name]
            values[name] = _make(type(group), values_of(group), inner, (*at, name), names)
    try:
        made = kind(**values)
        check_bounds(made)
    except ValueError as error:
        # The message of a check begins with the name of the field.
        name, _, rest = str(error).partition(" ")
        flag = names.get((*at, name))
        raise UserError(what=f"{flag} {rest}" if flag else str(error)) from error
    return made
