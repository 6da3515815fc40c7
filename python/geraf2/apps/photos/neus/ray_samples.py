"""Samples along the rays of a photo: intersections, even intervals, importance."""

import torch
from torch import Generator, Tensor

from geraf2.ops.ray_march import ray_march

_SPREAD = 1e-2
"""Share of the samples' density without transmittance, see `importance_edges`."""
_FLOOR = 1e-5
"""Share that is even, so that the inverse of a density of zero exists."""


def intersect_box(
    origins: Tensor, directions: Tensor, low: Tensor, high: Tensor
) -> tuple[Tensor, Tensor]:
    """Entry and exit of rays (n, 3) in an upright box, (n,) each [m]; entry >= exit: missed.

    A ray that begins within enters at zero.
    """
    tiny = torch.finfo(directions.dtype).tiny
    safe = torch.where(directions.abs() < tiny, tiny, directions)
    first, second = (low - origins) / safe, (high - origins) / safe
    near = torch.minimum(first, second).amax(dim=1).clamp(min=0.0)
    return near, torch.maximum(first, second).amin(dim=1)


def even_edges(
    near: Tensor, far: Tensor, n_intervals: int, generator: Generator | None = None
) -> Tensor:
    """Edges of equal intervals from near to far, (n_rays, n_intervals + 1) [m].

    With a generator, all edges of a ray but the outer ones move by the same random share of an
    interval, so that the samples of many steps are dense.
    """
    share = torch.linspace(0.0, 1.0, n_intervals + 1, dtype=near.dtype).repeat(near.shape[0], 1)
    if generator is not None:
        shift = torch.rand((near.shape[0], 1), generator=generator, dtype=near.dtype) - 0.5
        share[:, 1:-1] += shift / n_intervals
    return near[:, None] + (far - near)[:, None] * share


def slopes(sdf: Tensor, middles: Tensor) -> Tensor:
    """Slope of the signed distance along rays, (n_rays, n): the steeper of both sides, below 0."""
    steps = (middles[:, 1:] - middles[:, :-1]).clamp(min=torch.finfo(middles.dtype).tiny)
    between = (sdf[:, 1:] - sdf[:, :-1]) / steps
    if between.shape[1] == 0:
        return torch.zeros_like(sdf)
    before = torch.cat([between[:, :1], between], dim=1)
    after = torch.cat([between, between[:, -1:]], dim=1)
    return torch.minimum(before, after).clamp(-1.0, 0.0)


def importance_edges(
    edges: Tensor, sdf: Tensor, inv_s: float, n_intervals: int, generator: Generator | None = None
) -> Tensor:
    """Edges of intervals that are dense where a ray meets the surface.

    The density is the weight of the coarse intervals at sharpness `inv_s`, plus a hundredth of
    Phi (1 - Phi), which has no transmittance: a ray that misses is sampled where it passes closest.

    edges: of contiguous coarse intervals, rising, (n_rays, n_coarse + 1) [m].
    sdf: signed distance at their middles, (n_rays, n_coarse) [m].
    generator: of a random shift; none: the middles of equal shares.

    Returns (n_rays, n_intervals + 1), rising [m]. No gradient.
    """
    middles, steps = middle_and_step(edges)
    weight = ray_march(sdf, slopes(sdf, middles), steps, inv_s, two_way="none").weight
    phi = torch.sigmoid(inv_s * sdf)
    near = phi * (1.0 - phi) * steps
    density = torch.as_tensor(weight) + _SPREAD * near / near.sum(dim=1, keepdim=True).clamp(
        min=torch.finfo(near.dtype).tiny
    )
    density = density + _FLOOR * steps / steps.sum(dim=1, keepdim=True).clamp(min=1e-12)
    return _inverse(edges, density, n_intervals + 1, generator)


def _inverse(edges: Tensor, density: Tensor, n: int, generator: Generator | None) -> Tensor:
    """Quantiles of a density that is constant between edges, (n_rays, n) [m]."""
    total = torch.cumsum(density, dim=1)
    total = torch.cat([torch.zeros_like(total[:, :1]), total], dim=1)
    total = total / total[:, -1:]
    shares = (torch.arange(n, dtype=edges.dtype) + 0.5) / n
    shares = shares.repeat(edges.shape[0], 1)
    if generator is not None:
        shift = torch.rand((edges.shape[0], 1), generator=generator, dtype=edges.dtype) - 0.5
        shares = shares + shift / n
    index = torch.searchsorted(total, shares, right=True).clamp(1, total.shape[1] - 1)
    low, high = total.gather(1, index - 1), total.gather(1, index)
    first, last = edges.gather(1, index - 1), edges.gather(1, index)
    share = (shares - low) / (high - low).clamp(min=torch.finfo(edges.dtype).tiny)
    return first + (last - first) * share.clamp(0.0, 1.0)


def middle_and_step(edges: Tensor) -> tuple[Tensor, Tensor]:
    """Middles and lengths of contiguous intervals, (n_rays, n) each [m]."""
    return 0.5 * (edges[:, 1:] + edges[:, :-1]), edges[:, 1:] - edges[:, :-1]
