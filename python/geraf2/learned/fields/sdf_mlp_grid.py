"""A network's signed distance, evaluated at voxels once a step and interpolated between them."""

import torch
from torch import Tensor
from torch.nn.utils import parametrize

from geraf2.fields.sdf_field import CubeDomain, Distance, SdfField, SdfSample, require_points
from geraf2.learned.fields.sdf_mlp import SdfMlp, SdfMlpConfig
from geraf2.ops import sdf_grid

_VOXELS_AT_ONCE = 1024


class SdfMlpGrid(SdfField):
    """The network of :class:`SdfMlp`, sampled through the voxels of a grid.

    domain: its faces hold the outermost voxel centres. Outside, the nearest face's value holds.
    n_per_side: voxels along a side at the start.

    A step calls `refresh`, renders, accumulates gradients in `values`, and calls `pull_back`.

    A step of four planes needs distance, slope and second derivatives at 60,000 samples or more;
    25^3 voxels are 16,000 points without derivatives, for any number of planes. The network
    regularises the voxels: smooth shapes are learned first (deep priors: Ulyanov et al. 2018).
    """

    def __init__(
        self,
        domain: CubeDomain,
        config: SdfMlpConfig | None = None,
        *,
        n_per_side: int = 25,
        seed: int = 0,
    ) -> None:
        super().__init__(domain)
        self.network = SdfMlp(domain, config, seed=seed)
        self.grid = domain.grid(n_per_side)
        self._live = self.values = torch.zeros(self.grid.shape)
        self.refresh()

    def leaves(self) -> list[Tensor]:
        """Voxel values, which receive the gradients of a step."""
        return [self.values]

    def refresh(self) -> None:
        """Evaluate the network; `values` (x, y, z) [m] become new leaves."""
        like = next(self.network.parameters())
        positions = torch.from_numpy(self.grid.points()).to(like)
        with torch.enable_grad(), parametrize.cached():
            parts = [self.network.value(part) for part in torch.split(positions, _VOXELS_AT_ONCE)]
            self._live = torch.cat(parts).reshape(self.grid.shape)
        self.values = self._live.detach().requires_grad_()

    def pull_back(self) -> None:
        """Propagate the gradient of `values` to the network's parameters, and clear it.

        Only once per `refresh`, as it frees the recorded evaluation.
        """
        if self.values.grad is not None:
            torch.autograd.backward(self._live, self.values.grad)
            self.values.grad = None

    def forward(self, points: Tensor) -> SdfSample:
        """Value and gradient at points (n, 3) [m]."""
        require_points(points)
        sample = sdf_grid(self.values, self.grid, points, interpolation="cubic")
        return SdfSample(torch.as_tensor(sample.value), torch.as_tensor(sample.gradient))

    def value(self, points: Tensor) -> Tensor:
        """Value alone at points (n, 3) [m] -> (n,) [m]."""
        return self.forward(points).value

    def initialise(self, target: Distance, *, seed: int = 0) -> None:
        """Fit the network to a signed distance, see :meth:`SdfMlp.initialise`."""
        self.network.initialise(target, seed=seed)
        self.refresh()

    def upsample(self, n_per_side: int) -> None:
        """Replace the grid by a finer one; parameters stay."""
        if n_per_side < self.grid.shape[0]:
            msg = f"n_per_side must be at least {self.grid.shape[0]}, got {n_per_side}"
            raise ValueError(msg)
        self.grid = self.domain.grid(n_per_side)
        self.refresh()
