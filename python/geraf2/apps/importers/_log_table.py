"""Table of a robot log: its rows of numbers, and the names of its columns.

The rows begin where numbers do. The names stand in the last line before them that names x, y and z,
perhaps behind a '#' or '%'. Programs of motion capture write lines about the take before the names,
name the bodies and quantities in further lines, and state units below the names or once for all::

    Format Version,1.23,Length Units,Meters                                  (OptiTrack Motive)
    ,Name,radar,radar,radar,radar,radar,radar,radar
    ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position
    Frame,Time (Seconds),X,Y,Z,W,X,Y,Z
"""

import csv
import posixpath
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import accumulate, pairwise, takewhile
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.apps.importers._log_columns import LogTable, Row, is_context, is_unit, quantity_of
from geraf2.apps.importers._rows import require_equal
from geraf2.errors import UserError
from geraf2.io.arrays import read_npy
from geraf2.io.text import read_lines

_NAMES = ["time", "x", "y", "z", "qw", "qx", "qy", "qz"]
# Points, poses, transforms and odometry without names, as 'ros2 topic echo --csv' prints them.
_STAMP = ["stamp_sec", "stamp_nanosec", "frame_id"]
_POSE = [*"xyz", "qx", "qy", "qz", "qw"]
_OF_ROS = (
    [*_STAMP, *"xyz"],
    [*_STAMP, *_POSE],
    [*_STAMP, "child_frame_id", *_POSE],
    [*_STAMP, "child_frame_id", *_POSE, *[""] * 78],
)
_DEFAULT_NAMES = {len(names): names for names in (_NAMES[1:4], _NAMES[:4], _NAMES, *_OF_ROS)}
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
# Fewest numbers in a row: a position.
_MIN_NUMBERS = 3
# Lines of Qualisys that name the bodies, and beginnings of others; it writes millimetres and does
# not say so.
_BODY_LINES = ("BODY_NAMES", "MARKER_NAMES")
_HEAD_LINES = ("NO_OF_", "DATA_INCLUDED")
_SECTION = re.compile("(Objects|Segments|Trajectories|Joints|Devices|Model Outputs),*")
_RATES = ("FREQUENCY", "Export Frame Rate")


def read_table(path: Path) -> LogTable:
    """Read the table of a log, NPY or text."""
    return _read_npy(path) if path.suffix == ".npy" else _read_csv(path)


def _default_names(n_columns: int, path: Path, *, is_of_ros: bool = False) -> tuple[Row, list[str]]:
    names = _DEFAULT_NAMES.get(n_columns)
    if names is None or (names in _OF_ROS) != is_of_ros:
        raise UserError(
            what="has the wrong number of columns",
            where=path,
            expected="3 (x y z), 4 (t x y z) or 8 (t x y z qw qx qy qz), or a line of names",
            got=n_columns,
        )
    if n_columns <= len("txyz"):
        return names, []
    text = f"the columns of {path.name} have no names and were read as {' '.join(names).strip()}"
    return names, [f"{text}; other logs have qx qy qz qw" if names is _NAMES else text]


def _read_npy(path: Path) -> LogTable:
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
    values = array.astype(np.float64)
    return LogTable(values=values, names=names, bodies=[""] * len(names), notes=notes)


