"""Arrays whose rows are antennas, read in blocks of rows."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from geraf2._types import Array, Bools
from geraf2.errors import UserError

# Bytes of an array that are held at a time.
BLOCK_BYTES = 1 << 24


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


def note_omission(
    text: str,
    keep_good: bool,
    where: object,
    hint: str | None = "--keep-good leaves them out",
    **details: Any,
) -> str:
    """Note on an omitted broken part; UserError with `details` unless `keep_good`."""
    if not keep_good:
        raise UserError(what=text, where=where, hint=hint, **details)
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
    note_omission(text, keep_good, where)
    if not good.any():
        raise UserError(what=f"all {what} hold NaN", where=where)
    return good, [f"{text}; left out"]
