"""Photos of a signed distance by volume rendering, after NeuS (Wang et al. 2021)."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from geraf2._validation import require_least
from geraf2.apps.photos.neus.coloured_grid import ColouredGrid
from geraf2.apps.photos.neus.ray_samples import even_edges, importance_edges, middle_and_step
from geraf2.ops import ray_march

_LAST_ROUND = 0.5
"""Sharpness of the last round over that of the rendering: samples reach to 7 / s."""


@dataclass(frozen=True, kw_only=True)
class PhotoSamplingConfig:
    """Number of samples of a ray."""

    n_coarse: int = 64
    """Even intervals at which only the signed distance is evaluated."""
    n_fine: int = 16
    """Samples placed by importance in each round; those of the last round are rendered."""
    n_rounds: int = 2
    """Rounds of sampling by importance; 0: the even intervals are rendered."""

    def __post_init__(self) -> None:
        require_least(self, n_coarse=1, n_fine=1, n_rounds=0)


class Rendering(NamedTuple):
    """Rendered quantities of rays."""

    colour: Tensor
    """(n_rays, 3), before black."""
    opacity: Tensor
    """Sum of the weights, (n_rays,)."""
    normal: Tensor
    """Sum of weight times unit gradient, (n_rays, 3)."""
    depth: Tensor
    """Sum of weight times distance from the origin, (n_rays,) [m]."""
    gradient: Tensor
    """Gradient of the signed distance at every sample, (n_rays, n_samples, 3)."""
    weight: Tensor
    """(n_rays, n_samples)."""


def sample_edges(
    field: ColouredGrid,
    rays: tuple[Tensor, Tensor],
    span: tuple[Tensor, Tensor],
    config: PhotoSamplingConfig,
    inv_s: tuple[float, float],
    generator: Generator | None = None,
) -> Tensor:
    """Edges of the intervals to render, (n_rays, n + 1) [m]; no gradient.

    `rays` are origins and unit directions (n_rays, 3), `span` where they enter and leave the
    region, (n_rays,) [m]; `inv_s` the sharpness of the first round and that of the rendering [1/m].
    """
    with torch.no_grad():
        edges = even_edges(*span, config.n_coarse, generator)
        first, last = inv_s[0], max(inv_s[0], _LAST_ROUND * inv_s[1])
        for number in range(config.n_rounds):
            sharpness = first * (last / first) ** (number / max(config.n_rounds - 1, 1))
            points = _points(*rays, middle_and_step(edges)[0])
            sdf = field.value(points.reshape(-1, 3)).reshape(points.shape[:2])
            edges = importance_edges(edges, sdf, sharpness, config.n_fine, generator)
    return edges


def _points(origins: Tensor, directions: Tensor, depths: Tensor) -> Tensor:
    """Points on rays (n_rays, 3) at depths (n_rays, n) [m], (n_rays, n, 3) [m]."""
    return origins[:, None] + depths[:, :, None] * directions[:, None]


def render_rays(
    field: ColouredGrid, rays: tuple[Tensor, Tensor], edges: Tensor, inv_s: float
) -> Rendering:
    r"""Colour, opacity, normal and depth along rays.

    .. math:: C = \sum_i T_i \alpha_i c_i

    field: signed distance and colour.
    rays: origins and unit directions, (n_rays, 3) [m].
    edges: of contiguous intervals along each ray, (n_rays, n + 1) [m]. Not differentiable.
    inv_s: sharpness of the logistic density [1/m].

    Returns rendering, differentiable in the parameters of the field.
    docs/math/photos.md#rendering.
    """
    origins, directions = rays
    middles, steps = middle_and_step(edges)
    n_rays, n = middles.shape
    points = _points(origins, directions, middles)
    sample = field.surface_sample(points.reshape(-1, 3))
    gradient = sample.gradient.reshape(n_rays, n, 3)
    cos = -torch.relu(-(gradient * directions[:, None]).sum(dim=2))
    march = ray_march(sample.value.reshape(n_rays, n), cos, steps, inv_s, two_way="none")
    weight = torch.as_tensor(march.weight)
    opacity = weight.sum(dim=1)
    unit = torch.nn.functional.normalize(gradient, dim=2)
    return Rendering(
        colour=field.shade(points, directions, sample, weight),
        opacity=opacity,
        normal=(weight[:, :, None] * unit).sum(dim=1),
        depth=(weight * middles).sum(dim=1),
        gradient=gradient,
        weight=weight,
    )
