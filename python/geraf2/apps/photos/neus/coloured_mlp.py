"""Coloured surface as two perceptrons: the field of NeuS."""

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn
from torch.nn.utils.parametrizations import weight_norm

from geraf2._validation import require_least
from geraf2.fields.sdf_field import CubeDomain
from geraf2.learned.fields.encoding import encoded_size, positional_encoding
from geraf2.learned.fields.sdf_mlp import FeatureSample, SdfMlp, SdfMlpConfig


@dataclass(frozen=True, kw_only=True)
class ColouredMlpConfig:
    """Sizes of the two networks; those of NeuS, which the paper adopts."""

    sdf: SdfMlpConfig = field(default_factory=lambda: SdfMlpConfig(n_octaves=6, n_features=256))
    """Signed distance: 8 layers of 256, 6 octaves, 256 features for the colour."""
    n_layers: int = 4
    """Hidden layers of the colour's network."""
    width: int = 256
    """Neurons of each."""
    n_octaves: int = 4
    """Octaves of the direction's encoding."""

    def __post_init__(self) -> None:
        require_least(self, n_layers=1, width=1, n_octaves=0)


class ColouredMlp(nn.Module):
    """Perceptron of the signed distance, and one that gives each sample its colour.

    The colour depends on position, direction, gradient and features (Yariv et al. 2020, as NeuS has
    it). `domain`: cube about the ball in which the surface lies.
    """

    def __init__(self, domain: CubeDomain, config: ColouredMlpConfig, *, seed: int = 0) -> None:
        super().__init__()
        self.config, self.domain = config, domain
        self.distance = SdfMlp(domain, config.sdf, seed=seed)
        sizes = [3 + encoded_size(config.n_octaves) + 3 + config.sdf.n_features]
        sizes += [config.width] * config.n_layers
        layers: list[nn.Module] = []
        generator = torch.Generator().manual_seed(seed + 1)
        for n_in, n_out in zip(sizes, [*sizes[1:], 3], strict=True):
            linear = nn.Linear(n_in, n_out)
            _start(linear, generator)
            layers += [weight_norm(linear), nn.ReLU()]
        self.colour = nn.Sequential(*layers[:-1])

    def value(self, points: Tensor) -> Tensor:
        """Signed distance (n_points,) [m]."""
        return self.distance.value(points)

    def surface_sample(self, points: Tensor) -> FeatureSample:
        """Signed distance [m], gradient, and the features that the colour depends on."""
        return self.distance.forward_with_features(points)

    def shade(
        self, points: Tensor, directions: Tensor, sample: FeatureSample, weight: Tensor
    ) -> Tensor:
        """Colour of rays, not yet composed with the background; one run of the network a sample.

        points: samples of each ray, (n_rays, n, 3) [m].
        directions: unit vectors from the camera, (n_rays, 3).
        sample: `surface_sample` at these points, ray by ray.
        weight: weight of each sample, (n_rays, n).

        Returns (n_rays, 3), each at most the sum of the ray's weights.
        """
        n_rays, n_samples = weight.shape
        towards = positional_encoding(directions, self.config.n_octaves)
        towards = towards[:, None].expand(-1, n_samples, -1).reshape(n_rays * n_samples, -1)
        position = self.domain.normalise(points.reshape(-1, 3))
        seen = torch.cat([position, towards, sample.gradient, sample.features], dim=1)
        colour = torch.sigmoid(self.colour(seen)).reshape(n_rays, n_samples, 3)
        return (weight[:, :, None] * colour).sum(dim=1)


@torch.no_grad()
def _start(linear: nn.Linear, generator: torch.Generator) -> None:
    """Initialise with torch's default uniform distribution, from a generator."""
    bound = linear.in_features**-0.5
    linear.weight.uniform_(-bound, bound, generator=generator)
    linear.bias.uniform_(-bound, bound, generator=generator)
