"""LLFF folders: `poses_bounds.npy` and `images/`.

Of each image, in the order of their names, 17 numbers: a 3 x 5 matrix, row by row, and the nearest
and the farthest depth, which are not needed. The first four columns of the matrix are the pose,
camera-to-world with camera axes (down, right, backward); the fifth is height, width and focal
length [pixel]. The principal point is the middle of the image. The scale is that of the COLMAP
model the poses are of, which is arbitrary. README of https://github.com/Fyusion/LLFF, "Using your
own poses without running COLMAP".
"""

from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.apps.photos.formats.records import PhotoSource, found, listed_images
from geraf2.errors import UserError
from geraf2.io.arrays import read_npy
from geraf2.io.photo_files import PhotoRecord

_NAME = "poses_bounds.npy"
# Full size first; the others are smaller copies of the same names.
_IMAGE_FOLDERS = ("images", "images_2", "images_4", "images_8")
_N_NUMBERS = 17


def find_llff(source: Path) -> Path | None:
    """File poses_bounds.npy of a folder, or the file itself."""
    path = source if source.is_file() else found(source, _NAME)
    return path if path and path.name.lower() == _NAME and path.is_file() else None


def read_llff(path: Path) -> PhotoSource:
    """Photo set of a poses_bounds.npy and the images of its folder."""
    rows, images = _rows(path), listed_images(path.parent, _IMAGE_FOLDERS)
    if len(rows) != len(images):
        raise UserError(
            what="poses and images differ in number and cannot be matched",
            where=path,
            expected=f"a pose for each of the {len(images)} images in {images[0].parent.name}",
            got=len(rows),
            hint="COLMAP found no pose of some images: remove them",
        )
    records = [_record(path, *pair) for pair in zip(images, rows, strict=True)]
    return PhotoSource(format="llff", records=tuple(records))


def _rows(path: Path) -> Floats:
    rows = read_npy(path)
    if rows.ndim != 2 or rows.shape[1] != _N_NUMBERS or rows.dtype.kind not in "fiu":
        raise UserError(
            what="must hold 17 numbers for each image",
            where=path,
            expected=f"(n_images, {_N_NUMBERS})",
            got=f"{rows.dtype} {rows.shape}",
        )
    return np.asarray(rows, dtype=np.float64)


def _record(path: Path, image: Path, row: Floats) -> PhotoRecord:
    matrix = row[: _N_NUMBERS - 2].reshape(3, 5)
    down, right, backward, position = matrix[:, :4].T
    height, width, focal = matrix[:, 4]
    if not (np.isfinite(matrix).all() and min(height, width) >= 1.0 and focal > 0.0):
        raise UserError(
            what=f"pose of {image.name} is not finite, or its height, width or focal length is not "
            "positive",
            where=path,
            got=f"{height:g}, {width:g}, {focal:g}",
        )
    pose = np.eye(4)
    pose[:3] = np.stack([right, down, -backward, position], axis=1)
    return PhotoRecord(
        name=image.name,
        path=image,
        intrinsics=np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]),
        camera_to_world=pose,
        size=(int(width), int(height)),
    )
