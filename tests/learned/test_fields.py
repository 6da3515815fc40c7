import numpy as np
import pytest
import torch

from geraf2.fields import BoxSolid
from geraf2.learned.fields import (
    CubeDomain,
    LearnedSdfGrid,
    ReflectivityGrid,
    ReflectivityMlp,
    SdfMlp,
    SdfMlpConfig,
    sdf_mlp,
)

DOMAIN = CubeDomain(center_m=(0.3, -0.1, 0.2), half_side_m=0.15)
SMALL_MLP = SdfMlpConfig(n_layers=3, width=32, skip=2, n_octaves=2, softplus_beta=10.0)


def random_points(n, seed=0, dtype=torch.float64, reach=0.9):
    unit = torch.rand((n, 3), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    points = torch.tensor(DOMAIN.center_m) + DOMAIN.half_side_m * reach * (2 * unit - 1)
    return points.to(dtype)


def small_fields():
    grid = LearnedSdfGrid(DOMAIN, n_per_side=6)
    mlp, opening = (SdfMlp(DOMAIN, SMALL_MLP, seed=1) for _ in range(2))
    opening.open_octaves(1.4)
    with torch.no_grad():  # away from the sphere, where some derivatives vanish by symmetry
        for field in (grid, mlp, opening):
            for parameter in field.parameters():
                noise = torch.randn(parameter.shape, generator=torch.Generator().manual_seed(2))
                parameter.add_(0.05 * parameter.abs().mean() * noise)
    named = {"grid": grid, "mlp": mlp, "octaves-opening": opening}
    return [pytest.param(field.double(), id=name) for name, field in named.items()]


@pytest.mark.parametrize("field", small_fields())
def test_the_gradient_is_the_derivative_of_the_value(field):
    points, step = random_points(20), 1e-6
    value, gradient = field(points)
    torch.testing.assert_close(value, field.value(points))
    for axis in range(3):
        shift = torch.zeros(3, dtype=torch.float64)
        shift[axis] = step
        slope = (field.value(points + shift) - field.value(points - shift)) / (2 * step)
        torch.testing.assert_close(gradient[:, axis], slope, rtol=1e-5, atol=1e-6)


@pytest.mark.gradient
@pytest.mark.parametrize("field", small_fields())
def test_value_and_gradient_are_differentiable_to_the_parameters(field):
    points = random_points(4)
    names = [name for name, _ in field.named_parameters()]

    def evaluate(*parameters):
        value, gradient = torch.func.functional_call(
            field, dict(zip(names, parameters, strict=True)), (points,)
        )
        eikonal = (torch.linalg.vector_norm(gradient, dim=1) - 1) ** 2
        return value.sum(), eikonal.sum()

    inputs = [p.detach().clone().requires_grad_() for p in field.parameters()]
    assert torch.autograd.gradcheck(evaluate, inputs, eps=1e-6, atol=1e-5, fast_mode=True)


@pytest.mark.gradient
@pytest.mark.parametrize("field", small_fields())
def test_the_value_is_differentiable_to_the_points(field):
    points = random_points(5).requires_grad_()
    assert torch.autograd.gradcheck(field.value, (points,), eps=1e-6, atol=1e-6)


@pytest.mark.parametrize("config", [SdfMlpConfig(), SdfMlpConfig(n_octaves=0)])
def test_the_network_starts_as_a_sphere(config):
    field = SdfMlp(DOMAIN, config)
    points = random_points(500, dtype=torch.float32)
    radius = torch.linalg.vector_norm(points - torch.tensor(DOMAIN.center_m), dim=1)
    with torch.no_grad():
        value, gradient = field(points)
    error = (value - (radius - 0.5 * DOMAIN.half_side_m)) / DOMAIN.half_side_m
    assert error.abs().mean() < 0.1  # random weights: SAL's start is a sphere in expectation
    away = (radius > 0.2 * DOMAIN.half_side_m)[:, None]
    outward = (points - torch.tensor(DOMAIN.center_m)) / radius[:, None]
    assert (gradient * outward)[away.expand(-1, 3)].reshape(-1, 3).sum(dim=1).mean() > 0.8


def test_a_network_gives_the_same_in_parts(monkeypatch):
    network = SdfMlp(DOMAIN, SdfMlpConfig(n_layers=3, width=32, skip=0, n_octaves=2)).double()
    points, found = random_points(70), []
    for size in (1000, 16):
        monkeypatch.setattr(sdf_mlp, "_POINTS_AT_ONCE", size)
        value, gradient = network(points)
        loss = value.square().sum() + (gradient.norm(dim=1) - 1.0).square().sum()
        found.append([value, gradient, *torch.autograd.grad(loss, list(network.parameters()))])
    for whole, parts in zip(*found, strict=True):
        torch.testing.assert_close(parts, whole)


def box_distance(points):
    return BoxSolid(size_m=(0.2, 0.16, 0.2), center_m=DOMAIN.center_m).signed_distance(points)


def test_a_network_is_fitted_to_a_box():
    config = SdfMlpConfig(
        n_layers=3, width=48, skip=0, n_octaves=2, fit_steps=120, fit_points=512, fit_rate=3e-3
    )
    field = SdfMlp(DOMAIN, config)
    field.initialise(box_distance)
    points = random_points(1000, seed=5, dtype=torch.float32)
    with torch.no_grad():
        error = field.value(points).numpy() - box_distance(points.double().numpy())
    assert np.abs(error).mean() < 0.02 * DOMAIN.half_side_m


def test_upsampling_keeps_the_values():
    field = LearnedSdfGrid(DOMAIN, n_per_side=9)
    field.initialise(box_distance)
    voxels, points = torch.from_numpy(field.grid.points()).float(), random_points(300)
    with torch.no_grad():
        before, between = field.value(voxels), field.value(points.float())
    field.upsample()
    assert field.grid.shape == (17, 17, 17)
    assert field.values.requires_grad
    with torch.no_grad():
        torch.testing.assert_close(field.value(voxels), before, rtol=0, atol=1e-6)
        change = (field.value(points.float()) - between).abs().max()
    assert change < 0.002  # a cubic through more points bends a little otherwise
    with pytest.raises(ValueError, match="n_per_side must be at least 17, got 9"):
        field.upsample(9)


@pytest.mark.parametrize(
    "module",
    [
        ReflectivityMlp(DOMAIN, n_layers=2, width=8, n_octaves=1),
        ReflectivityGrid(DOMAIN, n_per_side=4),
    ],
    ids=["mlp", "grid"],
)
def test_reflectivity_is_one_at_first(module):
    points = random_points(50, dtype=torch.float32)
    assert (module(points) == 1.0).all()
