"""Check of the tags of a MATLAB file of version 5 to 7, before SciPy reads it.

SciPy indexes a table by the number type of an element without a check, so that one broken byte may
end the process. zlib checks compressed variables.
"""

import math
import struct
import zlib
from collections.abc import Collection
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
# Classes of arrays of numbers, and the flag of complex ones.
_NUMERIC_CLASSES, _IS_COMPLEX = range(6, 16), 0x800


def require_sound_tags(path: Path, names: Collection[str]) -> None:
    """Raise UserError where an array of `names` is no array of numbers, or any tag is broken."""
    with open_regular(path) as handle:
        version = handle.read(_HEADER_BYTES)[124:]
        orders = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
        if version not in orders:  # version 4, which SciPy reads without such a table
            return
        end, at, n_unpacked = path.stat().st_size, _HEADER_BYTES, 0
        try:
            while at < end:
                kind, begin, stop, at = _element(handle, orders[version], at, end)
                if kind == _MATRIX:
                    _check_array(handle, orders[version], begin, stop, names)
                elif kind == _COMPRESSED:
                    handle.seek(begin)
                    head = zlib.decompressobj().decompress(
                        handle.read(min(stop - begin, _HEAD_BYTES)), _HEAD_BYTES
                    )
                    n_unpacked += _unpacked_bytes(head, orders[version], names)
                else:
                    raise _BrokenError(begin)
            hint = "save fewer antennas in a file, or without compression ('-v7.3')"
            require_memory(3.0 * n_unpacked, hint, where=path)
        except (_BrokenError, struct.error, zlib.error):
            raise UserError(
                what=f"is damaged or cut short before byte {at}, or holds other than numbers",
                where=path,
                expected=f"arrays of numbers in {', '.join(sorted(names))}",
            ) from None


class _BrokenError(Exception):
    """A broken element."""


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


def _unpacked_bytes(head: bytes, order: str, names: Collection[str]) -> int:
    """Unpacked bytes of a compressed array of `names`, by its tag; 0 for other arrays."""
    kind, n_bytes = struct.unpack_from(f"{order}II", head)
    if kind != _MATRIX:
        raise _BrokenError(0)
    at, name = _TAG_BYTES, b""
    for _ in range(3):  # flags, dimensions, name
        _, begin, stop, at = _element(BytesIO(head), order, at, len(head))
        name = head[begin:stop]
    return n_bytes if name.decode("latin-1") in names else 0


def _check_array(handle: BinaryIO, order: str, at: int, end: int, names: Collection[str]) -> None:
    """Check flags, dimensions and name; of an array of `names`, its numbers too."""
    kinds, parts = [], []
    for _ in range(3):
        kind, begin, stop, at = _element(handle, order, at, end)
        handle.seek(begin)
        kinds.append(kind)
        parts.append(handle.read(stop - begin))
    flags, dimensions, name = parts
    if kinds != [_FLAGS, _DIMENSIONS, _NAME] or len(flags) != 8 or len(dimensions) % 4:
        raise _BrokenError(begin)
    if name.decode("latin-1") not in names:
        return
    bits = struct.unpack(f"{order}II", flags)[0]
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    if bits & 0xFF not in _NUMERIC_CLASSES or min(shape, default=-1) < 0:
        raise _BrokenError(begin)
    for _ in range(2 if bits & _IS_COMPLEX else 1):
        kind, begin, stop, at = _element(handle, order, at, end)
        if stop - begin != _NUMBER_BYTES.get(kind, -1) * math.prod(shape):
            raise _BrokenError(begin)
