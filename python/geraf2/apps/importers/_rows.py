"""Arrays whose rows are antennas, read in blocks of rows."""

import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format

from geraf2._types import Array, Bools
from geraf2.errors import UserError
from geraf2.io.arrays import BROKEN_ARRAY
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.regular import require_unpacked

# Bytes of an array that are held at a time.
BLOCK_BYTES = 1 << 24

_OLD_HEADER = npy_format.read_array_header_1_0


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


def note_omission(text: str, keep_good: bool, where: object, **details: Any) -> str:
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
    parts: Iterable[Array], *, keep_good: bool, where: object, what: str
) -> tuple[Bools, list[str]]:
    """Mask of rows without NaN, and notes; UserError for others unless `keep_good`."""
    masks = [np.isfinite(part.reshape(len(part), -1)).all(axis=1) for part in parts]
    good = np.asarray(np.concatenate(masks))
    if good.all():
        return good, []
    text = f"{int((~good).sum())} of {len(good)} {what} hold NaN, first {int(np.argmin(good))}"
    note_omission(text, keep_good, where, hint="--keep-good leaves them out")
    if not good.any():
        raise UserError(what=f"all {what} hold NaN", where=where)
    return good, [f"{text}; left out"]


class NpzRows:
    """One array of an .npz file, whose rows are read in blocks; C order only."""

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name = path, name
        refuse_other_kind(path, ("zip",))
        self.shape: tuple[int, ...]
        self.dtype: np.dtype[Any]
        with self._opened():
            pass

    def blocks(self) -> Iterator[Array]:
        """All rows, in parts that fit in memory."""
        with self._opened() as handle:
            row_bytes = int(np.prod(self.shape[1:], dtype=np.int64)) * self.dtype.itemsize
            for first, stop in blocks(self.shape[0], row_bytes):
                data = handle.read((stop - first) * row_bytes)
                if len(data) != (stop - first) * row_bytes:
                    raise UserError(what=f"{self._name} is cut short", where=self._path)
                yield np.frombuffer(data, dtype=self.dtype).reshape(-1, *self.shape[1:])

    @contextmanager
    def _opened(self) -> Iterator[IO[bytes]]:
        """Lend the array's file at its first row; its header sets shape and dtype."""
        name = f"{self._name}.npy"
        try:
            with zipfile.ZipFile(self._path) as archive, archive.open(name) as handle:
                part = archive.getinfo(name)
                require_unpacked(part.file_size, part.compress_size, self._path)
                is_old = npy_format.read_magic(handle) == (1, 0)
                read = _OLD_HEADER if is_old else npy_format.read_array_header_2_0
                self.shape, fortran, self.dtype = read(handle)
                if self.dtype.hasobject or (fortran and len(self.shape) > 1):
                    what = f"{name} is not a plain array in C order"
                    raise UserError(what=what, where=self._path, got=self.dtype)
                yield handle
        except KeyError:
            what = "the file lacks the array"
            raise UserError(what=what, where=self._path, expected=self._name) from None
        except BROKEN_ARRAY as error:
            raise UserError(what=f"{name} cannot be read: {error}", where=self._path) from None
