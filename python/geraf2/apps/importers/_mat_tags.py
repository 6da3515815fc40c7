"""Check of the tags of a MATLAB file of version 5 to 7, before SciPy reads it.

SciPy indexes a table by the number type of an element without a check, so that one broken byte may
end the process. zlib checks compressed variables.
"""

import math
import struct
import zlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from geraf2._memory import require_memory
from geraf2.errors import UserError
from geraf2.io.regular import open_regular

_HEADER_BYTES, _TAG_BYTES = 128, 8
_MATRIX, _COMPRESSED = 14, 15
# Enough of a compressed array for its flags, dimensions and name.
_HEAD_BYTES = 1024
_FLAGS, _DIMENSIONS, _NAME = 6, 5, 1
# Bytes of a number by the type of an element: integers and floats.
_NUMBER_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
# Classes of arrays of numbers, and the flag of complex ones; others, and the types of text.
_NUMERIC_CLASSES, _IS_COMPLEX = range(6, 16), 0x800
_STRUCT, _TEXT, _TEXT_KINDS = 2, 4, (1, 2, 4, 16, 17, 18)
_KINDS = {1: "cell", _STRUCT: "struct", 3: "object", _TEXT: "text", 5: "sparse"}
# Structs within structs, and letters of a field's name.
_DEEPEST, _LONGEST_NAME = 4, 256


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A variable of a file, by its tags."""

    name: str
    shape: tuple[int, ...]
    kind: str
    """Its class, as real, complex, text or struct."""
    fields: tuple["Variable", ...] = ()
    """Of a struct of one element that holds nothing but numbers, text and such structs."""

    def __str__(self) -> str:
        text = f"{self.name} {' x '.join(map(str, self.shape))} {self.kind}"
        return f"{text} of {', '.join(map(str, self.fields))}" if self.fields else text


def sound_variables(path: Path, names: Collection[str]) -> list[Variable]:
    """Variables of a file; UserError where one of `names` is neither numbers nor a struct.

    Or where any tag is broken. Empty for version 4, which SciPy reads without such a table.
    """
    with open_regular(path) as handle:
        version = handle.read(_HEADER_BYTES)[124:]
        orders = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
        if version not in orders:
            return []
        end, at, n_unpacked, found = path.stat().st_size, _HEADER_BYTES, 0, []
        hint = "save fewer antennas in a file, or without compression ('-v7.3')"
        try:
            while at < end:
                kind, begin, stop, at = _element(handle, orders[version], at, end)
                file: BinaryIO = handle
                if kind == _COMPRESSED:
                    handle.seek(begin)
                    packed = handle.read(stop - begin)
                    head = zlib.decompressobj().decompress(packed, _HEAD_BYTES)
                    is_whole, n_bytes = _is_needed(head, orders[version], names)
                    n_unpacked += n_bytes
                    require_memory(3.0 * n_unpacked, hint, where=path)
                    # Its numbers are checked by zlib; of a struct, the tags of the fields matter.
                    head = zlib.decompress(packed) if is_whole else head
                    file, begin, stop = BytesIO(head), _TAG_BYTES, len(head)
                elif kind != _MATRIX:
                    raise _BrokenError(begin)
                is_known = kind == _MATRIX
                found.append(_variable(file, orders[version], begin, stop, names, check=is_known))
        except (_BrokenError, struct.error, zlib.error):
            raise UserError(
                what=f"is damaged or cut short before byte {at}, or holds other than numbers",
                where=path,
                expected=f"arrays of numbers in {', '.join(sorted(names))}",
            ) from None
    return found


class _BrokenError(Exception):
    """A broken element."""


class _ForeignError(Exception):
    """A field that is neither numbers nor text."""


def _element(handle: BinaryIO, order: str, at: int, end: int) -> tuple[int, int, int, int]:
    """Type of an element, begin and end of its data, and begin of the next element."""
    handle.seek(at)
    kind, n_bytes = struct.unpack(f"{order}II", handle.read(_TAG_BYTES))
    if kind >> 16:  # up to four bytes of data in the tag itself
        kind, n_bytes, begin = kind & 0xFFFF, kind >> 16, at + 4
        after = at + _TAG_BYTES
        is_good = n_bytes <= 4
    else:
        begin = at + _TAG_BYTES
        after = begin + n_bytes + (0 if kind == _COMPRESSED else -n_bytes % 8)
        is_good = True
    if not is_good or begin + n_bytes > end:
        raise _BrokenError(at)
    return kind, begin, begin + n_bytes, after


def _is_needed(head: bytes, order: str, names: Collection[str]) -> tuple[bool, int]:
    """Whether a compressed variable is a struct, and its unpacked bytes if it is read."""
    kind, n_bytes = struct.unpack_from(f"{order}II", head)
    if kind != _MATRIX:
        raise _BrokenError(0)
    bits, _, name, _ = _head(BytesIO(head), order, _TAG_BYTES, len(head))
    is_struct = bits & 0xFF == _STRUCT
    return is_struct, n_bytes if is_struct or name in names else 0


def _head(handle: BinaryIO, order: str, at: int, end: int) -> tuple[int, tuple[int, ...], str, int]:
    """Return flags, shape and name of a variable, and begin of what follows."""
    kinds, parts = [], []
    for _ in range(3):
        kind, begin, stop, at = _element(handle, order, at, end)
        handle.seek(begin)
        kinds.append(kind)
        parts.append(handle.read(stop - begin))
    flags, dimensions, name = parts
    if kinds != [_FLAGS, _DIMENSIONS, _NAME] or len(flags) != 8 or len(dimensions) % 4:
        raise _BrokenError(at)
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    if min(shape, default=-1) < 0:
        raise _BrokenError(at)
    return struct.unpack(f"{order}II", flags)[0], shape, name.decode("latin-1"), at


def _variable(
    handle: BinaryIO,
    order: str,
    at: int,
    end: int,
    names: Collection[str] | None,
    *,
    check: bool = True,
    depth: int = 0,
) -> Variable:
    """Read a variable by its tags; of one of `names` (None: any), check its numbers too."""
    bits, shape, name, at = _head(handle, order, at, end)
    kind, is_wanted = bits & 0xFF, names is None or name in names
    text = _KINDS.get(kind, "other")
    if kind in _NUMERIC_CLASSES:
        text = "complex" if bits & _IS_COMPLEX else "real"
        if check and is_wanted:
            _check_numbers(handle, order, at, end, shape, n_parts=2 if bits & _IS_COMPLEX else 1)
    elif kind == _STRUCT and math.prod(shape) == 1 and depth < _DEEPEST:
        try:
            fields = _fields(handle, order, at, end, depth)
        except _ForeignError:
            if names is None:
                raise
            fields = ()
        return Variable(name=name, shape=shape, kind=text, fields=fields)
    elif names is None and kind != _TEXT:
        raise _ForeignError
    elif is_wanted and names is not None and kind != _STRUCT:
        raise _BrokenError(at)
    elif kind == _TEXT and names is None:
        kind, begin, *_ = _element(handle, order, at, end)
        if kind not in _TEXT_KINDS:
            raise _BrokenError(begin)
    return Variable(name=name, shape=shape, kind=text)


def _check_numbers(
    handle: BinaryIO, order: str, at: int, end: int, shape: tuple[int, ...], *, n_parts: int
) -> None:
    for _ in range(n_parts):
        kind, begin, stop, at = _element(handle, order, at, end)
        if stop - begin != _NUMBER_BYTES.get(kind, -1) * math.prod(shape):
            raise _BrokenError(begin)


def _fields(handle: BinaryIO, order: str, at: int, end: int, depth: int) -> tuple[Variable, ...]:
    """Fields of a struct of one element; _ForeignError if one is neither numbers nor text."""
    kind, begin, stop, at = _element(handle, order, at, end)
    handle.seek(begin)
    if kind != _DIMENSIONS or stop - begin != 4:
        raise _BrokenError(begin)
    (length,) = struct.unpack(f"{order}i", handle.read(4))
    kind, begin, stop, at = _element(handle, order, at, end)
    if kind != _NAME or not 0 < length <= _LONGEST_NAME or (stop - begin) % length:
        raise _BrokenError(begin)
    handle.seek(begin)
    data, fields = handle.read(stop - begin), []
    for first in range(0, len(data), length):
        name = data[first : first + length].split(b"\0", 1)[0].decode("latin-1")
        kind, begin, stop, at = _element(handle, order, at, end)
        if kind != _MATRIX:
            raise _BrokenError(begin)
        if stop > begin:  # else an empty one without a tag of its own
            found = _variable(handle, order, begin, stop, None, depth=depth + 1)
            fields.append(replace(found, name=name))
    return tuple(fields)
