"""Agreement of a trained surface with its photos: pictures, numbers, verdict."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geraf2.apps.photos.neural_surface import NeuralSurface
from geraf2.errors import UserError
from geraf2.pipeline.events import Listener
from geraf2.report.los import SurfaceView
from geraf2.scene.photos import PhotoSet, bin_pixels

TRAINED = "trained_"
"""Prefix of the names of numbers that belong to photos of the training."""

_VIEW_HEIGHT = 300
_N_VIEWS = 3
# Overlap of silhouettes. Right poses reach 0.966 to 0.994 on photos that were left out
# (docs/math/photos.md) and 0.98 after 20 steps; poses turned by 2 degrees 0.94, shuffled ones 0.78.
_GOOD_OVERLAP, _MIN_OVERLAP = 0.95, 0.8


def hold_out(photos: PhotoSet, every: int) -> tuple[PhotoSet, PhotoSet | None]:
    """Photos to train with, and every `every`-th, which is held out; None of them at 0."""
    if every == 0:
        return photos, None
    index = np.arange(len(photos))
    held = index % every == every - 1
    return photos.subset(index[~held]), photos.subset(index[held])


def compare_few(
    surface: NeuralSurface, photos: PhotoSet
) -> tuple[list[SurfaceView], dict[str, float]]:
    """Smaller views of some of the photos, and their agreement, see :func:`compare_views`."""
    chosen = np.linspace(0, len(photos) - 1, min(_N_VIEWS, len(photos))).round().astype(int)
    return compare_views(surface, photos.subset(chosen), _VIEW_HEIGHT)


def compare_views(
    surface: NeuralSurface, photos: PhotoSet, height: int | None = None
) -> tuple[list[SurfaceView], dict[str, float]]:
    """Render a surface from the cameras of photos, and measure the agreement.

    height: of the views, about; that of the photos when None [pixel].

    Numbers: psnr_db over the object; one_colour_db, the same for the mean colour of all these
    pixels; silhouette_iou of the silhouettes.
    """
    assert photos.masks is not None
    views, errors, overlaps, colours = [], [], [], []
    for index, camera in enumerate(photos.cameras):
        step = 1 if height is None else max(1, camera.height // height)
        view = surface.render(camera.join_pixels(step))
        image = bin_pixels(photos.images[index], step).round().astype(np.uint8)
        name = photos.names[index]
        views.append(SurfaceView(name, image, view.colour, view.normal, view.opacity))
        photo, seen = image.astype(np.float32) / 255.0, view.opacity > 0.5
        mask = bin_pixels(photos.masks[index], step) >= 0.5
        overlaps.append(float((mask & seen).sum() / max((mask | seen).sum(), 1)))
        error = (view.colour - photo)[mask] ** 2
        errors.append(float(np.mean(error)) if mask.any() else 0.0)
        colours.append(photo[mask])
    flat = np.concatenate(colours)
    spread = float(np.var(flat, axis=0, dtype=np.float64).mean()) if len(flat) else 0.0
    numbers = {"psnr_db": _decibel(float(np.mean(errors))), "one_colour_db": _decibel(spread)}
    return views, numbers | {"silhouette_iou": float(np.mean(overlaps))}


def _decibel(error: float) -> float:
    return float(-10.0 * np.log10(max(error, 1e-12)))


def is_refuted(numbers: Mapping[str, Any]) -> bool:
    """Whether a surface is clearly not that of its photos."""
    return _evidence(numbers)[-1] < _MIN_OVERLAP


def refutation_error(numbers: Mapping[str, Any], source: object, pictures: object) -> UserError:
    """Error of a surface that is clearly not that of its photos."""
    return UserError(
        what=f"the surface does not explain the photos: {_words(numbers)}",
        where=source,
        hint=f"check poses, --camera-axes, masks and that nothing moved; {pictures} shows it",
    )


def warn_unexplained(numbers: Mapping[str, Any], source: object, listener: Listener) -> None:
    """Warn where a surface explains its photos badly."""
    _, psnr_db, flat_db, overlap = _evidence(numbers)
    if overlap < _GOOD_OVERLAP or psnr_db < flat_db:  # silhouettes do not show hollows
        listener.warning(f"{source}: the surface explains the photos badly: {_words(numbers)}")


def _evidence(numbers: Mapping[str, Any]) -> tuple[str, float, float, float]:
    """Which photos, their PSNR and that of a single colour [dB], and the overlap of silhouettes."""
    of, first = (" left out", "") if "psnr_db" in numbers else ("", TRAINED)
    psnr_db, flat_db = numbers[f"{first}psnr_db"], numbers[f"{first}one_colour_db"]
    return of, psnr_db, flat_db, numbers[f"{first}silhouette_iou"]


def _words(numbers: Mapping[str, Any]) -> str:
    of, psnr_db, flat_db, overlap = _evidence(numbers)
    return (
        f"photos{of} have {psnr_db:.1f} dB, where one colour for all has {flat_db:.1f} dB, and "
        f"silhouettes overlap by {overlap:.2f}"
    )
