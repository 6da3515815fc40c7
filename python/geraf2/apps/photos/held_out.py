"""Photos that a training does not see, and how well its surface shows them and others."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools
from geraf2.apps.photos.neural_surface import NeuralSurface
from geraf2.scene.photos import PhotoSet


def hold_out(photos: PhotoSet, every: int) -> tuple[PhotoSet, PhotoSet | None]:
    """Photos to train with, and every `every`-th, which is held out; None of them at 0."""
    if every == 0:
        return photos, None
    index = np.arange(len(photos))
    held = index % every == every - 1
    return photos.subset(index[~held]), photos.subset(index[held])


class ComparedView(NamedTuple):
    """A photo and what a surface looks like from its camera."""

    photo: NDArray[np.uint8]
    """(height, width, 3)."""
    colour: NDArray[np.floating]
    """Rendered, sRGB 0 to 1, (height, width, 3)."""
    opacity: NDArray[np.floating]
    """Rendered, 0 to 1, (height, width)."""
    mask: Bools | None
    """Where the object is in the photo, (height, width)."""


def compare_views(surface: NeuralSurface, photos: PhotoSet) -> dict[str, float]:
    """Compare photos with what a surface looks like from their cameras; see `agreement`."""
    views = []
    for index, camera in enumerate(photos.cameras):
        view = surface.render(camera)
        mask = None if photos.masks is None else photos.masks[index]
        views.append(ComparedView(photos.images[index], view.colour, view.opacity, mask))
    return agreement(views)


def agreement(views: Iterable[ComparedView]) -> dict[str, float]:
    """How well rendered views are like their photos.

    Returns psnr_db over the object (the whole picture without masks); one_colour_db, what the mean
    colour of all these pixels would reach; and with masks silhouette_iou, the overlap of the
    silhouettes from 0 to 1.
    """
    errors, overlaps, colours = [], [], []
    for view in views:
        photo = view.photo.astype(np.float32) / 255.0
        difference, seen = view.colour - photo, view.opacity > 0.5
        if view.mask is None:
            errors.append(float(np.mean(difference**2)))
            colours.append(photo.reshape(-1, 3))
            continue
        mask = view.mask
        errors.append(float(np.mean(difference[mask] ** 2)) if mask.any() else 0.0)
        overlaps.append(float((mask & seen).sum() / max((mask | seen).sum(), 1)))
        colours.append(photo[mask])
    flat = np.concatenate(colours)
    spread = float(np.var(flat, axis=0, dtype=np.float64).mean()) if len(flat) else 0.0
    numbers = {"psnr_db": _decibel(float(np.mean(errors))), "one_colour_db": _decibel(spread)}
    if overlaps:
        numbers["silhouette_iou"] = float(np.mean(overlaps))
    return numbers


def _decibel(error: float) -> float:
    return float(-10.0 * np.log10(max(error, 1e-12)))
