"""Base class of learned signed distances, and their domain, a cube."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from geraf2._types import Floats
from geraf2._validation import require_finite, require_positive, require_shape
from geraf2.fields.sdf_grid import SdfGrid
from geraf2.scene import Grid

Distance = Callable[[Floats], Floats]
"""Signed distance at points (n, 3) [m] -> (n,) [m]."""

_CHUNK = 2**16


@dataclass(frozen=True, kw_only=True)
class CubeDomain:
    """Cube of the capture frame in which a field is defined."""

    center_m: tuple[float, float, float]
    """Centre [m]."""
    half_side_m: float
    """Half side length [m], the unit of the normalised coordinates."""

    def __post_init__(self) -> None:
        for value in self.center_m:
            require_finite("center_m", value)
        require_positive("half_side_m", self.half_side_m)

    def normalise(self, points: Tensor) -> Tensor:
        """Coordinates in [-1, 1] of points (n, 3) [m]."""
        return (points - points.new_tensor(self.center_m)) / self.half_side_m

    def grid(self, n_per_side: int) -> Grid:
        """Voxels whose outermost centres lie on the cube's faces."""
        return Grid.cube(self.center_m, self.half_side_m, n_per_side)


class SdfSample(NamedTuple):
    """A signed distance at points."""

    value: Tensor
    """(n,) [m]."""
    gradient: Tensor
    """(n, 3), of length 1 for a true distance."""


class SdfField(nn.Module, ABC):
    """A learned signed distance, negative inside reflectors.

    Points and values are in metres; normalisation is internal. Value and gradient are
    differentiable with respect to the parameters, so (|gradient| - 1)^2 may be part of a loss.
    """

    def __init__(self, domain: CubeDomain) -> None:
        super().__init__()
        self.domain = domain

    @abstractmethod
    def forward(self, points: Tensor) -> SdfSample:
        """Value and gradient at points (n, 3) [m]."""

    @abstractmethod
    def value(self, points: Tensor) -> Tensor:
        """Only the value at points (n, 3) [m] -> (n,) [m]."""

    @abstractmethod
    def initialise(self, target: Distance, *, seed: int = 0) -> None:
        """Approximate `target` by the field."""

    @torch.no_grad()
    def sample_grid(self, grid: Grid) -> SdfGrid:
        """Values at the voxel centres of a grid, for meshes and pictures; not differentiable."""
        points = torch.from_numpy(grid.points()).to(next(self.parameters()))
        parts = [self.value(part) for part in torch.split(points, _CHUNK)]
        values = torch.cat(parts).reshape(grid.shape).to(torch.float32)
        return SdfGrid(grid=grid, values=values.cpu().numpy())


def require_points(points: Tensor) -> None:
    """Raise ValueError or TypeError unless points are a real (n, 3) tensor."""
    require_shape("points", points, (None, 3))
    if not points.is_floating_point():
        msg = f"points must be float32 or float64, got {points.dtype}"
        raise TypeError(msg)
