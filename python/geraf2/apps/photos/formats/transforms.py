"""nerfstudio's `transforms.json`, read; `io.photo_files` writes it.

Poses are camera-to-world with OpenGL's camera axes (x right, y up, z backward); intrinsics are of
the whole set or of each frame. The keys `unit` and `frame` are this project's: nerfstudio ignores
them. https://docs.nerf.studio/quickstart/data_conventions.html
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Floats
from geraf2.apps.photos.formats.images import read_size
from geraf2.apps.photos.formats.records import PhotoSource, find_path
from geraf2.errors import UserError
from geraf2.geometry.transforms import OPENGL_TO_OPENCV
from geraf2.io.photo_files import DISTORTION, TRANSFORMS_NAME, UNITS_M, PhotoRecord
from geraf2.io.text import read_object

_NERF_NAME = "transforms_train.json"
"""Name of the file in NeRF's synthetic sets."""
_SUFFIXES = (".png", ".jpg", ".jpeg", ".JPG", ".JPEG", ".PNG")

# Largest number of path components to search for.
_LONGEST_END = 16

_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")


def find_transforms(source: Path) -> Path | None:
    """File transforms.json of a folder, or the file itself."""
    if source.is_file():
        return source if source.suffix == ".json" else None
    files = (find_path(source, name) for name in (TRANSFORMS_NAME, _NERF_NAME))
    return next((file for file in files if file is not None and file.is_file()), None)


def read_transforms(path: Path) -> PhotoSource:
    """Photo set of a transforms.json; images are relative to its folder.

    An image that is not at its path is searched for in the folder by the end of that path.
    """
    values = read_object(path)
    frames = values.get("frames")
    if not isinstance(frames, list) or not frames:
        raise UserError(what="has no list of frames", where=path, expected="a key 'frames'")
    records, notes = [], []
    named: list[str] = []
    sizes: set[tuple[int, int]] = set()
    for number, frame in enumerate(frames):
        where = f"{path}, frame {number}"
        if not isinstance(frame, dict):
            raise UserError(what="is no object", where=where)
        if "transform_matrix" not in frame:
            notes.append(f"left out: {where} ({frame.get('file_path')!r}) has no transform_matrix")
            continue
        merged = {**values, **frame}
        if "w" not in merged and "h" not in merged:
            name = merged.get("file_path")
            size = None
            with suppress(UserError):  # an image that cannot be read
                if isinstance(name, str) and name:
                    size = read_size(_image_path(path.parent, name))
            if size is None:
                notes.append(f"left out: {where}: no such image {name!r}")
                continue
            merged |= {"w": size[0], "h": size[1]}
            if "fl_x" in values and "fl_x" not in frame:
                sizes.add(size)
        records.append(_record(path, merged, where))
        named.append(merged["file_path"])
    if not records:
        raise UserError(
            what="none of the frames has a pose and an image",
            where=path,
            expected="a transform_matrix in each frame",
            hint=notes[-1] if "no such image" in notes[-1] else "run COLMAP on the photos first",
        )
    if len(sizes) > 1:
        raise UserError(
            what="the photos differ in size, and one fl_x without w and h is given for all",
            where=path,
            expected="w and h that fl_x is of, or fl_x, w and h in each frame",
            got=", ".join(f"{width} x {height}" for width, height in sorted(sizes)),
        )
    notes += _note_elsewhere(path, records, named)
    unit, frame_name = values.get("unit"), values.get("frame")
    if unit is not None and unit not in UNITS_M:
        raise UserError(
            what="unknown unit", where=path, expected=" or ".join(UNITS_M), got=repr(unit)
        )
    return PhotoSource(
        format="transforms",
        records=tuple(records),
        unit_m=None if unit is None else UNITS_M[unit],
        frame=frame_name if isinstance(frame_name, str) else None,
        notes=tuple(notes),
    )


def _record(path: Path, values: dict[str, Any], where: str) -> PhotoRecord:
    name = values.get("file_path")
    if not isinstance(name, str) or not name:
        raise UserError(what="needs a file_path", where=where, got=repr(name))
    model = values.get("camera_model", "OPENCV")
    if model not in _MODELS:
        raise UserError(
            what="unknown camera model",
            where=where,
            expected=" or ".join(_MODELS),
            got=repr(model),
            hint="undistort the photos first",
        )
    if values.get("is_fisheye") or _number(values, "k4", where, 0.0) != 0.0:
        raise UserError(
            what="fisheye lenses are not known", where=where, hint="undistort the photos first"
        )
    distorted = model in ("OPENCV", "PERSPECTIVE")
    distortion = [_number(values, key, where, 0.0) if distorted else 0.0 for key in DISTORTION]
    mask = values.get("mask_path")
    if mask is not None and not isinstance(mask, str):
        raise UserError(what="mask_path must be text", where=where, got=repr(mask))
    size, focal_x, focal_y = _size_and_focal_lengths(values, where)
    intrinsics = np.eye(3)
    intrinsics[0, 0], intrinsics[1, 1] = focal_x, focal_y
    for axis, key in enumerate(("cx", "cy")):
        intrinsics[axis, 2] = _number(values, key, where, 0.5 * size[axis] if size else None)
    image = _image_path(path.parent, name)
    beside = image not in _candidates(path.parent / name)
    return PhotoRecord(
        name=(image.relative_to(path.parent) if beside else Path(name)).as_posix(),
        path=image,
        intrinsics=intrinsics,
        camera_to_world=_pose(values["transform_matrix"], where),
        distortion=np.array(distortion),
        size=size,
        mask_path=None if mask is None else _image_path(path.parent, mask),
    )