def _read_csv(path: Path) -> LogTable:
    lines = _of_one_section([line.strip(" \r\n") for line in read_lines(path)])
    lines = [line for line in lines if line.strip() and not re.fullmatch(r'"?sep=."?', line)]
    comments = [line.lstrip("#%").strip() for line in lines if line[0] in "#%"]
    lines = [line for line in lines if line[0] not in "#%"]
    if not lines:
        raise UserError(what="has no rows", where=path)
    first = next((k for k, line in enumerate(lines) if _is_row(_cells([line], path)[0])), None)
    mark = _mark_of(lines[first or 0])
    cells = _cells(lines, path, mark)
    if first is None:  # the first rows may be broken
        first = int(any(cell and not _is_number(cell) for cell in cells[0]))
    if first >= len(cells):
        raise UserError(what="has no rows", where=path)
    while first and len(cells[first - 1]) == len(cells[first]) and _is_number(cells[first - 1][0]):
        first -= 1  # a row with empty cells
    head, rows = cells[:first], cells[first:]
    notes: list[str] = []
    names, bodies = _names_of(head) if head else ([], [])
    topics = [name for name in names if name.startswith("/")]
    topic = posixpath.commonpath(topics or [""])  # of all columns, as PlotJuggler names them
    names = [name.removeprefix(topic) for name in names]
    if not _has_axes(names):
        names = _commented_names(comments, mark, len(rows[0]), path) or names
    if not names:
        n_columns = len(rows[0]) - all(not row[-1] for row in rows)
        is_of_ros = n_columns > len(_STAMP) and not _is_number(rows[0][2])
        names, notes = _default_names(n_columns, path, is_of_ros=is_of_ros)
    if len(names) > 1 and not names[-1] and all(len(r) < len(names) or not r[-1] for r in rows):
        names = names[:-1]  # a delimiter at the end of each line
    bodies = (bodies if len(bodies) >= len(names) else [""] * len(names))[: len(names)]
    for row in rows:
        if len(row) == len(names) + 1 and not row[-1]:
            row.pop()
        require_equal("rows and names differ in number", path, len(names), len(row))
    at = next((index for index, name in enumerate(names) if name.lower() == "file"), None)
    kept = [index for index in range(len(names)) if index != at]
    return LogTable(
        values=np.stack([_numbers(rows, k, names[k], mark, path) for k in kept], axis=1),
        names=[names[k] for k in kept],
        bodies=[bodies[k] for k in kept],
        rate_hz=_rate_of(head),
        files=None if at is None else [row[at] for row in rows],
        notes=notes,
    )


def _of_one_section(lines: Row) -> Row:
    """Lines of the bodies, where Vicon exported several tables, or of the last table."""
    heads = [k for k, line in enumerate(lines) if _SECTION.fullmatch(line)]
    if len(heads) < 2:
        return lines
    at = next((i for i, k in enumerate(heads) if lines[k][:3] in ("Obj", "Seg")), len(heads) - 1)
    return lines[heads[at] : (*heads, len(lines))[at + 1]]


def _mark_of(line: str) -> str | None:
    """Delimiter; a semicolon goes before a comma, which may be decimal."""
    return next((mark for mark in ";\t," if mark in line), None)


def _cells(lines: Sequence[str], path: Path, mark: str | None = "") -> list[Row]:
    """Cells of each line; of a single one by its own delimiter where none is given."""
    mark = _mark_of(lines[0]) if mark == "" else mark
    if mark is None:
        return [line.split() for line in lines]
    try:
        rows = csv.reader(lines, delimiter=mark, skipinitialspace=True)
        return [[cell.strip() for cell in row] for row in rows]
    except csv.Error as error:
        raise UserError(what=f"cannot be read as a table: {error}", where=path) from None


def _is_row(cells: Row) -> bool:
    numbers = [_is_number(cell) for cell in cells if cell]
    return sum(numbers) >= _MIN_NUMBERS and 2 * sum(numbers) > len(numbers)


def _names_of(head: list[Row]) -> tuple[Row, Row]:
    """Names of the columns, with their units, and their bodies."""
    units: Row = []
    if all(is_unit(cell) for cell in head[-1] if cell):
        *head, units = head
    found = [k for k, names in enumerate(head) if _has_axes(_full_names(head, k)[0])]
    names, bodies = _full_names(head, found[-1] if found else len(head) - 1)
    stated = _stated(head, ("Length Units",))
    stated += ["mm" for row in head if row and row[0].startswith(_HEAD_LINES)]
    units = units or stated[:1] * len(names)
    whole = [f"{name} {unit}" for name, unit in zip(names, units, strict=False)]
    return [
        new if quantity_of(new) else name for name, new in zip(names, whole or names, strict=False)
    ], bodies


