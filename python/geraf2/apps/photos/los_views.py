"""Does a surface that was trained from photos look like them? Pictures, numbers, a verdict."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geraf2.apps.photos.held_out import ComparedView, agreement
from geraf2.apps.photos.neural_surface import NeuralSurface
from geraf2.errors import UserError
from geraf2.pipeline.events import Listener
from geraf2.report.los import SurfaceView
from geraf2.scene.photos import PhotoSet, bin_pixels

TRAINED = "trained_"
"""Before the names of numbers that are of photos the surface was trained from."""

_VIEW_HEIGHT = 300
_N_VIEWS = 3
# Overlap of silhouettes. Right poses reach 0.966 to 0.994 on photos that were left out (docs/
# photos-method.md) and 0.98 after 20 steps; poses turned by 2 degrees 0.94, shuffled ones 0.78.
_GOOD_OVERLAP, _LEAST_OVERLAP = 0.95, 0.8
# Without masks: PSNR over that of one colour for all, on photos left out. Right poses reach 1.3 dB
# after 300 steps with 13 photos, shuffled ones -1.2 dB; the temple without masks, of which half the
# size is found, 1.2 dB (with them 5.4 dB, preset quick).
_GOOD_GAIN_DB, _LEAST_GAIN_DB = 3.0, 0.0


def compare_some(
    surface: NeuralSurface, photos: PhotoSet
) -> tuple[list[SurfaceView], dict[str, float]]:
    """Render some photos' views; returns them and :func:`geraf2.apps.photos.held_out.agreement`."""
    views, compared = [], []
    for index in np.linspace(0, len(photos) - 1, min(_N_VIEWS, len(photos))).round().astype(int):
        camera, image = photos.cameras[index], photos.images[index]
        step = max(1, camera.height // _VIEW_HEIGHT)
        view = surface.render(camera.binned(step))
        small = bin_pixels(image, step).round().astype(np.uint8)
        mask = None if photos.masks is None else bin_pixels(photos.masks[index], step) >= 0.5
        name = photos.names[index]
        views.append(SurfaceView(name, small, view.colour, view.normal, view.opacity))
        compared.append(ComparedView(small, view.colour, view.opacity, mask))
    return views, agreement(compared)


def is_refuted(numbers: Mapping[str, Any]) -> bool:
    """Whether a surface is clearly not that of its photos."""
    overlap, gain = _evidence(numbers)
    return gain < _LEAST_GAIN_DB if overlap is None else overlap < _LEAST_OVERLAP


def refuted(numbers: Mapping[str, Any], source: object, pictures: object) -> UserError:
    """Error of a surface that is clearly not that of its photos."""
    return UserError(
        what=f"the surface does not explain the photos: {_words(numbers)}",
        where=source,
        hint=f"check poses, --camera-axes, masks and that nothing moved; {pictures} shows it",
    )


def warn_unexplained(numbers: Mapping[str, Any], source: object, listener: Listener) -> None:
    """Say so where a surface explains its photos badly; earlier records have no such numbers."""
    if f"{TRAINED}psnr_db" not in numbers and "one_colour_db" not in numbers:
        return
    overlap, gain = _evidence(numbers)
    if overlap is None:
        is_weak = gain < _GOOD_GAIN_DB
    else:  # silhouettes tell the outside, but no hollow
        is_weak = overlap < _GOOD_OVERLAP or gain < _LEAST_GAIN_DB
    if is_weak:
        listener.warning(f"{source}: the surface explains the photos badly: {_words(numbers)}")


def _evidence(numbers: Mapping[str, Any]) -> tuple[float | None, float]:
    """Overlap of silhouettes, where there are, and gain of PSNR over one colour [dB]."""
    first = "" if "psnr_db" in numbers else TRAINED
    gain = numbers[f"{first}psnr_db"] - numbers[f"{first}one_colour_db"]
    return numbers.get(f"{first}silhouette_iou"), gain


def _words(numbers: Mapping[str, Any]) -> str:
    overlap, _ = _evidence(numbers)
    first = "" if "psnr_db" in numbers else TRAINED
    of = "" if first else " left out"
    masks = f", and silhouettes overlap by {overlap:.2f}" if overlap is not None else ""
    return (
        f"photos{of} have {numbers[f'{first}psnr_db']:.1f} dB, where one colour for all has "
        f"{numbers[f'{first}one_colour_db']:.1f} dB{masks}"
    )
