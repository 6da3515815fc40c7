"""COLMAP models, binary or text: cameras and images; the points are not needed.

Poses are world-to-camera, x_camera = R(q) x_world + t, with q = (w, x, y, z); ids may have gaps.
The scale of a model is arbitrary. https://colmap.github.io/format.html
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from geraf2._types import Floats
from geraf2.apps.photos.formats.records import PhotoSource, find_path
from geraf2.errors import UserError
from geraf2.geometry.transforms import inverse_rigid, rotation_of_quaternion
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.photo_files import N_DISTORTION, PhotoRecord
from geraf2.io.regular import BINARY_BYTES, read_regular
from geraf2.io.text import read_lines

# Number and name of each model, and how many parameters it has.
_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
}
_KNOWN = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_FOLDERS = ("", "sparse", "colmap/sparse", "colmap")
_IMAGE_FOLDER = "images"
_LONGEST_NAME = 4096


class _ImagePose(NamedTuple):
    """Pose of one photo."""

    name: str
    camera_id: int
    camera_to_world: Floats


def find_colmap(source: Path) -> Path | None:
    """Folder of the COLMAP model with the most photos in or below a folder."""
    if source.is_file():
        return source.parent if source.name.lower() in ("images.bin", "images.txt") else None
    for name in _FOLDERS:
        folder = find_path(source, name)
        if folder is None or not folder.is_dir():
            continue
        if _model_files(folder):
            return folder
        models = _list_models(folder)
        if models:
            return max(models, key=lambda model: (models[model], -len(model.name)))
    return None


def _model_files(folder: Path) -> tuple[Path, Path] | None:
    """Files of cameras and images of a model; None where it has none."""
    for suffix in ("bin", "txt"):
        cameras, images = (find_path(folder, f"{stem}.{suffix}") for stem in ("cameras", "images"))
        if cameras and images and cameras.is_file() and images.is_file():
            return cameras, images
    return None


def _list_models(folder: Path) -> dict[Path, int]:
    """Models in a folder, by name, and their numbers of photos."""
    models = {}
    for entry in sorted(folder.iterdir()):
        files = _model_files(entry) if entry.is_dir() else None
        if files:
            models[entry] = _count_images(files[1])
    return models


def read_colmap(folder: Path) -> PhotoSource:
    """Photo set of a model; images lie in `images` next to or above it, or with its files."""
    files = _model_files(folder)
    if files is None:
        raise UserError(
            what="is no COLMAP model", where=folder, expected="cameras and images, .bin or .txt"
        )
    is_text = files[0].suffix.lower() == ".txt"
    cameras = (_read_cameras_text if is_text else _read_cameras_binary)(files[0])
    images = (_read_images_text if is_text else _read_images_binary)(files[1])
    if not images:
        raise UserError(
            what="holds no photo",
            where=files[1],
            hint="COLMAP found no pose: take more photos that overlap",
        )
    root = _image_folder(folder, [image.name for image in images])
    records = []
    for name, camera_id, camera_to_world in sorted(images, key=lambda entry: entry.name):
        if camera_id not in cameras:
            what = f"camera {camera_id} of {name!r} is missing"
            raise UserError(what=what, where=files[0])
        path, own = find_path(root, name) or root / name, cameras[camera_id]
        records.append(PhotoRecord(name=name, path=path, camera_to_world=camera_to_world, **own))
    beside = {model: n for model, n in _list_models(folder.parent).items() if model != folder}
    rest = ", ".join(f"{model.name} ({count})" for model, count in beside.items())
    read = f"of several COLMAP models '{folder.name}' ({len(images)} photos) is read"
    notes = (f"{read}, not {rest}",) if beside else ()
    return PhotoSource(format="colmap", records=tuple(records), notes=notes)


def _image_folder(folder: Path, names: Sequence[str]) -> Path:
    """Folder that holds the most images of these names."""
    above = [folder, *folder.absolute().parents[:3]]
    candidates = [find_path(parent, _IMAGE_FOLDER) for parent in above] + [*above]
    there = [candidate for candidate in candidates if candidate is not None]
    counts = [sum(find_path(root, name) is not None for name in names) for root in there]
    if any(counts):
        return there[int(np.argmax(counts))]
    return folder.parent.parent / "images" if "sparse" in folder.parts else folder / "images"


def _camera_model(model: str, size: tuple[int, int], values: Floats, where: str) -> dict[str, Any]:
    """Size, intrinsics and distortion of photos, as those of a PhotoRecord."""
    if model not in _KNOWN:
        raise UserError(
            what=f"unknown camera model {model}",
            where=where,
            expected=" or ".join(_KNOWN),
            hint="run COLMAP's image_undistorter first",
        )
    if not np.isfinite(values).all() or min(size) < 1:
        raise UserError(what="broken camera parameters", where=where, got=values.tolist())
    intrinsics, distortion = np.eye(3), np.zeros(N_DISTORTION)
    n_focal = 2 if model in ("PINHOLE", "OPENCV") else 1
    intrinsics[0, 0], intrinsics[1, 1] = values[0], values[n_focal - 1]
    intrinsics[:2, 2] = values[n_focal : n_focal + 2]
    rest = values[n_focal + 2 :]
    distortion[: rest.size] = rest
    return {"size": size, "intrinsics": intrinsics, "distortion": distortion}


def _read_cameras_text(path: Path) -> dict[int, dict[str, Any]]:
    cameras = {}
    for number, line in enumerate(read_lines(path), start=1):
        parts = line.split()
        if not parts or parts[0].startswith("#"):
            continue
        where = f"{path}, line {number}"
        try:
            camera_id, width, height = int(parts[0]), int(parts[2]), int(parts[3])
            values = np.array([float(part) for part in parts[4:]])
        except (ValueError, IndexError):
            raise UserError(
                what="must be CAMERA_ID MODEL WIDTH HEIGHT PARAMS", where=where, got=repr(line[:60])
            ) from None
        count = dict(_MODELS.values()).get(parts[1], values.size)
        if values.size != count:
            what = f"wrong number of parameters of {parts[1]}"
            raise UserError(what=what, where=where, expected=count, got=values.size)
        cameras[camera_id] = _camera_model(parts[1], (width, height), values, where)
    return cameras


def _count_images(path: Path) -> int:
    """Return the number of photos; 0 where they cannot be read, as the reader will state."""
    try:
        if path.suffix.lower() == ".txt":
            return len(_read_images_text(path))
        return int.from_bytes(_binary(path)[:8], "little")
    except UserError:
        return 0


def _read_images_text(path: Path) -> list[_ImagePose]:
    images, may_be_points = [], False
    for number, line in enumerate(read_lines(path), start=1):
        parts = line.split(maxsplit=9)
        if not parts or line.startswith("#"):
            continue
        # The line behind that of a photo holds its points, X Y ID each; some writers leave it out.
        if may_be_points and _are_points(line.split()):
            may_be_points = False
            continue
        try:
            values = np.array([float(part) for part in parts[1:8]])
            camera_id, name = int(parts[8]), parts[9].strip()
        except (ValueError, IndexError):
            raise UserError(
                what="must be IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
                where=f"{path}, line {number}",
                got=repr(line[:60]),
            ) from None
        images.append(_image_pose(name, camera_id, values))
        may_be_points = True
    return images


def _are_points(words: list[str]) -> bool:
    try:
        return len(words) % 3 == 0 and all(np.isfinite(float(word)) for word in words)
    except ValueError:
        return False


def _image_pose(name: str, camera_id: int, values: Floats) -> _ImagePose:
    rotation = rotation_of_quaternion(values[:4])
    return _ImagePose(name, camera_id, inverse_rigid(rotation, values[4:]))


def _binary(path: Path) -> bytes:
    refuse_other_kind(path)
    try:
        return read_regular(path, BINARY_BYTES)
    except OSError as error:
        raise UserError(what=f"cannot be read: {error.strerror}", where=path) from error


def _truncation_error(path: Path) -> UserError:
    return UserError(what="the file is cut off", where=path, got=f"{path.stat().st_size} bytes")


def _read_cameras_binary(path: Path) -> dict[int, dict[str, Any]]:
    data, at, cameras = _binary(path), 8, {}
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            camera_id, model_id, width, height = struct.unpack_from("<iiQQ", data, at)
            if model_id not in _MODELS:
                raise UserError(what=f"unknown camera model number {model_id}", where=path)
            model, count = _MODELS[model_id]
            values = np.array(struct.unpack_from(f"<{count}d", data, at + 24))
            at += 24 + 8 * count
            where = f"{path}, camera {camera_id}"
            cameras[camera_id] = _camera_model(model, (width, height), values, where)
    except struct.error:
        raise _truncation_error(path) from None
    return cameras


def _read_images_binary(path: Path) -> list[_ImagePose]:
    data, at, images = _binary(path), 8, []
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            _, *values, camera_id = struct.unpack_from("<i7di", data, at)
            end = data.find(b"\0", at + 64, at + 64 + _LONGEST_NAME)
            (n_points,) = struct.unpack_from("<Q", data, end + 1)
            name = data[at + 64 : end].decode("utf-8", errors="replace")
            at = end + 9 + 24 * n_points
            if end < 0 or at > len(data):
                raise _truncation_error(path)
            images.append(_image_pose(name, camera_id, np.array(values)))
    except struct.error:
        raise _truncation_error(path) from None
    return images
