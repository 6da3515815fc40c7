"""Reader of robot logs: positions of the end effector, with their times."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from geraf2._types import Floats, Ints
from geraf2.apps.importers._rows import left_out, require_equal
from geraf2.errors import UserError
from geraf2.io.arrays import read_npy
from geraf2.io.scan_file import ScanFile, read_scan_file
from geraf2.io.text import read_lines

_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TIME_NAMES = ("time", "t", "timestamp", "stamp")
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

    @cached_property
    def turns(self) -> Slerp:
        """Rotation at any time, interpolated between the rows along the shortest turn."""
        return Slerp(self.times_s, self.rotations)


# Positions beyond are no antenna positions.
_MAX_PLACE_M = 1e5


def read_log(path: Path, *, keep_good: bool) -> RobotLog:
    """Read a robot log.

    path: CSV with a line of names (time_s, x_m, y_m, z_m, optionally qw, qx, qy, qz; units mm, cm,
        ms, us, ns are converted) or without one (x y z, or t x y z), or NPY (n, 3), (n, 4) or (n,
        8) in the order of these names, or with these field names. A CSV may have a column `file`,
        the name of the recording at each position. Or a scan file, JSON.
    keep_good: omit rows with NaN or with decreasing time stamps instead of refusing the file.
    """
    if not path.is_file():
        raise UserError(what="no such file", where=path)
    if path.suffix == ".json":
        return _of_scan(read_scan_file(path), path)
    table, names, files = _read_npy(path) if path.suffix == ".npy" else _read_csv(path)
    columns = _columns(names, path)
    if not len(table):
        raise UserError(what="has no rows", where=path)
    used = table[:, [index for index, _ in columns.values()]]
    rows = np.arange(1, len(table) + 1)
    good = np.asarray(np.isfinite(used).all(axis=1))
    notes = []
    if not good.all():
        text = f"{int((~good).sum())} of {len(good)} rows hold NaN, first row {rows[~good][0]}"
        left_out(text, keep_good, path, hint="--keep-good leaves them out")
        notes.append(f"{path.name}: {text}; left out")
    if "time" in columns:
        index, scale = columns["time"]
        times = np.where(good, scale * table[:, index], -np.inf)
        back = good & (times <= np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]]))
        if back.any():
            text = f"time stamps do not increase at {int(back.sum())} rows, first {rows[back][0]}"
            left_out(text, keep_good, path, hint="--keep-good leaves these rows out")
            notes.append(f"{path.name}: {text}; left out")
            good &= ~back
    if good.sum() < 1:
        raise UserError(what="has no usable rows", where=path)

    def take(wanted: Sequence[str]) -> Floats:
        pairs = [columns[name] for name in wanted]
        return np.stack([scale * table[good, index] for index, scale in pairs], axis=1)

    far = np.abs(take("xyz")).max(axis=1) > _MAX_PLACE_M
    if far.any():
        raise UserError(
            what=f"the position of row {rows[good][far][0]} is more than {_MAX_PLACE_M:g} m away",
            where=path,
        )
    quaternions = take(("qw", "qx", "qy", "qz")) if "qw" in columns else None
    if quaternions is not None:
        off = np.abs(np.linalg.norm(quaternions, axis=1) - 1) > _UNIT_QUATERNION
        if off.any():
            raise UserError(
                what=f"quaternion of row {rows[good][off][0]} is not 1 long", where=path
            )
    return RobotLog(
        path=path,
        positions=take("xyz"),
        times_s=take(("time",))[:, 0] if "time" in columns else None,
        quaternions=quaternions,
        rows=rows[good],
        notes=tuple(notes),
        files=None if files is None else tuple(files[row - 1] for row in rows[good]),
    )


def _of_scan(scan: ScanFile, path: Path) -> RobotLog:
    rows = scan.log_rows()
    return RobotLog(
        path=path,
        positions=rows[:, 1:4],
        times_s=rows[:, 0],
        quaternions=rows[:, 4:],
        rows=np.arange(1, len(rows) + 1),
        scan=scan,
    )


def _columns(names: Sequence[str], path: Path) -> dict[str, tuple[int, float]]:
    """Column and factor to SI of each quantity."""
    found: dict[str, tuple[int, float]] = {}
    for index, name in enumerate(names):
        base, _, unit = name.strip().lower().partition("_")
        base = "time" if base in _TIME_NAMES else base
        is_length = base in ("x", "y", "z") and unit in ("", "m", "cm", "mm")
        is_time = base == "time" and unit in ("", "s", "ms", "us", "ns")
        is_turn = base in ("qw", "qx", "qy", "qz") and not unit
        if base in found:
            raise UserError(what=f"two columns are named {base}", where=path)
        if is_length or is_time or is_turn:
            found[base] = (index, _UNITS.get(unit, 1.0))
    missing = [name for name in "xyz" if name not in found]
    turns = [name for name in ("qw", "qx", "qy", "qz") if name in found]
    if missing or len(turns) not in (0, 4):
        raise UserError(
            what="columns are missing",
            where=path,
            expected="time_s, x_m, y_m, z_m, optionally qw, qx, qy, qz",
            got=", ".join(names)[:80],
        )
    return found


def _default_names(n_columns: int, path: Path) -> list[str]:
    names = ["time", "x", "y", "z", "qw", "qx", "qy", "qz"]
    if n_columns == 3:
        return names[1:4]
    if n_columns in (4, 8):
        return names[:n_columns]
    raise UserError(
        what="has the wrong number of columns",
        where=path,
        expected="3 (x y z), 4 (t x y z) or 8 (t x y z qw qx qy qz), or names in the first line",
        got=n_columns,
    )


def _read_npy(path: Path) -> tuple[Floats, list[str], None]:
    array = read_npy(path)
    if array.dtype.names:
        names = list(array.dtype.names)
        array = np.stack([array[name] for name in names], axis=-1)
    elif array.ndim == 2:
        names = _default_names(array.shape[1], path)
    else:
        raise UserError(what="has the wrong shape", where=path, expected="(n, 4)", got=array.shape)
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise UserError(what="must hold rows of numbers", where=path, got=array.dtype)
    return array.astype(np.float64), names, None


def _read_csv(path: Path) -> tuple[Floats, list[str], list[str] | None]:
    lines = [
        line for line in read_lines(path) if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise UserError(what="has no rows", where=path)
    delimiter = next((mark for mark in ",;\t" if mark in lines[0]), None)
    first = [word.strip() for word in lines[0].split(delimiter)]
    has_names = not all(_is_number(word) for word in first)
    names = first if has_names else _default_names(len(first), path)
    body = lines[1:] if has_names else lines
    if not body:
        raise UserError(what="has no rows", where=path)
    body, names, files = _without_files(body, names, delimiter, path)
    try:
        table = np.loadtxt(body, delimiter=delimiter, ndmin=2, dtype=np.float64)
    except ValueError as error:
        raise UserError(what=f"cannot be read as numbers: {error}", where=path) from None
    require_equal("rows and names differ in number", path, len(names), table.shape[1])
    return table, names, files


def _without_files(
    lines: list[str], names: list[str], delimiter: str | None, path: Path
) -> tuple[list[str], list[str], list[str] | None]:
    """Rows and names without the column `file`, and its values."""
    at = next((index for index, name in enumerate(names) if name.lower() == "file"), None)
    if at is None:
        return lines, names, None
    rows, files = [line.split(delimiter) for line in lines], []
    for row in rows:
        require_equal("rows and names differ in number", path, len(names), len(row))
        files.append(row.pop(at).strip().strip('"'))
    mark = delimiter or " "
    return [mark.join(row) for row in rows], names[:at] + names[at + 1 :], files


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