def _full_names(head: list[Row], at: int) -> tuple[Row, Row]:
    """Names in a line, after the quantities in the lines above, and the bodies in these lines."""
    names = head[at] if head else []
    above = head[:at][::-1]
    rows = [
        [*row, *[""] * (len(names) - len(row))][: len(names)]
        for row in takewhile(lambda row: _is_above(row, len(names)), above)
    ]
    known = [body for row in above if row and row[0] in _BODY_LINES for body in row[1:] if body]
    if known:  # before the name of the first column of each body, or of all
        own = [next((b for b in known if n.startswith(f"{b} ")), "") for n in names]
        names = [name[len(body) :].strip() for name, body in zip(names, own, strict=True)]
        rows = [own]
    filled = [list(accumulate(row, _filled)) for row in rows[::-1]]
    columns = list(zip(*filled, strict=True)) or [()] * len(names)
    context = [[cell for cell in cells if cell and is_context(cell)] for cells in columns]
    bodies = [" ".join(c for c in cells if c and not is_context(c)) for cells in columns]
    return [" ".join([*c, name]) for c, name in zip(context, names, strict=True)], bodies


def _filled(before: str, cell: str) -> str:
    return cell or before


def _is_above(row: Row, n_columns: int) -> bool:
    """Whether a line belongs to the names below it, and is no line about the take."""
    return not row[0] or (len(row) == n_columns and not any(map(_is_number, row)))


def _has_axes(names: Sequence[str]) -> bool:
    return {"x", "y", "z"} <= {found[0] for name in names if (found := quantity_of(name))}


def _stated(head: list[Row], names: Sequence[str]) -> Row:
    """Cells behind those that hold one of the names."""
    return [after for row in head for cell, after in pairwise(row) if cell in names]


def _rate_of(head: list[Row]) -> float | None:
    """Rows per second: behind its name, or a number alone in a line (Vicon)."""
    alone = [cells[0] for row in head if len(cells := [cell for cell in row if cell]) == 1]
    found = [
        float(text)
        for text in (*_stated(head, _RATES), *alone)
        if _is_number(text) and "," not in text
    ]
    return next((rate for rate in found if rate > 0), None)


def _commented_names(
    comments: Sequence[str], mark: str | None, n_columns: int, path: Path
) -> Row | None:
    """Names in the last comment that has as many words as the rows have columns, and axes."""
    lines = ((line, one) for line in filter(None, reversed(comments)) for one in (mark, None))
    tried = (_cells([line], path, one)[0] for line, one in lines)
    return next((names for names in tried if len(names) == n_columns and _has_axes(names)), None)


def _numbers(rows: Sequence[Row], index: int, name: str, mark: str | None, path: Path) -> Floats:
    """Column of numbers; where it is read, UserError for other cells."""
    cells = [row[index] for row in rows]
    if mark != ",":
        cells = [
            cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells
        ]
    try:
        return np.array([float(cell or "nan") for cell in cells])
    except ValueError:
        with suppress(ValueError):
            return np.array([_seconds(cell) for cell in cells])
    bad = next(k for k, cell in enumerate(cells) if cell and ("," in cell or not _is_number(cell)))
    if quantity_of(name) is not None:
        raise UserError(
            what=f"cannot be read as numbers: row {bad + 1}, column {name!r}",
            where=path,
            expected="numbers, and times in seconds or as 2026-01-31T12:00:00.0",
            got=repr(cells[bad][:40]),
        )
    return np.full(len(rows), np.nan)


def _seconds(cell: str) -> float:
    """Seconds since 1970 of a date and time of ISO 8601, in UTC unless it names a zone."""
    moment = datetime.fromisoformat(cell)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _is_number(word: str) -> bool:
    try:
        float(word.replace(",", "."))
    except ValueError:
        return False
    return True
