"""Radiance behind the region of the surface."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from geraf2._validation import require_least
from geraf2.apps.photos.neus.ray_samples import intersect_ball
from geraf2.learned.fields.encoding import positional_encoding

_OPAQUE = 1e2
"""Largest optical depth; exp(-100) is negligible."""
_LAST_STEP = 1e10
"""Length of the last interval in radii: practically infinite, with a finite gradient."""


@dataclass(frozen=True, kw_only=True)
class BackgroundConfig:
    """Size of the network of the background, a small one of NeRF's kind."""

    n_layers: int = 3
    """Hidden layers of the density."""
    width: int = 64
    """Neurons of each; the colour has one more layer of half as many."""
    n_octaves: int = 6
    """Octaves of the position."""
    n_direction_octaves: int = 2
    """Octaves of the direction."""
    n_samples: int = 16
    """Samples of a ray outside the ball."""

    def __post_init__(self) -> None:
        require_least(self, n_layers=1, n_samples=1, width=2)


class NerfBackground(nn.Module):
    """Radiance field outside a ball, over the inverted sphere.

    A point at distance r > 1 radii in the unit direction e is given to the network as (e, 1 / r)
    (Zhang et al., NeRF++, 2020). Samples are even in 1 / r.

    center, radius_m: the ball [m].
    """

    def __init__(
        self,
        center: tuple[float, float, float],
        radius_m: float,
        config: BackgroundConfig,
        *,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.center: Tensor
        self.register_buffer("center", torch.tensor(center))
        self.radius_m, self.config = radius_m, config
        n_encoded = 4 + 8 * config.n_octaves
        n_direction = 3 + 6 * config.n_direction_octaves
        self.layers = nn.ModuleList()
        n_in = n_encoded
        for _ in range(config.n_layers):
            self.layers.append(nn.Linear(n_in, config.width))
            n_in = config.width
        self.density = nn.Linear(n_in, 1)
        self.bridge = nn.Linear(n_in, config.width)
        self.hidden = nn.Linear(config.width + n_direction, config.width // 2)
        self.colour = nn.Linear(config.width // 2, 3)
        generator = torch.Generator().manual_seed(seed)
        for module in self.modules():
            if isinstance(module, nn.Linear):
                bound = module.in_features**-0.5
                nn.init.uniform_(module.weight, -bound, bound, generator=generator)
                nn.init.uniform_(module.bias, -bound, bound, generator=generator)

    def forward(
        self, origins: Tensor, directions: Tensor, generator: torch.Generator | None = None
    ) -> Tensor:
        """Colour of rays behind the ball, (n_rays, 3); origins (n_rays, 3) [m].

        With a generator the samples of a ray are moved by a random share of their distance.
        """
        n = self.config.n_samples
        _, leave = intersect_ball(origins, directions, self.center, self.radius_m)
        inverse = (torch.arange(n, dtype=origins.dtype) + 0.5).repeat(origins.shape[0], 1)
        if generator is not None:
            inverse = inverse + torch.rand((origins.shape[0], 1), generator=generator) - 0.5
        inverse = 1.0 - inverse / n
        # even in the inverse of the distance beyond the exit, so that the first lies at the ball
        beyond = 1.0 / inverse.clamp(min=1e-3) - 1.0
        depth = leave[:, None].clamp(min=0.0) + self.radius_m * beyond
        points = origins[:, None] + depth[:, :, None] * directions[:, None] - self.center
        length = points.norm(dim=2, keepdim=True).clamp(min=self.radius_m)
        position = torch.cat([points / length, self.radius_m / length], dim=2)
        density, colour = self._radiance(position, directions)
        step = (depth[:, 1:] - depth[:, :-1]) / self.radius_m
        step = torch.cat([step, torch.full_like(depth[:, :1], _LAST_STEP)], dim=1)
        optical = (density * step).clamp(max=_OPAQUE)
        through = torch.exp(-torch.cumsum(optical, dim=1))
        before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], dim=1)
        return ((before - through)[:, :, None] * colour).sum(dim=1)

    def _radiance(self, position: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        n_rays, n, _ = position.shape
        hidden = _encode(position.reshape(-1, 4), self.config.n_octaves)
        for layer in self.layers:
            hidden = torch.relu(layer(hidden))
        density = torch.nn.functional.softplus(self.density(hidden)).reshape(n_rays, n)
        towards = positional_encoding(directions, self.config.n_direction_octaves)
        towards = towards[:, None].expand(-1, n, -1).reshape(n_rays * n, -1)
        seen = torch.relu(self.hidden(torch.cat([self.bridge(hidden), towards], dim=1)))
        return density, torch.sigmoid(self.colour(seen)).reshape(n_rays, n, 3)


def _encode(position: Tensor, n_octaves: int) -> Tensor:
    """Encode (e, 1 / r): first the point e, then 1 / r, (n, 4 + 8 n_octaves)."""
    first = positional_encoding(position[:, :3], n_octaves)
    last = position[:, 3:].expand(-1, 3)
    rest = positional_encoding(last, n_octaves).reshape(position.shape[0], -1, 3)[:, :, 0]
    return torch.cat([first, rest], dim=1)
