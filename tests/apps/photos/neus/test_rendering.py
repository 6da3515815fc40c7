import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from geraf2.apps.photos.neus.coloured_grid import ColouredGrid, ColouredGridConfig
from geraf2.apps.photos.neus.rendering import PhotoSamplingConfig, render_rays, sample_edges
from geraf2.fields.sdf_field import CubeDomain, SdfSample
from reference.neus import render_ray

DOMAIN = CubeDomain(center_m=(0.0, 0.0, 0.0), half_side_m=1.0)


class Plane(torch.nn.Module):
    """Half space z < 0, white."""

    def value(self, points):
        return points[:, 2]

    def surface_sample(self, points):
        gradient = torch.zeros_like(points)
        gradient[:, 2] = 1.0
        return SdfSample(points[:, 2], gradient)

    def shade(self, points, directions, sample, weight):
        return weight.sum(dim=1, keepdim=True).expand(-1, 3)


def small_grid(dtype=torch.float64):
    grid = DOMAIN.grid(9)
    values = torch.from_numpy(np.linalg.norm(grid.points(), axis=1) - 0.5).reshape(grid.shape)
    config = ColouredGridConfig(n_features=4, width=6, band_voxels=2.5)
    field = ColouredGrid(DOMAIN, grid, values, config).to(dtype)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in [field.features.table, *field.view.parameters()]:
            parameter.copy_(torch.randn(parameter.shape, generator=generator, dtype=dtype))
    return field


def rays_and_edges(n_rays=5, n=12, dtype=torch.float64):
    generator = torch.Generator().manual_seed(7)
    origins = torch.randn((n_rays, 3), generator=generator, dtype=dtype)
    origins = 2.0 * origins / origins.norm(dim=1, keepdim=True)
    targets = 0.3 * torch.randn((n_rays, 3), generator=generator, dtype=dtype)
    directions = targets - origins
    directions = directions / directions.norm(dim=1, keepdim=True)
    edges = 1.0 + 2.0 * torch.rand((n_rays, n + 1), generator=generator, dtype=dtype)
    return (origins, directions), edges.sort(dim=1).values


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    height=st.floats(0.3, 2.0),
    slant=st.floats(0.0, 1.2),
    inv_s=st.floats(60.0, 300.0),
    shift=st.floats(0.0, 1.0),
)
def test_the_weight_of_a_plane_is_unbiased(height, slant, inv_s, shift):
    """Mean and largest weight lie where the ray meets the zero level, at any angle."""
    origin = torch.tensor([[0.0, 0.0, height]], dtype=torch.float64)
    direction = torch.tensor([[math.sin(slant), 0.0, -math.cos(slant)]], dtype=torch.float64)
    hit, n = height / math.cos(slant), 2000
    edges = hit * torch.linspace(0.0, 2.0, n + 1, dtype=torch.float64)[None] + shift * hit / n
    seen = render_rays(Plane(), (origin, direction), edges, inv_s)
    assert float(seen.opacity) == pytest.approx(1.0, abs=1e-5)
    assert float(seen.depth) == pytest.approx(hit, rel=1e-3)
    middles = 0.5 * (edges[:, 1:] + edges[:, :-1])
    peak = float(middles[0, seen.weight[0].argmax()])
    assert peak == pytest.approx(hit, abs=2 * hit / n)


def test_rendering_is_that_of_the_slow_twin():
    field, (rays, edges) = small_grid(), rays_and_edges()
    seen = render_rays(field, rays, edges, 20.0)
    middles = 0.5 * (edges[:, 1:] + edges[:, :-1])
    points = rays[0][:, None] + middles[:, :, None] * rays[1][:, None]
    for ray in range(edges.shape[0]):
        sample, direction = field.surface_sample(points[ray]), rays[1][ray]
        weight = seen.weight[ray]
        # the colour of the ray over its opacity stands for all of its samples
        whole = field.shade(points[ray][None], direction[None], sample, weight[None])
        colours = (whole / weight.sum()).expand(len(weight), 3)
        colour, opacity, depth = render_ray(
            sample.value.tolist(),
            sample.gradient.tolist(),
            colours.tolist(),
            direction.tolist(),
            edges[ray].tolist(),
            20.0,
        )
        assert seen.colour[ray].tolist() == pytest.approx(colour, rel=1e-7)
        assert float(seen.opacity[ray].detach()) == pytest.approx(opacity, rel=1e-9)
        assert float(seen.depth[ray].detach()) == pytest.approx(depth, rel=1e-9)


class Rendered(torch.nn.Module):
    """Everything a loss may ask of a rendering, in one vector."""

    def __init__(self, field):
        super().__init__()
        self.field = field

    def forward(self, rays, edges):
        seen = render_rays(self.field, rays, edges, 8.0)
        slope = seen.gradient.norm(dim=2).reshape(-1)
        return torch.cat([seen.colour.reshape(-1), seen.opacity, seen.depth, slope])


@pytest.mark.gradient
def test_rendering_is_differentiable_in_the_field():
    field, (rays, edges) = small_grid(), rays_and_edges(n_rays=2, n=6)
    # by choice the grid's colour sends no gradient to the normal
    field.view_dependent = False
    rendered = Rendered(field)
    names = [name for name, _ in rendered.named_parameters()]

    def evaluate(*parameters):
        values = dict(zip(names, parameters, strict=True))
        return torch.func.functional_call(rendered, values, (rays, edges))

    parameters = [p.detach().clone().requires_grad_() for p in rendered.parameters()]
    assert torch.autograd.gradcheck(
        evaluate, tuple(parameters), eps=1e-6, atol=1e-6, fast_mode=True
    )


@pytest.mark.parametrize("n_rounds", [2, 3])
def test_few_samples_in_rounds_find_all_of_a_thin_density(n_rounds):
    """16 samples of 64 coarse ones, the density a tenth as wide as a coarse interval."""
    config = PhotoSamplingConfig(n_coarse=64, n_fine=16, n_rounds=n_rounds)
    origins = torch.tensor([[0.1 * i, 0.0, 1.0 + 0.003 * i] for i in range(20)])
    directions = torch.nn.functional.normalize(torch.tensor([[0.3, 0.1, -1.0]]), dim=1)
    rays = origins, directions.expand(20, 3).contiguous()
    span = torch.zeros(20), torch.full((20,), 2.0)
    edges = sample_edges(Plane(), rays, span, config, (30.0, 400.0))
    seen = render_rays(Plane(), rays, edges, 400.0)
    hit = origins[:, 2] / -directions[0, 2]
    assert (seen.opacity > 0.99).all()
    assert ((seen.depth / seen.opacity - hit).abs() < 1e-3).all()
