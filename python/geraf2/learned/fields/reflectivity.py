"""How strongly a surface answers, and two single numbers: transmitted power and sharpness."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from geraf2._validation import require_least, require_positive
from geraf2.fields.sdf_field import CubeDomain, require_points
from geraf2.learned.fields.encoding import encoded_size, positional_encoding
from geraf2.ops import sdf_grid


@dataclass(frozen=True, kw_only=True)
class ReflectivityMlpConfig:
    """Size of the network; the paper's."""

    n_layers: int = 4
    """Hidden layers."""
    width: int = 256
    """Neurons of a hidden layer."""
    n_octaves: int = 10
    """Octaves of the positional encoding."""

    def __post_init__(self) -> None:
        require_least(self, n_layers=1, width=1, n_octaves=0)


class ReflectivityMlp(nn.Module):
    """Reflectivity in (0, 2) as a perceptron of the place; exactly 1 everywhere at first.

    The bound keeps it apart from the power scalar, which carries the scale of the signal.
    """

    def __init__(
        self, domain: CubeDomain, config: ReflectivityMlpConfig | None = None, *, seed: int = 0
    ) -> None:
        super().__init__()
        self.domain = domain
        self.config = config if config is not None else ReflectivityMlpConfig()
        generator = torch.Generator().manual_seed(seed)
        layers: list[nn.Module] = []
        n_in = encoded_size(self.config.n_octaves)
        for _ in range(self.config.n_layers):
            layer = nn.Linear(n_in, self.config.width)
            with torch.no_grad():
                layer.weight.normal_(std=math.sqrt(2.0 / n_in), generator=generator)
                layer.bias.zero_()
            layers += [layer, nn.ReLU()]
            n_in = self.config.width
        last = nn.Linear(n_in, 1)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.network = nn.Sequential(*layers, last)

    def forward(self, points: Tensor) -> Tensor:
        """Reflectivity at points (n, 3) [m] -> (n,); differentiable."""
        require_points(points)
        encoded = positional_encoding(self.domain.normalise(points), self.config.n_octaves)
        return 2.0 * torch.sigmoid(self.network(encoded)[:, 0])


@dataclass(frozen=True, kw_only=True)
class ReflectivityGridConfig:
    """Resolution of the grid."""

    n_per_side: int = 25
    """Voxels along a side."""

    def __post_init__(self) -> None:
        require_least(self, n_per_side=2)


class ReflectivityGrid(nn.Module):
    """Reflectivity in (0, 2), trilinear between voxels; exactly 1 everywhere at first."""

    def __init__(self, domain: CubeDomain, config: ReflectivityGridConfig | None = None) -> None:
        super().__init__()
        self.domain = domain
        self.config = config if config is not None else ReflectivityGridConfig()
        self.grid = domain.grid(self.config.n_per_side)
        self.logits = nn.Parameter(torch.zeros(self.grid.shape))

    def forward(self, points: Tensor) -> Tensor:
        """Reflectivity at points (n, 3) [m] -> (n,); differentiable."""
        require_points(points)
        sample = sdf_grid(self.logits, self.grid, points)
        return 2.0 * torch.sigmoid(torch.as_tensor(sample.value))


class Power(nn.Module):
    """Equivalent transmitted amplitude: one positive number, trained as its logarithm."""

    def __init__(self, value: float = 1.0) -> None:
        super().__init__()
        require_positive("value", value)
        self.log_value = nn.Parameter(torch.tensor(math.log(value)))

    def forward(self) -> Tensor:
        """Return the number, a tensor without dimensions."""
        return torch.exp(self.log_value)


class Sharpness(nn.Module):
    """Sharpness s of the opacity's sigmoid [1/m]: one positive number, trained as its logarithm.

    inv_s: s at the start [1/m]; an opacity's width is about 1/s.
    max_inv_s: largest s [1/m]: rays sampled every few millimetres miss a sharper surface.
    """

    def __init__(self, inv_s: float, *, max_inv_s: float = 1e4) -> None:
        super().__init__()
        require_positive("inv_s", inv_s)
        require_positive("max_inv_s", max_inv_s)
        self.max_inv_s = max_inv_s
        self.log_inv_s = nn.Parameter(torch.tensor(math.log(inv_s)))

    def forward(self) -> Tensor:
        """Return s [1/m], a tensor without dimensions."""
        return torch.exp(self.log_inv_s.clamp(max=math.log(self.max_inv_s)))

    @torch.no_grad()
    def set(self, inv_s: float) -> None:
        """Set s [1/m], as a schedule does."""
        require_positive("inv_s", inv_s)
        self.log_inv_s.fill_(math.log(inv_s))
