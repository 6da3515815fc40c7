"""Pixels of a photo set as rays to train on."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from scipy import ndimage
from torch import Generator, Tensor

from geraf2._types import Bools, Bytes, Floats32
from geraf2.apps.photos.formats.masks import close_cracks
from geraf2.apps.photos.neus.ray_samples import intersect_box
from geraf2.apps.photos.visual_hull import Region
from geraf2.errors import UserError
from geraf2.scene.photos import Camera, PhotoSet, bin_pixels

MAX_RAYS = 24_000_000
"""Limit of rays: 21 bytes each, 500 MB, 78 photos of 640 x 480; larger sets lose resolution."""
_RIM = 1 / 25
"""Background kept around a silhouette, over the image's larger side; 26 pixels of 640."""
_MIN_RIM = 6.0
"""The same in pixels, for small pictures."""
_FAR_RIM_SHARE = 0.2
"""Share of the distant background that is kept, so that no surface grows there."""


class RayBatch(NamedTuple):
    """Rays with the colours and masks of the photos."""

    origins: Tensor
    """(n, 3) [m]."""
    directions: Tensor
    """Unit vectors, (n, 3)."""
    colours: Tensor
    """sRGB from 0 to 1, (n, 3)."""
    inside: Tensor
    """1 within the silhouette, else 0, (n,)."""
    known: Tensor
    """0 in cracks of the silhouette, which may be shadow or background, else 1, (n,)."""

    def subset(self, chosen: Tensor) -> "RayBatch":
        """Rays of a boolean mask, (n,)."""
        return RayBatch(*(part[chosen] for part in self))


class PhotoRays:
    """Rays of all photos that meet the region, about the silhouettes."""

    def __init__(self, photos: PhotoSet, region: Region, *, seed: int = 0) -> None:
        assert photos.masks is not None
        self.region = region
        self._positions = torch.tensor(photos.positions, dtype=torch.float32)
        rng = np.random.default_rng(seed)
        pictures = zip(photos.cameras, photos.images, photos.masks, strict=True)
        parts = [self._photo_rays(*picture, rng) for picture in pictures]
        self._directions, self._colours, self._inside, self._known = (
            torch.from_numpy(np.concatenate(column)) for column in zip(*parts, strict=True)
        )
        counts = torch.tensor([p[2].size for p in parts])
        numbers = torch.arange(len(parts), dtype=torch.int32)
        self._photo = torch.repeat_interleave(numbers, counts)
        if len(self) == 0:
            raise UserError(
                what="no photo shows the region of the object",
                expected=f"rays through {region.low_m} .. {region.high_m} m",
                hint="check frame and unit of the poses",
            )

    def __len__(self) -> int:
        return self._inside.shape[0]

    def _photo_rays(
        self, camera: Camera, image: Bytes, mask: Bools, rng: np.random.Generator
    ) -> tuple[Floats32, Bytes, Bools, Bools]:
        rim = ndimage.distance_transform_edt(~mask) <= max(_MIN_RIM, _RIM * max(mask.shape))
        pixels = np.argwhere(rim | (rng.random(mask.shape) < _FAR_RIM_SHARE))
        origins, directions = camera.rays(pixels[:, ::-1] + 0.5)
        corners = np.array([self.region.low_m, self.region.high_m])
        near, far = intersect_box(*map(torch.from_numpy, (origins, directions, *corners)))
        pixels = pixels[(far > near).numpy()]
        rows, columns = pixels[:, 0], pixels[:, 1]
        return (
            directions[(far > near).numpy()].astype(np.float32),
            np.ascontiguousarray(image[rows, columns]),
            mask[rows, columns],
            (close_cracks(mask) == mask)[rows, columns],
        )

    def batch(self, n: int, generator: Generator) -> RayBatch:
        """Draw `n` rays, each as likely as any other."""
        chosen = torch.randint(len(self), (n,), generator=generator)
        return RayBatch(
            origins=self._positions[self._photo[chosen]],
            directions=self._directions[chosen],
            colours=self._colours[chosen].to(torch.float32) / 255.0,
            inside=self._inside[chosen].to(torch.float32),
            known=self._known[chosen].to(torch.float32),
        )


def fit_resolution(photos: PhotoSet) -> PhotoSet:
    """Photos of at most MAX_RAYS pixels in total, reduced by whole factors where needed."""
    n_pixels = sum(camera.width * camera.height for camera in photos.cameras)
    return reduce_photos(photos, int(np.ceil(np.sqrt(n_pixels / MAX_RAYS))))


def reduce_photos(photos: PhotoSet, factor: int) -> PhotoSet:
    """Photos in which a block of factor x factor pixels has become one, its mean."""
    if factor <= 1:
        return photos
    return replace(
        photos,
        cameras=tuple(camera.join_pixels(factor) for camera in photos.cameras),
        images=tuple(bin_pixels(image, factor).round().astype(np.uint8) for image in photos.images),
        masks=None
        if photos.masks is None
        else tuple(bin_pixels(mask, factor) >= 0.5 for mask in photos.masks),
    )
