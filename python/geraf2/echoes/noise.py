"""What echoes err by: a description for glints, faces of plastic and tests of the geometry.

Labels take the bending of surfaces from it, and have errors of a peak of their own.

A peak has the errors of the window that shows it. Its neighbours tell more: echoes of two parts of
a concave surface that a sub-aperture does not resolve give one peak between both parts, outside of
the surface. Such a peak deviates from the tangent planes of its neighbours, and the deviation
predicts its bias and its errors (docs/math/echoes.md#errors-of-an-echo).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2._validation import require_each, require_positive

# Neighbours of a peak: most of those that a sub-aperture of 8 cm sees of the same surface.
_REACH_M, _N_NEIGHBORS = 0.010, 64
# Deviation of a peak without neighbours: the population's median [m].
_ALONE_M = 0.001


@dataclass(frozen=True, kw_only=True)
class EchoNoise:
    """Standard deviations of echoes; maximum likelihood values of simulated scans with a truth."""

    peak_m: float = 1.4e-3
    """Of a peak along its normal, whatever its neighbours are [m]."""
    peak_normal_rad: float = 0.25
    """Of each component of a peak's normal [rad]."""
    bend_per_m2: float = 60.0
    """Offset of two points of a smooth surface over the cube of their distance [1/m^2]."""
    curvature_per_m: float = 8.0
    """Change of the normal over the distance [rad/m]."""
    range_m: float = 2e-4
    """Of the range of a single echo, by antenna positions and the walls' delay [m]."""
    bias_per_deviation: float = 0.5
    """Bias of a glint outwards over its deviation."""
    sigma_per_deviation: float = 1.1
    """Of a glint along its normal over its deviation."""
    turn_per_m: float = 63.0
    """Of each component of a glint's normal over its deviation [rad/m]: a merged echo leans by its
    deviation over a cell of the window, 1.6 cm."""
    weak_rad: float = 0.015
    """Of each component of the normal of a strong glint by other echoes of its sub-aperture [rad];
    for others it grows with one over the strength."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)

    def offset_variance(self, distance_m: Floats) -> Floats:
        """Variance of the offset of two peaks of a smooth surface along their normal, (n,) [m^2].

        distance_m: between them, (n,) [m].
        """
        return np.asarray(2.0 * self.peak_m**2 + (self.bend_per_m2 * distance_m**3) ** 2)

    def of_glints(self, deviation_m: Floats, relative: Floats) -> tuple[Floats, Floats]:
        """Return the standard deviations of glints, (n,) each [m] and [rad].

        deviation_m: of :func:`tangent_deviation`. relative: strengths relative to a strong glint.
        """
        position = np.hypot(self.range_m, self.sigma_per_deviation * deviation_m)
        return position, np.hypot(self.turn_per_m * deviation_m, self.weak_rad / relative)


ECHO_NOISE = EchoNoise()
"""The values of the package."""


def normal_density(error: Floats | float, sigma: Floats | float) -> Floats:
    """Density of a normal distribution about 0 at an error, in one over the error's unit."""
    return np.asarray(np.exp(-0.5 * (error / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma))


def tangent_deviation(positions: Floats, normals: Floats) -> Floats:
    """Median distance of oriented points from the planes that they share with neighbours, (n,) [m].

        e_i = median_j |(p_j - p_i) . (n_i + n_j)| / 2,    |p_j - p_i| < 1 cm

    It vanishes to third order of the distance on any smooth surface.

    positions: (n, 3) [m]. normals: unit vectors, (n, 3).

    >>> import numpy as np
    >>> from geraf2.echoes.noise import tangent_deviation
    >>> points = np.array([[0.0, 0.0, 0.0], [0.005, 0.0, 0.001]])
    >>> tangent_deviation(points, np.array([[0.0, 0.0, 1.0]] * 2))
    array([0.001, 0.001])
    """
    n_asked = min(_N_NEIGHBORS + 1, len(positions))
    distance, index = KDTree(positions).query(
        positions, k=np.arange(1, n_asked + 1), distance_upper_bound=_REACH_M
    )
    near = np.isfinite(distance) & (index != np.arange(len(positions))[:, None])
    index = np.where(near, index, 0)
    offset = positions.take(index, axis=0) - positions[:, None]
    mean = normals.take(index, axis=0) + normals[:, None]
    height = np.einsum("nkj,nkj->nk", offset, mean)
    # Points beyond the reach are infinite and come last.
    ordered = np.sort(np.where(near, 0.5 * np.abs(height), np.inf), axis=1)
    count = near.sum(axis=1)
    rows = np.arange(len(positions))
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    middle = 0.5 * (ordered[rows, low] + ordered[rows, np.minimum(high, n_asked - 1)])
    return np.where(count > 0, middle, _ALONE_M)
