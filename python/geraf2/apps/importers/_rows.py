"""Arrays whose rows are antennas, read in blocks of rows."""

import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy_format

from geraf2._types import Array, Bools
from geraf2.errors import UserError
from geraf2.io.arrays import BROKEN_ARRAY
from geraf2.io.file_kinds import refuse_other_kind

# Bytes of an array that are held at a time.
BLOCK_BYTES = 1 << 24

Rows = Callable[[int, int], Array]
"""Reads rows from one index up to another."""


def wrong_shape(where: object, name: str, expected: object, got: object) -> UserError:
    """UserError for an array of the wrong shape or dtype; `got` is its shape, or the array."""
    if isinstance(got, np.ndarray):
        got = f"{got.dtype} {got.shape}"
    return UserError(
        what=f"{name} has the wrong shape or dtype", where=where, expected=expected, got=got
    )


def require_equal(what: str, where: object, expected: object, got: object) -> None:
    """Raise UserError unless two values are equal."""
    if got != expected:
        raise UserError(what=what, where=where, expected=expected, got=got)


def left_out(text: str, keep_good: bool, where: object, **details: Any) -> str:
    """Note on an omitted broken part; UserError with `details` unless `keep_good`."""
    if not keep_good:
        raise UserError(what=text, where=where, **details)
    return text


def blocks(n_rows: int, row_bytes: int) -> Iterator[tuple[int, int]]:
    """Blocks of rows that fit in memory, as (first, stop)."""
    step = max(1, BLOCK_BYTES // max(1, row_bytes))
    for first in range(0, n_rows, step):
        yield first, min(first + step, n_rows)


def good_rows(
    read: Rows, n_rows: int, row_bytes: int, *, keep_good: bool, where: object, what: str
) -> tuple[Bools, list[str]]:
    """Mask of rows without NaN, and notes; UserError for others unless `keep_good`."""
    good = np.ones(n_rows, dtype=np.bool_)
    for first, stop in blocks(n_rows, row_bytes):
        part = read(first, stop).reshape(stop - first, -1)
        good[first:stop] = np.isfinite(part).all(axis=1)
    if good.all():
        return good, []
    text = f"{int((~good).sum())} of {n_rows} {what} hold NaN, first {int(np.argmin(good))}"
    left_out(text, keep_good, where, hint="--keep-good leaves them out")
    if not good.any():
        raise UserError(what=f"all {what} hold NaN", where=where)
    return good, [f"{text}; left out"]


class NpzRows:
    """One array of an .npz file, read in order from its beginning; C order only."""

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name = path, f"{name}.npy"
        self._handle: Any = None
        self._next = 0
        with self._open() as handle:
            self.shape, self.dtype = self._header(handle)

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return int(np.prod(self.shape[1:], dtype=np.int64)) * self.dtype.itemsize

    def read(self, first: int, stop: int) -> Array:
        """Rows from `first` to `stop`; fast where they follow the previous ones."""
        if self._handle is None or first < self._next:
            if self._handle is not None:
                self._handle.close()
            self._handle = self._open()
            self._header(self._handle)
            self._next = 0
        try:
            self._handle.seek((first - self._next) * self.row_bytes, 1)
            data = self._handle.read((stop - first) * self.row_bytes)
        except BROKEN_ARRAY as error:
            raise UserError(
                what=f"{self._name} cannot be read: {error}", where=self._path
            ) from None
        if len(data) != (stop - first) * self.row_bytes:
            raise UserError(what=f"{self._name} is cut short", where=self._path)
        self._next = stop
        if stop == self.shape[0]:
            self._handle.close()
            self._handle = None
        return np.frombuffer(data, dtype=self.dtype).reshape(stop - first, *self.shape[1:])

    def _open(self) -> Any:
        refuse_other_kind(self._path, ("zip",))
        try:
            with zipfile.ZipFile(self._path) as archive:
                return archive.open(self._name)
        except KeyError:
            what, name = "the file lacks the array", self._name[:-4]
            raise UserError(what=what, where=self._path, expected=name) from None
        except BROKEN_ARRAY as error:
            raise UserError(what=f"cannot be read: {error}", where=self._path) from None

    def _header(self, handle: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
        try:
            version = npy_format.read_magic(handle)
            read = (
                npy_format.read_array_header_1_0
                if version == (1, 0)
                else npy_format.read_array_header_2_0
            )
            shape, fortran, dtype = read(handle)
        except BROKEN_ARRAY as error:
            raise UserError(
                what=f"{self._name} cannot be read: {error}", where=self._path
            ) from None
        if dtype.hasobject or (fortran and len(shape) > 1):
            raise UserError(
                what=f"{self._name} is not a plain array in C order", where=self._path, got=dtype
            )
        return shape, dtype
