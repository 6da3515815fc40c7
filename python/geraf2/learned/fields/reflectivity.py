"""Reflectivity of a surface, and two scalars: transmitted power and sharpness."""

import math

import torch
from torch import Tensor, nn

from geraf2._validation import require_positive
from geraf2.fields.sdf_field import CubeDomain, require_points
from geraf2.learned.fields.encoding import encoded_size, positional_encoding
from geraf2.ops import sdf_grid

_MAX_INV_S = 1e4
"""Largest s [1/m]: rays sampled every few millimetres miss a sharper surface."""


class ReflectivityMlp(nn.Module):
    """Reflectivity in (0, 2) as a perceptron of the position; starts as 1 everywhere.

    The bound leaves the scale of the signal to the power scalar. The size is the paper's.

    n_layers, width: hidden layers, and neurons of each.
    n_octaves: octaves of the positional encoding.
    """

    def __init__(
        self,
        domain: CubeDomain,
        *,
        n_layers: int = 4,
        width: int = 256,
        n_octaves: int = 10,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.domain, self.n_octaves = domain, n_octaves
        generator = torch.Generator().manual_seed(seed)
        layers: list[nn.Module] = []
        n_in = encoded_size(n_octaves)
        for _ in range(n_layers):
            layer = nn.Linear(n_in, width)
            with torch.no_grad():
                layer.weight.normal_(std=math.sqrt(2.0 / n_in), generator=generator)
                layer.bias.zero_()
            layers += [layer, nn.ReLU()]
            n_in = width
        last = nn.Linear(n_in, 1)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.network = nn.Sequential(*layers, last)

    def forward(self, points: Tensor) -> Tensor:
        """Reflectivity at points (n, 3) [m] -> (n,); differentiable."""
        require_points(points)
        encoded = positional_encoding(self.domain.normalise(points), self.n_octaves)
        return 2.0 * torch.sigmoid(self.network(encoded)[:, 0])


class ReflectivityGrid(nn.Module):
    """Reflectivity in (0, 2), trilinear between voxels; starts as 1 everywhere."""

    def __init__(self, domain: CubeDomain, n_per_side: int = 25) -> None:
        super().__init__()
        self.grid = domain.grid(n_per_side)
        self.logits = nn.Parameter(torch.zeros(self.grid.shape))

    def forward(self, points: Tensor) -> Tensor:
        """Reflectivity at points (n, 3) [m] -> (n,); differentiable."""
        require_points(points)
        sample = sdf_grid(self.logits, self.grid, points)
        return 2.0 * torch.sigmoid(torch.as_tensor(sample.value))


class Power(nn.Module):
    """Equivalent transmitted amplitude: a positive scalar, trained as its logarithm."""

    def __init__(self) -> None:
        super().__init__()
        self.log_value = nn.Parameter(torch.tensor(0.0))

    def forward(self) -> Tensor:
        """Amplitude, a tensor without dimensions."""
        return torch.exp(self.log_value)


class Sharpness(nn.Module):
    """Sharpness s of the opacity's sigmoid [1/m]: a positive scalar, trained as its logarithm.

    inv_s: s at the start [1/m]; an opacity's width is about 1/s.
    """

    def __init__(self, inv_s: float) -> None:
        super().__init__()
        require_positive("inv_s", inv_s)
        self.log_inv_s = nn.Parameter(torch.tensor(math.log(inv_s)))

    def forward(self) -> Tensor:
        """Sharpness s [1/m], a tensor without dimensions."""
        return torch.exp(self.log_inv_s.clamp(max=math.log(_MAX_INV_S)))

    @torch.no_grad()
    def set(self, inv_s: float) -> None:
        """Set s [1/m]."""
        require_positive("inv_s", inv_s)
        self.log_inv_s.fill_(math.log(inv_s))
