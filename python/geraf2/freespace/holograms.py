"""Holograms of the content in the flash of a far wall, focused at a distance."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats


class Flash(NamedTuple):
    """Far wall's flash at the antennas of a plane that face it."""

    feet: Floats
    """Foot points of the antennas on the wall, (n, 2) [m]."""
    response: NDArray[np.complex128]
    """Signal relative to that of the whole wall without content, up to one factor, (n,)."""
    content_m: Floats
    """Distance to the middle of the box along the wall's normal, (n,) [m]."""
    wall_m: Floats
    """Distance to the wall, (n,) [m]."""


def focal_lengths_m(flash: Flash, focus: float) -> Floats:
    """Focal length of each antenna for the content, (n,) [m]."""
    ahead_m = flash.content_m + focus * 2.0 * (flash.wall_m - flash.content_m)
    return np.asarray(flash.content_m * ahead_m / (2.0 * flash.wall_m))


def hologram(
    flash: Flash, cells: list[Floats], focus: float, wavelength_m: float, aperture: float
) -> tuple[NDArray[np.complex128], Bools]:
    """Transmission focused on the content and mask of cells that antennas cover, (n_u, n_v)."""
    focal_m = focal_lengths_m(flash, focus)
    zone_m = aperture * np.sqrt(wavelength_m * focal_m)
    u, v = (_chirp(c, flash.feet[:, k], focal_m, zone_m, wavelength_m) for k, c in enumerate(cells))
    seen, whole = (u * flash.response.astype(np.complex64)) @ v.T, u @ v.T
    # Elsewhere, also between distant antennas, the weights are rounding errors.
    near = np.abs(whole) > np.finfo(np.float32).eps
    image = np.zeros(whole.shape, dtype=np.complex128)
    np.divide(seen, whole, out=image, where=near)
    if not (known := near & covered(flash, cells)).any():
        return image, known
    # Unblocked lines of sight are the bright ones; their median is the reference.
    bright = image[known][(size := np.abs(image[known])) >= np.quantile(size, 0.6)]
    return image / (complex(np.median(bright.real), np.median(bright.imag)) or 1.0), known


def covered(flash: Flash, cells: list[Floats]) -> Bools:
    """Mask of the cells in front of antennas, (n_u, n_v)."""
    low, high = flash.feet.min(axis=0), flash.feet.max(axis=0)
    u, v = ((c >= low[k]) & (c <= high[k]) for k, c in enumerate(cells))
    return np.asarray(u[:, None] & v)


def _chirp(
    cells: Floats, feet: Floats, focal_m: Floats, zone_m: Floats, wavelength_m: float
) -> NDArray[np.complex64]:
    """Weight and phase of antennas at cells, along one axis, (n_cells, n_antennas).

    Single precision: phases of hundreds of radians have an error of 1e-4.
    """
    square = (np.subtract.outer(cells, feet) ** 2).astype(np.float32)
    phase = (np.pi / (wavelength_m * focal_m)).astype(np.float32) * square
    weight = np.exp((-0.5 / zone_m**2).astype(np.float32) * square)
    chirp = np.empty(square.shape, dtype=np.complex64)
    np.multiply(weight, np.cos(phase), out=chirp.real)
    np.multiply(weight, np.sin(phase), out=chirp.imag)
    return chirp
