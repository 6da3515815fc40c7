"""Signed distance as trainable values on a grid of increasing resolution."""

import numpy as np
import torch
from torch import Tensor, nn

from geraf2._validation import require_shape
from geraf2.fields.sdf_field import CubeDomain, Distance, SdfField, SdfSample, require_points
from geraf2.ops import sdf_grid
from geraf2.scene import Grid

_INIT_RADIUS = 0.5
"""Radius of the initial sphere, in units of the domain's half side."""


class LearnedSdfGrid(SdfField):
    """Grid values as parameters; native cubic interpolation with second derivatives to them.

    domain: its faces hold the outermost voxel centres. Outside, the nearest face's value holds.
    n_per_side: voxels along a side at the start.

    Not to be confused with :class:`geraf2.fields.SdfGrid`, which has no parameters.
    """

    values: Tensor

    def __init__(self, domain: CubeDomain, n_per_side: int = 25) -> None:
        super().__init__(domain)
        self.grid = domain.grid(n_per_side)
        center, radius = np.asarray(domain.center_m), _INIT_RADIUS * domain.half_side_m
        self.values = nn.Parameter(torch.zeros(self.grid.shape))
        self.initialise(lambda points: np.linalg.norm(points - center, axis=1) - radius)

    def forward(self, points: Tensor) -> SdfSample:
        """Value and gradient at points (n, 3) [m]."""
        require_points(points)
        sample = sdf_grid(self.values, self.grid, points, interpolation="cubic")
        return SdfSample(torch.as_tensor(sample.value), torch.as_tensor(sample.gradient))

    def value(self, points: Tensor) -> Tensor:
        """Value alone at points (n, 3) [m] -> (n,) [m]."""
        return self.forward(points).value

    @torch.no_grad()
    def initialise(self, target: Distance, *, seed: int = 0) -> None:
        """Set the values of a signed distance at the voxel centres; `seed` is not used."""
        del seed
        values = torch.from_numpy(np.asarray(target(self.grid.points()), dtype=np.float64))
        self.values.copy_(values.reshape(self.grid.shape))

    @torch.no_grad()
    def upsample(self, n_per_side: int | None = None) -> None:
        """Replace the grid by a finer one with the same values where both have voxels.

        n_per_side: voxels along a side; by default 2 n - 1, which keeps every voxel centre.

        The parameter is replaced; create a new optimiser.
        """
        wanted = 2 * self.grid.shape[0] - 1 if n_per_side is None else n_per_side
        if wanted < self.grid.shape[0]:
            msg = f"n_per_side must be at least {self.grid.shape[0]}, got {wanted}"
            raise ValueError(msg)
        finer = self.domain.grid(wanted)
        values = self.value(torch.from_numpy(finer.points()).to(self.values))
        self.regrid(finer, values.reshape(finer.shape))

    def regrid(self, grid: Grid, values: Tensor) -> None:
        """Replace grid and values (grid.shape) [m]; the grid need not be a cube.

        The parameter is replaced; create a new optimiser.
        """
        require_shape("values", values, grid.shape)
        self.grid = grid
        self.values = nn.Parameter(values.detach().to(self.values.dtype).clone())
