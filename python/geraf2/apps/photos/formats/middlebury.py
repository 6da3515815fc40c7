"""Middlebury multi-view stereo: `NAME_par.txt`, one line a photo with K, R and t.

A line is `image.png k11 .. k33 r11 .. r33 t1 t2 t3`; the projection is K [R | t], R and t from the
world to the camera (x right, y down, z forward). Lengths are in metres in the published sets.
https://vision.middlebury.edu/mview/data/
"""

from pathlib import Path

import numpy as np

from geraf2.apps.photos.formats.records import PhotoSource, found
from geraf2.errors import UserError
from geraf2.geometry.transforms import inverse_rigid
from geraf2.io.photo_files import PhotoRecord
from geraf2.io.text import read_lines

_ENDING = "_par.txt"
_N_NUMBERS = 21
# The origin is "top-left" (README of the sets), read here as the middle of that pixel.
_HALF_PIXEL = 0.5


def find_middlebury(source: Path) -> Path | None:
    """Parameter file of a folder, or the file itself."""
    if source.is_file():
        return source if source.name.lower().endswith(_ENDING) else None
    files = sorted(path for path in source.glob("*") if path.name.lower().endswith(_ENDING))
    return files[0] if files else None


def read_middlebury(path: Path) -> PhotoSource:
    """Photo set of a `_par.txt`; images lie in its folder."""
    lines = [line for line in read_lines(path) if line.strip()]
    records = [_record(path, number, line) for number, line in enumerate(lines[1:], start=2)]
    count = lines[0].strip() if lines else ""
    if not count.isdigit() or int(count) != len(records):
        raise UserError(
            what="the first line must be the number of photos",
            where=path,
            expected=len(records),
            got=repr(lines[0][:40]) if lines else "an empty file",
        )
    return PhotoSource(format="middlebury", records=tuple(records), unit_m=1.0)


def _record(path: Path, number: int, line: str) -> PhotoRecord:
    where = f"{path}, line {number}"
    name, *texts = line.split()
    try:
        values = np.array([float(text) for text in texts])
    except ValueError:
        raise UserError(
            what="is not a name and numbers", where=where, got=repr(line[:60])
        ) from None
    if values.size != _N_NUMBERS:
        raise UserError(
            what="needs 21 numbers after the name (K, R, t)", where=where, got=values.size
        )
    intrinsics = values[:9].reshape(3, 3).copy()
    intrinsics[:2, 2] += _HALF_PIXEL
    return PhotoRecord(
        name=name,
        path=found(path.parent, name) or path.parent / name,
        intrinsics=intrinsics,
        camera_to_world=inverse_rigid(values[9:18].reshape(3, 3), values[18:]),
    )
