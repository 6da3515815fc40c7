"""A signed distance sampled on a regular grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from geraf2._validation import require_shape
from geraf2.scene import Grid


@dataclass(frozen=True, kw_only=True, eq=False)
class SdfGrid:
    """Signed distance at voxel centres; negative inside what reflects [m]."""

    grid: Grid
    """Where the samples lie."""
    values: NDArray[np.float32]
    """Signed distance at each voxel centre, grid.shape [m]."""

    def __post_init__(self) -> None:
        require_shape("values", self.values, self.grid.shape)

    def sample(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Trilinear signed distance at points (n, 3) [m] -> (n,) [m].

        Outside the grid the value of the nearest face is used. Not differentiable.
        """
        require_shape("points", points, (None, 3))
        index = (np.asarray(points) - np.asarray(self.grid.origin_m)) / self.grid.spacing_m
        sampled = map_coordinates(self.values, index.T, order=1, mode="nearest", output=np.float64)
        return np.asarray(sampled, dtype=np.float64)
