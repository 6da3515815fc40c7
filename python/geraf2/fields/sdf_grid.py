"""A signed distance sampled on a regular grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._short import Short
from geraf2._types import AnyPath, Floats
from geraf2._validation import require_shape
from geraf2.errors import UserError
from geraf2.io.array_layouts import read_arrays
from geraf2.io.atomic import write_npz_atomic
from geraf2.ops import sdf_grid
from geraf2.ops._geometry import rows_of
from geraf2.scene import Grid

_LAYOUTS = {"values": "float x y z", "origin_m": "float 3", "spacing_m": "float"}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SdfGrid(Short):
    """Signed distance at voxel centres, negative inside reflectors [m]."""

    grid: Grid
    """Voxel centres."""
    values: NDArray[np.float32]
    """Signed distance at each voxel centre, grid.shape [m]."""

    def __post_init__(self) -> None:
        require_shape("values", self.values, self.grid.shape)

    def sample(self, points: NDArray[np.floating]) -> Floats:
        """Trilinear signed distance at points (..., 3) [m] -> (...) [m].

        Outside the grid the value of the nearest face is used. Not differentiable, unlike
        geraf2.ops.sdf_grid.
        """
        rows, shape = rows_of("points", np.asarray(points, dtype=np.float64))
        found = sdf_grid(self.values, self.grid, rows).value.reshape(shape)
        return np.asarray(found, dtype=np.float64)

    def save(self, path: AnyPath) -> None:
        """Write `sdf.npz`: values [m], origin_m and spacing_m of the grid [m]."""
        write_npz_atomic(
            path,
            {
                "values": self.values,
                "origin_m": np.asarray(self.grid.origin_m, dtype=np.float64),
                "spacing_m": np.asarray(self.grid.spacing_m, dtype=np.float64),
            },
        )

    @classmethod
    def load(cls, path: AnyPath) -> "SdfGrid":
        """Read a file written by `save`; UserError for any other file."""
        arrays = read_arrays(path, _LAYOUTS)
        x, y, z = arrays["origin_m"].tolist()
        nx, ny, nz = arrays["values"].shape
        try:
            spacing = float(arrays["spacing_m"])
            grid = Grid(origin_m=(x, y, z), spacing_m=spacing, shape=(nx, ny, nz))
            return cls(grid=grid, values=arrays["values"].astype(np.float32, copy=False))
        except (ValueError, TypeError) as error:
            raise UserError(what=f"not a signed distance grid: {error}", where=path) from error
