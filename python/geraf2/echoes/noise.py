"""Bias and standard deviation of peaks in which several echoes merge.

Echoes of two parts of a concave surface that a sub-aperture does not resolve give one peak between
both parts, outside of the surface. Such peaks deviate from the tangent planes of their neighbours,
and the deviation predicts both errors (docs/math/echoes.md#merged-echoes).
"""

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats

# Neighbours of a peak: most of those that a sub-aperture of 8 cm sees of the same surface.
_REACH_M, _N_NEIGHBORS = 0.010, 64
# Bias and standard deviation over the deviation; a property of the simulated population of objects.
BIAS_SHARE, SIGMA_SHARE = 0.5, 1.1
# Deviation of a peak without neighbours: the population's median [m].
_ALONE_M = 0.001


def tangent_deviation(
    positions: Floats, normals: Floats, others: tuple[Floats, Floats] | None = None
) -> Floats:
    """Median distance of oriented points from the planes that they share with neighbours, (n,) [m].

        e_i = median_j |(p_j - p_i) . (n_i + n_j)| / 2,    |p_j - p_i| < 1 cm

    It vanishes to third order of the distance on any smooth surface.

    positions: (n, 3) [m]. normals: unit vectors, (n, 3).
    others: positions and normals of further points, which are only neighbours.

    >>> import numpy as np
    >>> from geraf2.echoes.merging import tangent_deviation
    >>> points = np.array([[0.0, 0.0, 0.0], [0.005, 0.0, 0.001]])
    >>> tangent_deviation(points, np.array([[0.0, 0.0, 1.0]] * 2))
    array([0.001, 0.001])
    """
    points, directions = positions, normals
    if others is not None:
        points = np.concatenate([positions, others[0]])
        directions = np.concatenate([normals, others[1]])
    n_asked = min(_N_NEIGHBORS + 1, len(points))
    distance, index = KDTree(points).query(
        positions, k=np.arange(1, n_asked + 1), distance_upper_bound=_REACH_M
    )
    near = np.isfinite(distance) & (index != np.arange(len(positions))[:, None])
    index = np.where(near, index, 0)
    offset = points[index] - positions[:, None]
    height = np.einsum("nkj,nkj->nk", offset, directions[index] + normals[:, None])
    # Points beyond the reach are infinite and come last.
    ordered = np.sort(np.where(near, 0.5 * np.abs(height), np.inf), axis=1)
    count = near.sum(axis=1)
    rows = np.arange(len(positions))
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    middle = 0.5 * (ordered[rows, low] + ordered[rows, np.minimum(high, n_asked - 1)])
    return np.where(count > 0, middle, _ALONE_M)
