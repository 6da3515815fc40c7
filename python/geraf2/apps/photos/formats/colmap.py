"""COLMAP models, binary or text: cameras and images; the points are not needed.

Poses are world-to-camera, x_camera = R(q) x_world + t, with q = (w, x, y, z); ids may have gaps.
The scale of a model is arbitrary. https://colmap.github.io/format.html
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from geraf2._types import Floats
from geraf2.apps.photos.formats.records import PhotoSource
from geraf2.errors import UserError
from geraf2.geometry.transforms import inverse_rigid, rotation_of_quaternion
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.photo_files import N_DISTORTION, PhotoRecord
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
_FOLDERS = ("", "sparse/0", "sparse", "colmap/sparse/0", "colmap")
_LONGEST_NAME = 4096


class _CameraModel(NamedTuple):
    """Intrinsics of one or more photos."""

    size: tuple[int, int]
    intrinsics: Floats
    distortion: Floats


class _ImagePose(NamedTuple):
    """Pose of one photo."""

    name: str
    camera_id: int
    camera_to_world: Floats


def find_colmap(source: Path) -> Path | None:
    """Folder of a COLMAP model in or below a folder."""
    if source.is_file():
        return source.parent if source.name in ("images.bin", "images.txt") else None
    for name in _FOLDERS:
        folder = source / name
        for suffix in ("bin", "txt"):
            if all((folder / f"{stem}.{suffix}").is_file() for stem in ("cameras", "images")):
                return folder
    return None


def read_colmap(folder: Path) -> PhotoSource:
    """Photo set of a model; images lie in `images` next to or above it, or with its files."""
    if (folder / "images.bin").is_file() and (folder / "cameras.bin").is_file():
        cameras = _read_cameras_binary(folder / "cameras.bin")
        images = _read_images_binary(folder / "images.bin")
    else:
        cameras = _read_cameras_text(folder / "cameras.txt")
        images = _read_images_text(folder / "images.txt")
    if not images:
        raise UserError(
            what="the COLMAP model holds no photo",
            where=folder,
            hint="COLMAP found no pose: take more photos that overlap",
        )
    root = _image_folder(folder, images[0].name)
    records = []
    for image in sorted(images, key=lambda entry: entry.name):
        if image.camera_id not in cameras:
            raise UserError(
                what=f"camera {image.camera_id} of {image.name!r} is missing", where=folder
            )
        camera = cameras[image.camera_id]
        records.append(
            PhotoRecord(
                name=image.name,
                path=root / image.name,
                intrinsics=camera.intrinsics,
                camera_to_world=image.camera_to_world,
                distortion=camera.distortion,
                size=camera.size,
            )
        )
    return PhotoSource(format="colmap", records=tuple(records))


def _image_folder(folder: Path, name: str) -> Path:
    above = [folder, folder.parent, folder.parent.parent, folder.parent.parent.parent]
    for candidate in [parent / "images" for parent in above] + above:
        if (candidate / name).is_file():
            return candidate
    return folder.parent.parent / "images" if "sparse" in folder.parts else folder / "images"


def _camera_model(model: str, size: tuple[int, int], values: Floats, where: str) -> _CameraModel:
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
    return _CameraModel(size, intrinsics, distortion)


def _require_count(model: str, values: Floats, where: str) -> None:
    counts = dict(_MODELS.values())
    if model in counts and values.size != counts[model]:
        raise UserError(
            what=f"wrong number of parameters of {model}",
            where=where,
            expected=counts[model],
            got=values.size,
        )


def _read_cameras_text(path: Path) -> dict[int, _CameraModel]:
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
        _require_count(parts[1], values, where)
        cameras[camera_id] = _camera_model(parts[1], (width, height), values, where)
    return cameras


def _read_images_text(path: Path) -> list[_ImagePose]:
    lines = [
        (number, line)
        for number, line in enumerate(read_lines(path), start=1)
        if not line.startswith("#")
    ]
    images = []
    # Each photo has two lines, the second (its points) may be empty.
    for number, line in lines[::2]:
        if not line.strip():
            continue
        parts = line.split(maxsplit=9)
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
    return images


def _image_pose(name: str, camera_id: int, values: Floats) -> _ImagePose:
    rotation = rotation_of_quaternion(values[:4])
    return _ImagePose(name, camera_id, inverse_rigid(rotation, values[4:]))


class _Bytes:
    """Little-endian values of a file, one after another."""

    def __init__(self, path: Path) -> None:
        self.path = path
        refuse_other_kind(path)
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise UserError(what=f"cannot be read: {error.strerror}", where=path) from error
        self._at = 0

    def take(self, layout: str) -> tuple[int | float, ...]:
        size = struct.calcsize("<" + layout)
        if self._at + size > len(self._data):
            raise UserError(what="the file is cut off", where=self.path, got=f"{self._at} bytes")
        values = struct.unpack_from("<" + layout, self._data, self._at)
        self._at += size
        return values

    def skip(self, size: int) -> None:
        if size < 0 or self._at + size > len(self._data):
            raise UserError(what="the file is cut off", where=self.path, got=f"{self._at} bytes")
        self._at += size

    def text(self) -> str:
        end = self._data.find(b"\0", self._at, self._at + _LONGEST_NAME)
        if end < 0:
            raise UserError(what="a name has no end", where=self.path, got=f"byte {self._at}")
        text = self._data[self._at : end].decode("utf-8", errors="replace")
        self._at = end + 1
        return text

    def entries(self) -> Iterator[int]:
        """Numbers of the entries that follow; their count comes first."""
        (count,) = self.take("Q")
        yield from range(int(count))


def _read_cameras_binary(path: Path) -> dict[int, _CameraModel]:
    data, cameras = _Bytes(path), {}
    for _ in data.entries():
        camera_id, model_id, width, height = (int(value) for value in data.take("iiQQ"))
        if model_id not in _MODELS:
            raise UserError(what=f"unknown camera model number {model_id}", where=path)
        model, count = _MODELS[model_id]
        values = np.array(data.take(f"{count}d"))
        where = f"{path}, camera {camera_id}"
        cameras[camera_id] = _camera_model(model, (width, height), values, where)
    return cameras


def _read_images_binary(path: Path) -> list[_ImagePose]:
    data, images = _Bytes(path), []
    for _ in data.entries():
        data.take("i")
        values = np.array(data.take("7d"))
        camera_id = int(data.take("i")[0])
        name = data.text()
        n_points = int(data.take("Q")[0])
        data.skip(24 * n_points)
        images.append(_image_pose(name, camera_id, values))
    return images
