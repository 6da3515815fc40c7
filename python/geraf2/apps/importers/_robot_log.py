"""Reader of robot logs: positions of the end effector, with their times."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from geraf2._types import Floats, Ints
from geraf2.apps.importers._log_columns import (
    QUATERNION,
    VECTOR,
    Columns,
    find_columns,
    quantity_of,
    require_read_turns,
)
from geraf2.apps.importers._rows import note_omission, require_equal
from geraf2.errors import UserError
from geraf2.io.arrays import read_npy
from geraf2.io.scan_file import ScanFile, read_scan_file
from geraf2.io.text import read_lines
from geraf2.scene.checks import MAX_ANTENNA_M

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


_UNIT_QUATERNION = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotLog:
    """Positions of the end effector, with time stamps or one for each frame."""

    path: Path
    positions: Floats
    """(n_rows, 3) [m]."""
    times_s: Floats | None = None
    quaternions: Floats | None = None
    """(n_rows, 4), w x y z, end effector to capture frame."""
    rows: Ints
    """Number of each row in the file, from 1."""
    is_whole: bool = True
    """Whether no row of the file was left out."""
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] | None = None
    """Name of the recording at each position, where the log has that column."""
    scan: ScanFile | None = None
    """Contents of a scan file, whose planes are separate poses."""

    @cached_property
    def rotations(self) -> Rotation:
        """Rotation of each row."""
        assert self.quaternions is not None
        return Rotation.from_quat(self.quaternions[:, [1, 2, 3, 0]])

    def rotations_at(self, times_s: Floats) -> Rotation:
        """Rotations at times within the log, (n,), along the shortest turn between its rows."""
        if len(self.positions) == 1:
            return self.rotations[np.zeros(len(times_s), dtype=np.int64)]
        return Slerp(self.times_s, self.rotations)(times_s)

    def positions_at(self, times_s: Floats) -> Floats:
        """Positions at any times, (..., 3) [m]; before and after the log those at its ends."""
        assert self.times_s is not None
        columns = [np.interp(times_s, self.times_s, self.positions[:, k]) for k in range(3)]
        return np.stack(columns, axis=-1)


def read_log(path: Path, *, keep_good: bool) -> RobotLog:
    """Read a robot log.

    path: CSV with a line of names (time_s, x_m, y_m, z_m, optionally qw, qx, qy, qz, or a rotation
        vector rx, ry, rz in radians; units mm, cm, ms, us, ns are converted, and names of other
        robots understood, see `_log_columns`) or without one (x y z, or t x y z), or NPY (n, 3),
        (n, 4) or (n, 8) in the order of these names, or with these field names. A CSV may have a
        column `file`, the name of the recording at each position. Or a scan file, JSON.
    keep_good: omit rows with NaN or with decreasing time stamps instead of refusing the file.
    """
    if not path.is_file():
        raise UserError(what="no such file", where=path)
    if path.suffix == ".json":
        return _log_of_scan(read_scan_file(path), path)
    table, names, files, notes = read_table(path)
    columns = find_columns(names, path)
    if not len(table):
        raise UserError(what="has no rows", where=path)
    require_read_turns(names, table, columns, path)
    if columns.unread:
        notes.append(f"columns of {path.name} that are not read: {', '.join(columns.unread)[:200]}")
    used = columns.take(table, list(columns.of))
    rows = np.arange(1, len(table) + 1)
    good = np.asarray(np.isfinite(used).all(axis=1))
    if not good.all():
        text = f"{int((~good).sum())} of {len(good)} rows hold NaN, first row {rows[~good][0]}"
        note_omission(text, keep_good, path, hint="--keep-good leaves them out")
        notes.append(f"{path.name}: {text}; left out")
    if "time" in columns.of:
        times = np.where(good, columns.take(table, ("time",))[:, 0], -np.inf)
        back = good & (times <= np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]]))
        if back.any():
            text = f"time stamps do not increase at {int(back.sum())} rows, first {rows[back][0]}"
            note_omission(text, keep_good, path, hint="--keep-good leaves these rows out")
            notes.append(f"{path.name}: {text}; left out")
            good &= ~back
    if good.sum() < 1:
        raise UserError(what="has no usable rows", where=path)
    table, rows = table[good], rows[good]
    positions = columns.take(table, "xyz")
    far = np.abs(positions).max(axis=1) > MAX_ANTENNA_M
    if far.any():
        raise UserError(
            what=f"the position of row {rows[far][0]} is more than {MAX_ANTENNA_M:g} m away",
            where=path,
        )
    if "rx" in columns.of:
        notes.append(f"rx, ry, rz of {path.name} were read as rotation vectors in radians")
    return RobotLog(
        path=path,
        positions=positions,
        times_s=columns.take(table, ("time",))[:, 0] if "time" in columns.of else None,
        quaternions=_quaternions(columns, table, rows, path),
        rows=rows,
        is_whole=bool(good.all()),
        notes=tuple(notes),
        files=None if files is None else tuple(files[row - 1] for row in rows),
    )


def _quaternions(columns: Columns, table: Floats, rows: Ints, path: Path) -> Floats | None:
    if "rx" in columns.of:
        turns = Rotation.from_rotvec(columns.take(table, VECTOR))
        return np.asarray(turns.as_quat()[:, [3, 0, 1, 2]])
    if "qw" not in columns.of:
        return None
    quaternions = columns.take(table, QUATERNION)
    off = np.abs(np.linalg.norm(quaternions, axis=1) - 1) > _UNIT_QUATERNION
    if off.any():
        raise UserError(what=f"quaternion of row {rows[off][0]} is not 1 long", where=path)
    return quaternions


def _log_of_scan(scan: ScanFile, path: Path) -> RobotLog:
    rows = scan.log_rows()
    return RobotLog(
        path=path,
        positions=rows[:, 1:4],
        times_s=rows[:, 0],
        quaternions=rows[:, 4:],
        rows=np.arange(1, len(rows) + 1),
        scan=scan,
    )