def _image_path(folder: Path, name: str) -> Path:
    """Image of a frame, without .png in NeRF's synthetic sets, or the path where it should be."""
    paths = [folder / name, *(folder / end for end in _path_ends(name))]
    candidates = (candidate for path in paths for candidate in _candidates(path))
    if found := next(filter(_is_file, candidates), None):
        return found
    for path in paths:  # in other capitals
        there = find_path(folder, path.relative_to(folder)) if path.is_relative_to(folder) else None
        if there is not None and _is_file(there):
            return there
    return paths[0]


def _candidates(path: Path) -> list[Path]:
    return [path, *(path.with_name(path.name + suffix) for suffix in _SUFFIXES if path.name)]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # the name is too long
        return False


def _path_ends(name: str) -> Iterator[Path]:
    """Trailing parts of a path of any system, the longest first, without upward steps."""
    # For /elsewhere/../scan/0001.png: scan/0001.png, 0001.png, then images/0001.png.
    parts = re.split(r"[\\/]", name)
    last = max((at for at, part in enumerate(parts) if part == ".."), default=-1)
    parts = [part for part in parts[last + 1 :] if part not in ("", ".") and ":" not in part]
    for first in range(max(0, len(parts) - _LONGEST_END), len(parts)):
        yield Path(*parts[first:])
    if parts:
        yield Path("images", parts[-1])


def _note_elsewhere(path: Path, records: Sequence[PhotoRecord], named: Sequence[str]) -> list[str]:
    """Note on images found at other paths; UserError where two frames share one image."""
    pairs = list(zip(records, named, strict=True))
    elsewhere = [(record, name) for record, name in pairs if record.name != Path(name).as_posix()]
    if not elsewhere:
        return []
    uses = Counter(record.path for record in records)
    for record, _ in elsewhere:
        if uses[record.path] > 1:
            same = [name for other, name in pairs if other.path == record.path]
            raise UserError(
                what="images are not at their paths, and two frames share one file here",
                where=path,
                expected=f"one frame for {record.path.name}",
                got=" and ".join(same[:2]),
            )
    record, name = elsewhere[0]
    return [
        f"{len(elsewhere)} images are not at the paths of {path.name} ({name}); they were found by "
        f"the end of their paths, as {record.name}"
    ]


def _pose(matrix: object, where: str) -> Floats:
    try:
        array = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        raise UserError(what="transform_matrix must hold numbers", where=where) from None
    if array.shape not in ((4, 4), (3, 4)):
        raise UserError(what="transform_matrix must be 4 x 4", where=where, got=array.shape)
    if array.shape == (3, 4):
        array = np.concatenate([array, [[0.0, 0.0, 0.0, 1.0]]])
    return np.asarray(array @ OPENGL_TO_OPENCV)


def _size_and_focal_lengths(
    values: dict[str, Any], where: str
) -> tuple[tuple[int, int] | None, float, float]:
    size = None
    if "w" in values or "h" in values:
        width, height = _number(values, "w", where), _number(values, "h", where)
        if min(width, height) < 1.0:
            raise UserError(what="w and h must be positive", where=where, got=f"{width} x {height}")
        size = (int(width), int(height))
    if "fl_x" in values:
        focal_x = _number(values, "fl_x", where)
        focal_y = _number(values, "fl_y", where, focal_x)
    elif "camera_angle_x" in values and size is not None:
        focal_x = 0.5 * size[0] / math.tan(0.5 * _number(values, "camera_angle_x", where))
        focal_y = focal_x
    else:
        raise UserError(
            what="no focal length", where=where, expected="fl_x, or camera_angle_x with w and h"
        )
    if min(focal_x, focal_y) <= 0.0:
        raise UserError(what="focal lengths must be positive", where=where, got=focal_x)
    return size, focal_x, focal_y


def _number(values: dict[str, Any], key: str, where: str, default: float | None = None) -> float:
    value = values.get(key, default)
    if value is None:
        raise UserError(what=f"lacks {key}", where=where)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError(what=f"{key} must be a finite number", where=where, got=repr(value))
    return float(value)
