"""Tables of numbers as robots and loggers write them: CSV of several dialects, and NPY."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.apps.importers._log_columns import quantity_of
from geraf2.apps.importers._rows import require_equal
from geraf2.errors import UserError
from geraf2.io.arrays import read_npy
from geraf2.io.text import read_lines

_NAMES = ["time", "x", "y", "z", "qw", "qx", "qy", "qz"]
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def read_table(path: Path) -> tuple[Floats, list[str], list[str] | None, list[str]]:
    """Numbers, names of the columns, column `file` where there is one, and notes.

    Cells of columns that are not read may hold anything; they and empty cells become NaN.
    """
    return _read_npy(path) if path.suffix == ".npy" else _read_csv(path)


def _default_names(n_columns: int, path: Path) -> tuple[list[str], list[str]]:
    if n_columns == 3:
        return _NAMES[1:4], []
    if n_columns == 4:
        return _NAMES[:4], []
    if n_columns == 8:
        text = f"the columns of {path.name} have no names and were read as {' '.join(_NAMES)}"
        return _NAMES, [f"{text}; other logs have qx qy qz qw"]
    raise UserError(
        what="has the wrong number of columns",
        where=path,
        expected="3 (x y z), 4 (t x y z) or 8 (t x y z qw qx qy qz), or names in the first line",
        got=n_columns,
    )


def _read_npy(path: Path) -> tuple[Floats, list[str], None, list[str]]:
    array = read_npy(path)
    notes: list[str] = []
    if array.dtype.names:
        names = list(array.dtype.names)
        array = np.stack([array[name] for name in names], axis=-1)
    elif array.ndim == 2:
        names, notes = _default_names(array.shape[1], path)
    else:
        raise UserError(what="has the wrong shape", where=path, expected="(n, 4)", got=array.shape)
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise UserError(what="must hold rows of numbers", where=path, got=array.dtype)
    return array.astype(np.float64), names, None, notes


def _read_csv(path: Path) -> tuple[Floats, list[str], list[str] | None, list[str]]:
    lines = [line.strip() for line in read_lines(path)]
    lines = [line for line in lines if line and not re.fullmatch(r'"?sep=."?', line)]
    comments = [line.lstrip("#%").strip() for line in lines if line[0] in "#%"]
    lines = [line for line in lines if line[0] not in "#%"]
    if not lines:
        raise UserError(what="has no rows", where=path)
    # A semicolon goes before a comma, which may be decimal.
    delimiter = next((mark for mark in ";\t," if mark in lines[0]), None)
    rows = _cells(lines, delimiter, path)
    names = [cell.strip() for cell in rows[0]]
    notes: list[str] = []
    if any(name and not _is_number(name) for name in names):
        rows = rows[1:]
    else:
        known = _commented_names(comments, delimiter, len(names), path)
        n_columns = len(rows[0]) - all(not row[-1].strip() for row in rows)
        names, notes = (known, []) if known else _default_names(n_columns, path)
    if len(names) > 1 and not names[-1]:  # a delimiter at the end of each line
        names = names[:-1]
    if not rows:
        raise UserError(what="has no rows", where=path)
    for row in rows:
        if len(row) == len(names) + 1 and not row[-1].strip():
            row.pop()
        require_equal("rows and names differ in number", path, len(names), len(row))
    at = next((index for index, name in enumerate(names) if name.lower() == "file"), None)
    files = None if at is None else [row[at].strip() for row in rows]
    columns = [_numbers(rows, index, name, delimiter, path) for index, name in enumerate(names)]
    kept = [index for index in range(len(names)) if index != at]
    table = np.stack([columns[index] for index in kept], axis=1)
    return table, [names[index] for index in kept], files, notes


def _cells(lines: Sequence[str], delimiter: str | None, path: Path) -> list[list[str]]:
    if delimiter is None:
        return [line.split() for line in lines]
    try:
        return list(csv.reader(lines, delimiter=delimiter, skipinitialspace=True))
    except csv.Error as error:
        raise UserError(what=f"cannot be read as a table: {error}", where=path) from None


def _commented_names(
    comments: Sequence[str], delimiter: str | None, n_columns: int, path: Path
) -> list[str] | None:
    """Names in the last comment that has as many words as the rows have columns, and axes."""
    for line in reversed(comments):
        for mark in (delimiter, None):
            names = [name.strip() for name in _cells([line], mark, path)[0]] if line else []
            found = {quantity[0] for name in names if (quantity := quantity_of(name))}
            if len(names) == n_columns and {"x", "y", "z"} <= found:
                return names
    return None


def _numbers(
    rows: Sequence[Sequence[str]], index: int, name: str, delimiter: str | None, path: Path
) -> Floats:
    """Column of numbers; where it is read, UserError for other cells."""
    cells = [row[index].strip() for row in rows]
    if delimiter != ",":
        cells = [
            cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells
        ]
    try:
        return np.array([float(cell or "nan") for cell in cells])
    except ValueError:
        pass
    bad = next(row for row, cell in enumerate(cells) if cell and not _is_number(cell))
    if quantity_of(name) is not None:
        raise UserError(
            what=f"cannot be read as numbers: row {bad + 1}, column {name!r}",
            where=path,
            got=repr(cells[bad][:40]),
        )
    return np.full(len(rows), np.nan)


def _is_number(word: str) -> bool:
    try:
        float(word.replace(",", "."))
    except ValueError:
        return False
    return True
