"""Regular voxel domains."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geraf2._memory import require_memory
from geraf2._types import Floats
from geraf2._validation import require_finite, require_least, require_positive
from geraf2.geometry.transforms import triple

MIN_SPACING_M = 1e-12
"""Finest spacing [m]: finer grids are a mistake of units, and their gradients overflow."""

_MANY_VOXELS = 10_000_000
_BYTES_PER_VOXEL = 16.0


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Voxel centres at origin_m + index * spacing_m, axes along the frame's x, y, z.

    Raises
    ------
    ValueError
        If the spacing is not positive or a side has no voxel.

    Examples
    --------
    >>> grid = geraf2.Grid.cube((0.0, 0.0, 0.0), half_side_m=0.1, n_per_side=51)
    >>> grid.shape, grid.spacing_m, grid.points().shape
    ((51, 51, 51), 0.004, (132651, 3))
    """

    origin_m: tuple[float, float, float]
    """Centre of voxel (0, 0, 0) [m]."""
    spacing_m: float
    """Distance of neighbouring voxels [m]."""
    shape: tuple[int, int, int]
    """Voxels along x, y, z."""

    def __post_init__(self) -> None:
        require_positive("spacing_m", self.spacing_m)
        require_least(self, spacing_m=MIN_SPACING_M)
        for value in self.origin_m:
            require_finite("origin_m", value)
        if min(self.shape) < 1:
            msg = f"shape must be three lengths of at least 1, got {self.shape}"
            raise ValueError(msg)
        if self.n_voxels > _MANY_VOXELS:
            hint = f"{self.n_voxels} voxels of {self.spacing_m:g} m are too many"
            require_memory(_BYTES_PER_VOXEL * self.n_voxels, hint)

    @classmethod
    def cube(
        cls, center_m: tuple[float, float, float], half_side_m: float, n_per_side: int
    ) -> "Grid":
        """Grid whose first and last voxel centres lie on the faces of a cube."""
        return cls(
            origin_m=triple(float(c) - half_side_m for c in center_m),
            spacing_m=2.0 * half_side_m / (n_per_side - 1),
            shape=(n_per_side, n_per_side, n_per_side),
        )

    @classmethod
    def centered(cls, center_m: ArrayLike, spacing_m: float, shape: ArrayLike) -> "Grid":
        """Grid whose middle is `center_m` (3,) [m], of `shape` (3,) voxels."""
        counts = np.asarray(shape, dtype=np.int64)
        origin = np.asarray(center_m, dtype=np.float64) - 0.5 * spacing_m * (counts - 1)
        nx, ny, nz = (int(n) for n in counts)
        return cls(origin_m=triple(origin), spacing_m=spacing_m, shape=(nx, ny, nz))

    @property
    def n_voxels(self) -> int:
        """Number of voxels."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    @property
    def axes_m(self) -> tuple[Floats, Floats, Floats]:
        """Coordinates of the voxel centres along each axis [m]."""
        steps = (np.arange(n, dtype=np.float64) for n in self.shape)
        x, y, z = (o + self.spacing_m * k for o, k in zip(self.origin_m, steps, strict=True))
        return x, y, z

    def points(self) -> Floats:
        """Voxel centres, (n_voxels, 3) [m]; z runs fastest (C order)."""
        mesh = np.meshgrid(*self.axes_m, indexing="ij")
        return np.stack([m.ravel() for m in mesh], axis=1)
