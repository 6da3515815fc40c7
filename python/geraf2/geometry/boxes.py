"""Boxes with axes along the frame's."""

import numpy as np
from numpy.typing import ArrayLike

from geraf2._types import Floats

SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
"""Corners of a box with half sides of 1, by binary index (x, y, z), (8, 3)."""

FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ],
    dtype=np.int64,
)
"""Two triangles per side from these corners, counter-clockwise from outside, (12, 3)."""


def box_corners(center_m: ArrayLike, size_m: ArrayLike) -> Floats:
    """Corners in the order of `SIGNS`, (8, 3) [m], from centre and side lengths (3,) [m]."""
    return np.asarray(np.asarray(center_m) + SIGNS * (0.5 * np.asarray(size_m, dtype=np.float64)))


def beyond_sides(points: Floats, center_m: ArrayLike, size_m: ArrayLike) -> Floats:
    """Distance of points (n, 3) [m] beyond the nearer side along each axis, (n, 3) [m].

    Negative inside: a point is in the box if none of the three is positive.
    """
    return np.asarray(np.abs(points - np.asarray(center_m)) - 0.5 * np.asarray(size_m))
