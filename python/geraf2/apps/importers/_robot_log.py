"""Reader of robot logs: positions of the end effector, with their times."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from geraf2._types import Bools, Floats, Ints
from geraf2.apps.importers._log_columns import (
    QUATERNION,
    VECTOR,
    Columns,
    find_columns,
    require_read_turns,
)
from geraf2.apps.importers._log_table import read_table
from geraf2.apps.importers._rows import note_omission
from geraf2.errors import UserError
from geraf2.io.scan_file import ScanFile, read_scan_file
from geraf2.scene.checks import MAX_ANTENNA_M

_UNIT_QUATERNION = 0.01
# Share of rows beyond which stamps that do not increase are no broken rows: the stamps are wrong.
_MAX_BACK = 0.5
_ROUNDED = "are they rounded, or another column the time? name the right one time_s"


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

    @classmethod
    def of_poses(cls, path: Path, poses: Floats, scan: ScanFile | None = None) -> "RobotLog":
        """Log of times, positions and quaternions w x y z, (n_rows, 8)."""
        return cls(
            path=path,
            positions=poses[:, 1:4],
            times_s=poses[:, 0],
            quaternions=poses[:, 4:],
            rows=np.arange(1, len(poses) + 1),
            scan=scan,
        )

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
        scan = read_scan_file(path)
        return RobotLog.of_poses(path, scan.log_rows(), scan)
    log = read_table(path)
    table, files, notes = log.values, log.files, log.notes
    if not len(table):
        raise UserError(what="has no rows", where=path)
    columns = find_columns(log, path)
    notes += columns.notes
    require_read_turns(log.names, table, columns, path)
    if columns.unread:
        notes.append(f"columns of {path.name} that are not read: {', '.join(columns.unread)[:200]}")
    used = columns.take(table, list(columns.of))
    rows = np.arange(1, len(table) + 1)
    times_s = columns.times_s
    good = np.asarray(np.isfinite(used).all(axis=1))
    if times_s is not None:
        good &= np.isfinite(times_s)
    if not good.all():
        text = f"{int((~good).sum())} of {len(good)} rows hold NaN, first row {rows[~good][0]}"
        note_omission(text, keep_good, path)
        notes.append(f"{path.name}: {text}; left out")
    if times_s is not None:
        good, more = _increasing(times_s, good, keep_good, path)
        notes += more
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
        times_s=None if times_s is None else times_s[good],
        quaternions=_quaternions(columns, table, rows, path),
        rows=rows,
        is_whole=bool(good.all()),
        notes=tuple(notes),
        files=None if files is None else tuple(files[row - 1] for row in rows),
    )


def _increasing(
    times_s: Floats, good: Bools, keep_good: bool, path: Path
) -> tuple[Bools, list[str]]:
    """Rows whose times increase, of the good ones, and a note on the others."""
    times = np.where(good, times_s, -np.inf)
    back = good & (times <= np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]]))
    if not back.any():
        return good, []
    first = 1 + int(np.argmax(back))
    text = f"time stamps do not increase at {int(back.sum())} rows, first {first}"
    few = bool(back.sum() < _MAX_BACK * good.sum())
    hint = "--keep-good leaves these rows out" if few else _ROUNDED
    note_omission(text, keep_good and few, path, hint=hint)
    return good & ~back, [f"{path.name}: {text}; left out"]


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
