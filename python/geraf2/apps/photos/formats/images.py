"""Images and masks from files, as plain arrays."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageOps

from geraf2._types import Bools, Bytes
from geraf2.io.pictures import broken_picture, open_picture

_EIGHT_BITS = 255.0
_ORIENTATION = 0x0112
"""EXIF tag of the camera's orientation; 5 to 8 are turned by 90 degrees."""
_ON_ITS_SIDE = (5, 6, 7, 8)


class ReadImage(NamedTuple):
    """An image and its transparency."""

    colour: Bytes
    """(height, width, 3), sRGB."""
    alpha: Bytes | None
    """(height, width), None where the file has none."""
    is_tagged: bool
    """Whether the file has an EXIF orientation that was not applied."""


def read_image(path: Path, size: tuple[int, int] | None = None) -> ReadImage:
    """Read an image of `PICTURE_FORMATS`; UserError if it is missing or broken.

    size: width and height of the picture that poses and intrinsics belong to. A stored picture of
        the other orientation is turned if its EXIF tag states so; else pixels stay as stored.
    """
    with open_picture(path) as stored:
        try:
            stored.load()
            image = _turn_to_size(stored, size)
            is_tagged = image is stored and image.getexif().get(_ORIENTATION, 1) in range(2, 9)
            if image.mode in ("I", "I;16", "I;16B", "F"):
                grey = np.asarray(image, dtype=np.float64)
                # 16-bit files are full scale at 65535; floats at 1.
                scale = 65535.0 if grey.max(initial=0.0) > 1.0 else 1.0
                colour = np.clip(_EIGHT_BITS * grey / scale, 0, 255).round().astype(np.uint8)
                return ReadImage(np.repeat(colour[:, :, None], 3, axis=2), None, is_tagged)
            has_alpha = "A" in image.getbands() or "transparency" in image.info
            array = np.asarray(image.convert("RGBA" if has_alpha else "RGB"), dtype=np.uint8)
        except (OSError, ValueError, SyntaxError, EOFError) as error:
            raise broken_picture(path, error) from error
    return ReadImage(
        np.ascontiguousarray(array[:, :, :3]),
        np.ascontiguousarray(array[:, :, 3]) if has_alpha else None,
        is_tagged,
    )


def read_mask(path: Path) -> Bools:
    """Read a mask: True where the image is brighter than half, or opaque where it has alpha."""
    image = read_image(path)
    if image.alpha is not None and (image.alpha < 255).any():
        return np.asarray(image.alpha >= 128)
    return np.asarray(image.colour.max(axis=2) >= 128)


def read_size(path: Path) -> tuple[int, int]:
    """Width and height of an image as stored; UserError as :func:`read_image`."""
    with open_picture(path) as image:
        return image.width, image.height


def _turn_to_size(image: Image.Image, size: tuple[int, int] | None) -> Image.Image:
    if size is None or image.getexif().get(_ORIENTATION) not in _ON_ITS_SIDE:
        return image
    lies = (image.width - image.height) * (size[0] - size[1]) < 0
    return ImageOps.exif_transpose(image) if lies else image
