"""Reader of MATLAB files of version 5 to 7: arrays of numbers, alone or as fields of structs.

SciPy indexes a table by the number type of an element without a check, so that one broken byte may
end the process; and it reads all of a struct. Format: "MAT-File Format", The MathWorks.
"""

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geraf2._memory import require_memory
from geraf2._types import Array
from geraf2.errors import UserError
from geraf2.io.regular import open_regular

_HEADER_BYTES, _TAG_BYTES = 128, 8
_ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
# Enough of an array for its flags, dimensions and name.
_HEAD_BYTES = 1024
# Types of elements.
_NAME, _DIMENSIONS, _FLAGS, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4",
    7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
# Classes of arrays, and the flag of complex ones.
_STRUCT, _NUMERIC, _IS_COMPLEX = 2, range(6, 16), 0x800
_KINDS = {1: "cell", _STRUCT: "struct", 3: "object", 4: "text", 5: "sparse"}
# Structs within structs, and letters of a field's name.
_DEEPEST, _LONGEST_NAME = 4, 256


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A variable of a file."""

    name: str
    shape: tuple[int, ...]
    kind: str
    """Its class, as real, complex, text or struct."""
    values: Array | None = None
    """Of a real or complex array that was asked for, or lies in a struct."""
    fields: tuple["Variable", ...] = ()
    """Of a struct of one element."""

    def __str__(self) -> str:
        text = f"{self.name} {' x '.join(map(str, self.shape))} {self.kind}"
        return f"{text} of {', '.join(map(str, self.fields))}" if self.fields else text


class _BrokenError(Exception):
    """A broken element."""


def read_variables(path: Path, names: Collection[str]) -> list[Variable] | None:
    """Variables of a file, with the values of structs and of those in `names`.

    None for another version. UserError where an element is broken.
    """
    with open_regular(path) as handle:
        order = _ORDERS.get(handle.read(_HEADER_BYTES)[124:])
        if order is None:
            return None
        found, n_unpacked = [], 0
        hint = "save fewer antennas in a file, or without compression ('-v7.3')"
        try:
            while tag := handle.read(_TAG_BYTES):
                kind, n_bytes = struct.unpack(f"{order}II", tag)
                packed = b""
                if kind == _COMPRESSED:
                    packed = handle.read(n_bytes)
                    head = zlib.decompressobj().decompress(packed, _HEAD_BYTES)
                    kind, n_bytes = struct.unpack_from(f"{order}II", head)
                    head = head[_TAG_BYTES:]
                else:
                    head = handle.read(min(n_bytes, _HEAD_BYTES))
                if kind != _MATRIX:
                    raise _BrokenError
                variable = _variable(head, order, with_values=False)
                n_rest = n_bytes - len(head)
                if variable.name in names or variable.kind == "struct":
                    n_unpacked += n_bytes
                    require_memory(3.0 * n_unpacked, hint, where=path)
                    if packed:
                        whole = _TAG_BYTES + n_bytes
                        head = zlib.decompressobj().decompress(packed, whole)[_TAG_BYTES:]
                    else:
                        head += handle.read(n_rest)
                    if len(head) < n_bytes:
                        raise _BrokenError
                    variable = _variable(head, order)
                elif not packed:
                    handle.seek(n_rest, 1)
                found.append(variable)
        except (_BrokenError, struct.error, zlib.error):
            raise UserError(
                what=f"is damaged or cut short before byte {handle.tell()}",
                where=path,
                expected=f"arrays of numbers in {', '.join(sorted(names))}",
            ) from None
    return found


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Types and contents of the elements, one after the other."""
    at = 0
    while at < len(data):
        kind, n_bytes = struct.unpack_from(f"{order}II", data, at)
        begin = at + _TAG_BYTES
        at = begin + n_bytes + -n_bytes % 8
        if kind >> 16:  # up to four bytes of data in the tag itself
            kind, n_bytes, begin, at = kind & 0xFFFF, kind >> 16, begin - 4, begin
        if begin + n_bytes > len(data) or (begin % 8 and n_bytes > 4):
            raise _BrokenError
        yield kind, data[begin : begin + n_bytes]
    while True:
        yield 0, b""


def _variable(data: bytes, order: str, *, with_values: bool = True, depth: int = 0) -> Variable:
    """Variable of a matrix element; without values, its beginning suffices."""
    parts = _elements(data, order)
    kinds, (flags, dimensions, name) = zip(*(next(parts) for _ in range(3)), strict=True)
    if kinds != (_FLAGS, _DIMENSIONS, _NAME) or len(flags) != 8:
        raise _BrokenError
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    if min(shape, default=-1) < 0:
        raise _BrokenError
    bits = struct.unpack(f"{order}II", flags)[0]
    variable = Variable(
        name=name.decode("latin-1"), shape=shape, kind=_KINDS.get(bits & 0xFF, "other")
    )
    if bits & 0xFF in _NUMERIC:
        n_parts = 2 if bits & _IS_COMPLEX else 1
        values = _values(parts, order, shape, n_parts) if with_values else None
        return replace(variable, kind=("real", "complex")[n_parts - 1], values=values)
    is_read = with_values and math.prod(shape) == 1 and depth < _DEEPEST
    if bits & 0xFF == _STRUCT and is_read:
        return replace(variable, fields=tuple(_fields(parts, order, depth)))
    return variable


def _values(
    parts: Iterator[tuple[int, bytes]], order: str, shape: tuple[int, ...], n_parts: int
) -> Array:
    found = []
    for _ in range(n_parts):
        kind, data = next(parts)
        number = np.dtype(f"{order}{_NUMBERS.get(kind, 'f8')}")
        if kind not in _NUMBERS or len(data) != number.itemsize * math.prod(shape):
            raise _BrokenError
        found.append(np.frombuffer(data, number).reshape(shape, order="F"))
    return found[0] if n_parts == 1 else found[0] + 1j * found[1]


def _fields(parts: Iterator[tuple[int, bytes]], order: str, depth: int) -> Iterator[Variable]:
    (length_kind, length_data), (names_kind, names) = next(parts), next(parts)
    if (length_kind, names_kind) != (_DIMENSIONS, _NAME):
        raise _BrokenError
    (length,) = struct.unpack(f"{order}i", length_data)
    if not 0 < length <= _LONGEST_NAME or len(names) % length:
        raise _BrokenError
    for first in range(0, len(names), length):
        name = names[first : first + length].split(b"\0", 1)[0].decode("latin-1")
        kind, data = next(parts)
        if kind != _MATRIX:
            raise _BrokenError
        if data:  # else an empty one without a tag of its own
            yield replace(_variable(data, order, depth=depth + 1), name=name)
