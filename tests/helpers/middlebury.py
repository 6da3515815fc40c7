"""Middlebury's multi-view stereo sets as photo sets that geraf2 reads."""

from pathlib import Path

import numpy as np

from geraf2.apps.photos.formats.images import read_image
from geraf2.geometry.transforms import inverse_rigid
from geraf2.scene.photos import Camera, PhotoSet
from photo_writing import save_photos


def convert_middlebury(source: Path, folder: Path) -> Path:
    """Write the photos of a folder with a `NAME_par.txt` and a transforms.json to `folder`.

    A line is `image.png k11 .. k33 r11 .. r33 t1 t2 t3`; the projection is K [R | t] in metres, and
    pixel coordinates are those of the pixels' middles.
    """
    (parameters,) = source.glob("*_par.txt")
    names, cameras, images = [], [], []
    for line in parameters.read_text().splitlines()[1:]:
        name, *texts = line.split()
        values, image = np.array(texts, dtype=float), read_image(source / name).colour
        intrinsics = values[:9].reshape(3, 3)
        intrinsics[:2, 2] += 0.5  # geraf2 has the middle of the first pixel at (0.5, 0.5)
        pose = inverse_rigid(values[9:18].reshape(3, 3), values[18:])
        height, width = image.shape[:2]
        cameras.append(
            Camera(intrinsics=intrinsics, camera_to_world=pose, width=width, height=height)
        )
        names.append(name)
        images.append(image)
    photos = PhotoSet(names=tuple(names), cameras=tuple(cameras), images=tuple(images))
    save_photos(photos, folder)
    return folder
