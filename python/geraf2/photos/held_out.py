"""Photos that a training does not see, and how well its surface shows them."""

import numpy as np

from geraf2.photos.neural_surface import NeuralSurface
from geraf2.scene.photos import PhotoSet


def hold_out(photos: PhotoSet, every: int) -> tuple[PhotoSet, PhotoSet | None]:
    """Photos to train with, and every `every`-th, which is held out; None of them at 0."""
    if every == 0:
        return photos, None
    index = np.arange(len(photos))
    held = index % every == every - 1
    return photos.subset(index[~held]), photos.subset(index[held])


def compare_views(surface: NeuralSurface, photos: PhotoSet) -> dict[str, float]:
    """Compare photos with what a surface looks like from their cameras.

    Returns psnr_db over the object (the whole picture without masks), and with masks
    silhouette_iou, the overlap of the silhouettes from 0 to 1.
    """
    errors, overlaps = [], []
    for index, camera in enumerate(photos.cameras):
        view = surface.render(camera)
        difference = view.colour - photos.images[index].astype(np.float32) / 255.0
        if photos.masks is None:
            errors.append(float(np.mean(difference**2)))
            continue
        mask, seen = photos.masks[index], view.opacity > 0.5
        errors.append(float(np.mean(difference[mask] ** 2)) if mask.any() else 0.0)
        overlaps.append(float((mask & seen).sum() / max((mask | seen).sum(), 1)))
    numbers = {"psnr_db": float(-10.0 * np.log10(max(float(np.mean(errors)), 1e-12)))}
    if overlaps:
        numbers["silhouette_iou"] = float(np.mean(overlaps))
    return numbers
