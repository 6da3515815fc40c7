"""Picture of a planar scan: the sharpest slice, and how sharp the others are."""

import os

import numpy as np
from numpy.typing import NDArray

from geraf2.report.figures import (
    _AXIS_NAMES,
    _HEAT_MAP,
    _extent,
    _label_millimetres,
    new_figure,
    save_figure,
)
from geraf2.scene import Grid


def sharpest_slice(
    volume: NDArray[np.float32],
    grid: Grid,
    axis: int,
    depths_m: NDArray[np.float64],
    sharpness: NDArray[np.float64],
    path: str | os.PathLike[str],
) -> None:
    """Draw the slice at the sharpest depth, and the sharpness over depth.

    Parameters
    ----------
    volume
        Magnitude of an image, grid.shape.
    axis
        Axis of the grid along which the radar looks.
    depths_m, sharpness
        Distance from the antennas [m] and sharpness of each slice, (grid.shape[axis],).
    path
        PNG to write.
    """
    best = int(sharpness.argmax())
    across, up = (other for other in range(3) if other != axis)
    figure = new_figure(10.0, 4.6)
    picture, curve = figure.subplots(1, 2)
    image = picture.imshow(
        np.take(volume, best, axis=axis).T,
        origin="lower",
        extent=_extent(grid, across, up),
        cmap=_HEAT_MAP,
        interpolation="nearest",
        aspect="equal",
    )
    depth_mm = 1e3 * depths_m[best]
    picture.set_title(f"depth {depth_mm:.1f} mm, across {_AXIS_NAMES[axis]}")
    _label_millimetres(picture, across, up)
    figure.colorbar(image, ax=picture, shrink=0.85).set_label("magnitude")
    curve.plot(1e3 * depths_m, sharpness, color="black")
    curve.axvline(depth_mm, color="#E69F00")
    curve.set_xlabel("depth [mm]")
    curve.set_ylabel("sharpness, n sum v^4 / (sum v^2)^2")
    save_figure(figure, path)
