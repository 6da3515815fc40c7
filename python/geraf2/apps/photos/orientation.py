"""Photos that are turned as their EXIF tags state: those whose cameras stand upright.

A picture on its side shows by its size whether poses are of the pixels as stored. One that is
upside down, or a square one, shows it by its camera. A mirrored picture is always turned.
"""

from collections.abc import Sequence

import numpy as np

from geraf2._types import Floats
from geraf2.apps.photos.formats.images import read_orientation
from geraf2.errors import UserError
from geraf2.io.photo_files import PhotoRecord

_UPRIGHT, _ON_ITS_SIDE = (1, 2), (5, 6, 7, 8)
# Least part of a camera's up direction that points along that of the others, or against it.
_LEAST = 0.5


def exif_turns(records: Sequence[PhotoRecord]) -> tuple[list[bool | None], list[str]]:
    """Whether each photo is turned as its tag states; None where its size decides. And notes."""
    tags, squares = [], []
    for record in records:
        try:
            tag, (width, height) = read_orientation(record.path)
        except UserError:  # its reader states what is wrong
            tag, width, height = 1, 0, 0
        tags.append(tag)
        squares.append(width == height)
    turns: list[bool | None] = []
    turned: list[str] = []
    kept: list[str] = []
    ups = [_up(record) for record, tag in zip(records, tags, strict=True) if tag in _UPRIGHT]
    common = np.mean(ups, axis=0) if ups else None
    for record, tag, square in zip(records, tags, squares, strict=True):
        if tag == 1 or (tag in _ON_ITS_SIDE and not square):
            turns.append(None)
            continue
        upright = tag == 2 or _stands_upright(record, common)
        turns.append(upright)
        (turned if upright else kept).append(f"{record.name} ({tag})")
    notes = []
    if turned:
        notes.append(
            f"{len(turned)} photos were turned as their EXIF orientation states, since their "
            f"cameras stand upright: {', '.join(turned[:3])}"
        )
    if kept:
        notes.append(
            f"{len(kept)} photos with an EXIF orientation were taken as stored, since their "
            f"cameras do not stand upright as the others: {', '.join(kept[:3])}"
        )
    return turns, notes


def _up(record: PhotoRecord) -> Floats:
    return np.asarray(-record.camera_to_world[:3, 1], dtype=np.float64)


def _stands_upright(record: PhotoRecord, common: Floats | None) -> bool:
    """Whether the picture's up direction is that of the upright pictures, as far as it shows."""
    if common is None or not np.linalg.norm(common) > _LEAST:
        return False
    looking = np.asarray(record.camera_to_world[:3, 2], dtype=np.float64)
    expected = common - (common @ looking) * looking
    length = float(np.linalg.norm(expected))
    return length > 0.0 and float(_up(record) @ expected) > _LEAST * length
