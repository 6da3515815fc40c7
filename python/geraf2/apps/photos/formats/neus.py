"""NeuS data folders: `cameras_sphere.npz`, `image/` and optionally `mask/`.

`world_mat_i` is the 4 x 4 projection K [R | t] of the i-th image in the order of their names,
`scale_mat_i` the sphere that NeuS trains in, which is not needed here. The unit is that of the data
(millimetres in DTU). https://github.com/Totoro97/NeuS#data-convention
"""

from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.apps.photos.formats.records import PhotoSource, found, images_in, listed_images
from geraf2.errors import UserError
from geraf2.geometry.transforms import inverse_rigid
from geraf2.io.arrays import read_npz
from geraf2.io.photo_files import PhotoRecord

_NAMES = ("cameras_sphere.npz", "cameras.npz")
_IMAGE_FOLDERS = ("image", "images", "rgb")
# In NeuS integer coordinates are the middles of pixels.
_HALF_PIXEL = 0.5


def find_neus(source: Path) -> Path | None:
    """Camera file of a folder, or the file itself."""
    if source.is_file():
        return source if source.suffix == ".npz" else None
    for name in _NAMES:
        file = found(source, name)
        if file is not None and file.is_file():
            return file
    return None


def read_neus(path: Path) -> PhotoSource:
    """Photo set of a cameras_sphere.npz and the images of its folder."""
    images = listed_images(path.parent, _IMAGE_FOLDERS)
    masks = _masks(path.parent, images)
    matrices = read_npz(path, [f"world_mat_{index}" for index in range(len(images))])
    records = []
    for index, (image, mask) in enumerate(zip(images, masks, strict=True)):
        where = f"{path}, world_mat_{index}"
        intrinsics, pose = decompose_projection(matrices[f"world_mat_{index}"], where)
        records.append(
            PhotoRecord(
                name=image.name,
                path=image,
                intrinsics=intrinsics,
                camera_to_world=pose,
                mask_path=mask,
            )
        )
    return PhotoSource(format="neus", records=tuple(records))


def _masks(folder: Path, images: list[Path]) -> list[Path | None]:
    """Masks with the images' names; if none has (as in DTU) and their number fits, in order."""
    named = [folder / "mask" / image.with_suffix(".png").name for image in images]
    if not any(mask.is_file() for mask in named) and (folder / "mask").is_dir():
        others = images_in(folder / "mask")
        if len(others) == len(images):
            return list(others)
    return [mask if mask.is_file() else None for mask in named]


def decompose_projection(projection: Floats, where: object) -> tuple[Floats, Floats]:
    """Intrinsics and camera-to-world pose of a projection K [R | t], (3, 4), of any scale.

    Returns K with K[2, 2] = 1 and positive focal lengths, the half pixel added, (3, 3); pose, (4,
    4). `where` is named in errors.
    """
    from scipy.linalg import rq  # noqa: PLC0415 - used here only

    if projection.shape not in ((4, 4), (3, 4)) or not np.isfinite(projection).all():
        raise UserError(what="must be a finite 4 x 4 projection", where=where, got=projection.shape)
    matrix = np.asarray(projection[:3], dtype=np.float64)
    # The sign of a projection is free; choose the one with a proper rotation.
    if np.linalg.det(matrix[:, :3]) < 0.0:
        matrix = -matrix
    upper, rotation = rq(matrix[:, :3])
    signs = np.sign(np.diag(upper))
    if (signs == 0.0).any():
        raise UserError(what="the projection is singular", where=where)
    upper, rotation = upper * signs, signs[:, None] * rotation
    translation = np.linalg.solve(upper, matrix[:, 3])
    intrinsics = np.triu(upper / upper[2, 2])
    intrinsics[:2, 2] += _HALF_PIXEL
    return intrinsics, inverse_rigid(rotation, translation)
