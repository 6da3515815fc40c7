"""Pictures of a surface that was trained from photos."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geraf2._types import AnyPath, Bytes, Floats
from geraf2.report import canvas


class SurfaceView(NamedTuple):
    """A photo and the rendered surface from its camera."""

    name: str
    """Name of the photo."""
    photo: Bytes
    """(height, width, 3)."""
    colour: NDArray[np.floating]
    """Rendered, sRGB 0 to 1, (height, width, 3)."""
    normal: NDArray[np.floating]
    """Outward normals, zero in the background, (height, width, 3)."""
    opacity: NDArray[np.floating]
    """0 to 1, (height, width)."""


def surface_views(views: Sequence[SurfaceView], path: AnyPath) -> None:
    """Draw photo, rendered view and normal map side by side, a row for each view."""
    if not views:
        msg = "views must hold at least one view, got none"
        raise ValueError(msg)
    shapes = [(3.5, (4.2, 4.2, 4.2))] * len(views)
    sheet = canvas.Sheet.of(*shapes, margins=(0.05, 0.05, 0.05, 0.4))
    for row, view in zip(sheet.rows, views, strict=True):
        images = (view.photo, np.clip(view.colour, 0.0, 1.0), normal_map(view.normal, view.opacity))
        titles = (view.name, "rendered", "normals")
        for panel, image, title in zip(row, images, titles, strict=True):
            panel.imshow(image)
            panel.set_title(title)
            panel.set_axis_off()
    sheet.save(path)


def normal_map(normal: NDArray[np.floating], opacity: NDArray[np.floating]) -> Floats:
    """Return the normal map, (n + 1) / 2 as red, green, blue; white background."""
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    unit = np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-6)
    cover = np.clip(opacity, 0.0, 1.0)[..., None]
    return np.asarray(cover * 0.5 * (unit + 1.0) + (1.0 - cover), dtype=np.float64)
