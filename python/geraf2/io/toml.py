"""TOML files from and to typed records: one reader, one writer, one wording of errors.

A record is a frozen dataclass or a pydantic model, with others inside it. Types are
strict: true is no number, "1" and 1.0 are no integer, an integer is a float; a list is a tuple,
text a path. A key that is not known is an error. What is None is left out of the file.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin, get_type_hints

import tomli_w

from geraf2.errors import UserError
from geraf2.io.atomic import write_text_atomic
from geraf2.io.regular import RECORD_BYTES
from geraf2.io.text import read_text

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_Record = TypeVar("_Record")
_MAX_COMPLAINTS = 4
_MAX_LEVELS = 32
_DEEP = re.compile(rf"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){{{_MAX_LEVELS}}}")


def read_toml(path: Path | Traversable, kind: type[_Record]) -> _Record:
    """Read a record from a TOML file; errors as those of :func:`from_table`."""
    return from_table(read_table(path), kind, path)


def write_toml(path: Path, value: Any) -> None:
    """Write a record to a TOML file, whole or not at all; :func:`read_toml` gives it back."""
    write_text_atomic(path, tomli_w.dumps(to_table(value)))


def read_table(path: Path | Traversable) -> dict[str, Any]:
    """Parse a TOML file; a UserError names the line that cannot be read."""
    text = read_text(path, RECORD_BYTES) if isinstance(path, Path) else path.read_text("utf-8")
    try:
        return parse_toml(text)
    except ValueError as error:
        raise UserError(what=f"is not valid TOML: {error}", where=path) from None


def parse_toml(text: str) -> dict[str, Any]:
    """Tables of TOML text; ValueError for what is none, or nested too deep."""
    try:
        if _DEEP.search(text):  # takes the parser quadratic time
            raise RecursionError
        table = tomllib.loads(text)
        _require_depth(table, _MAX_LEVELS)
    except RecursionError:
        msg = f"more than {_MAX_LEVELS} levels of tables and lists"
        raise ValueError(msg) from None
    return table


def _require_depth(value: Any, levels: int) -> None:
    """Raise RecursionError where tables and lists are nested deeper than some levels."""
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if levels < 0:
        raise RecursionError
    for entry in inside:
        _require_depth(entry, levels - 1)


def from_table(
    table: Any, kind: type[_Record] | tuple[type[_Record], ...], where: object
) -> _Record:
    """Check a table and make a record of it; a UserError has every complaint on one line.

    table: nested tables, as TOML gives them.
    kind: type of the record, or several, a `tuple[type[A | B], ...]`, between which the key
        `preset` chooses: in each a field whose type is a Literal.
    """
    from pydantic import ValidationError  # noqa: PLC0415 - 0.2 s to import

    one: Any = _preset_type(table, kind, where) if isinstance(kind, tuple) else kind
    try:
        # As JSON, because pydantic is strict there with lists for tuples and text for paths.
        record: _Record = _adapter(one).validate_json(json.dumps([table], default=str))[0]
    except ValidationError as error:
        items = error.errors(include_url=False)
        # pydantic counts the good entries of a tuple: with a bad one it is "too short", too.
        bad = {item["loc"][:n] for item in items for n in range(len(item["loc"]))}
        items = [item for item in items if item["type"] != "too_short" or item["loc"] not in bad]
        found = [_complaint(item, table, one) for item in items]
    else:
        return record
    rest = len(found) - _MAX_COMPLAINTS
    more = [f"and {rest} more"] if rest > 0 else []
    raise UserError("; ".join(found[:_MAX_COMPLAINTS] + more), where=where)


def to_table(value: Any) -> dict[str, Any]:
    """Nested tables, lists, numbers and text of a record; what is None is left out."""
    plain = _plain_value(value)
    if not isinstance(plain, dict):
        msg = f"only a record or a table becomes a table, got {type(value).__name__}"
        raise TypeError(msg)
    return plain


def merge_tables(low: Mapping[str, Any], high: Mapping[str, Any]) -> dict[str, Any]:
    """Nested tables of both; where both have a value, the second counts."""
    out = dict(low)
    for key, value in high.items():
        known = out.get(key)
        both = isinstance(known, Mapping) and isinstance(value, Mapping)
        out[key] = merge_tables(known, value) if both else value  # type: ignore[arg-type]
    return out


def nearest_name(name: str, known: Iterable[str]) -> str:
    """Suggest the name that was meant, ", did you mean ...?"; nothing where none is near."""
    near = get_close_matches(name, known, 1)
    return f", did you mean {near[0]!r}?" if near else ""


def _plain_value(value: Any) -> Any:
    if is_dataclass(value):
        value = {entry.name: getattr(value, entry.name) for entry in fields(value)}
    elif hasattr(value, "model_dump"):
        value = value.model_dump()
    if isinstance(value, Mapping):
        return {str(k): _plain_value(entry) for k, entry in value.items() if entry is not None}
    if isinstance(value, list | tuple):
        return [_plain_value(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value


@cache
def _adapter(kind: Any) -> Any:
    from pydantic import ConfigDict, TypeAdapter  # noqa: PLC0415 - 0.2 s to import

    # In a tuple, whose config applies to dataclasses inside; a lone dataclass accepts none.
    return TypeAdapter(tuple[kind], config=ConfigDict(extra="forbid", strict=True))


def _preset_type(
    table: Mapping[str, Any], kinds: tuple[type[_Record], ...], where: object
) -> type[_Record]:
    """Which of several types a table is of."""
    by_name = {name: k for k in kinds for name in get_args(get_type_hints(k)["preset"])}
    got = table.get("preset")
    if isinstance(got, str) and got in by_name:
        return by_name[got]
    unknown = f"key 'preset': unknown name {got!r}{nearest_name(str(got), by_name)}"
    raise UserError(
        what=unknown if "preset" in table else "key 'preset' is missing",
        where=where,
        expected="one of " + ", ".join(by_name),
    )


def _complaint(item: "ErrorDetails", table: Any, kind: Any) -> str:
    missing = item["type"] == "missing"
    location = _location(item["loc"][1:], table, missing=missing)
    key = _dotted_key(location)
    if missing:
        return f"key {key!r} is missing"
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"unknown key {key!r}" + nearest_name(
            str(location[-1]), _known_keys(kind, location[:-1])
        )
    if item["type"] == "value_error":  # of a __post_init__, which may name its own key
        reason = item["msg"].removeprefix("Value error, ")
        first = reason.split(maxsplit=1)[0].split(".")[0]
        if not location or first in location:
            return reason
        return f"{key}.{reason}" if first in _known_keys(kind, location) else f"{key}: {reason}"
    reason, got = item["msg"][:1].lower() + item["msg"][1:], repr(item["input"])
    got = got if len(got) <= 60 else got[:57] + "..."
    return (f"key {key!r}: " if key else "") + f"{reason}, got {got}"


def _location(
    location: tuple[int | str, ...], value: Any, *, missing: bool
) -> tuple[int | str, ...]:
    """Keys and indices of a complaint, without the names of types that pydantic puts between."""
    end = len(location) - missing
    out: list[int | str] = []
    for part in location[:end]:
        try:
            value = value[part]
        except (LookupError, TypeError):
            continue
        out.append(part)
    return (*out, *location[end:])


def _known_keys(kind: Any, location: tuple[int | str, ...]) -> set[str]:
    """Names of the keys that a table has at a location."""
    if members := get_args(kind):
        inside = location[1:] if get_origin(kind) in (tuple, list, dict) else location
        return set().union(*(_known_keys(member, inside) for member in members))
    names = getattr(kind, "__dataclass_fields__", None) or getattr(kind, "model_fields", None)
    if not names or not location:
        return set(names or ())
    return _known_keys(get_type_hints(kind).get(str(location[0])), location[1:])


def _dotted_key(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text
