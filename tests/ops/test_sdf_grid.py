"""Grid interpolation against its slow twin, its adjoint and finite differences."""

import numpy as np
import pytest
import torch

from geraf2.ops import sdf_grid
from geraf2.scene import Grid
from reference import sdf_grid as reference

INTERPOLATIONS = ("linear", "cubic")
GRID = Grid(origin_m=(0.1, -0.2, 0.3), spacing_m=0.05, shape=(5, 4, 6))


def make_case(n_points=40, margin=0.02):
    """White noise on the grid; points within it and up to `margin` beyond its rim."""
    random = torch.Generator().manual_seed(0)
    values = torch.randn(GRID.shape, generator=random, dtype=torch.float64)
    low = torch.tensor(GRID.origin_m, dtype=torch.float64) - margin
    extent = GRID.spacing_m * (torch.tensor(GRID.shape) - 1) + 2 * margin
    return values, low + extent * torch.rand((n_points, 3), generator=random, dtype=torch.float64)


def twin(values, points, interpolation):
    points = points.detach().requires_grad_(True)
    value = reference.sdf_grid(values, GRID, points, interpolation)
    (gradient,) = torch.autograd.grad(value.sum(), points)
    return value.detach(), gradient


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 2e-6)])
@pytest.mark.usefixtures("simd")
def test_value_and_gradient_are_those_of_the_twin(interpolation, dtype, tolerance):
    values, points = make_case()
    got = sdf_grid(values.to(dtype), GRID, points, interpolation=interpolation)
    for have, want in zip(got, twin(values.to(dtype).double(), points, interpolation), strict=True):
        assert have.dtype == dtype
        assert float((have - want).norm() / want.norm()) < tolerance


def test_cubic_reproduces_parabolas_and_has_a_continuous_gradient():
    position = torch.from_numpy(GRID.points()).reshape(*GRID.shape, 3)
    values = 2.0 * position[..., 0] ** 2 - position[..., 1] + 0.5 * position[..., 2] ** 2
    x = torch.tensor([[0.21, -0.13, 0.41], [0.18, -0.12, 0.43]], dtype=torch.float64)
    value, gradient = sdf_grid(values, GRID, x, interpolation="cubic")
    want = 2.0 * x[:, 0] ** 2 - x[:, 1] + 0.5 * x[:, 2] ** 2
    torch.testing.assert_close(value, want, rtol=1e-12, atol=0.0)
    slope = torch.stack([4.0 * x[:, 0], -torch.ones(2), x[:, 2]], dim=1)
    torch.testing.assert_close(gradient, slope, rtol=1e-10, atol=0.0)
    noise, _ = make_case()
    face = torch.tensor([0.2, -0.13, 0.41], dtype=torch.float64)  # on a voxel plane
    either = torch.stack([face - torch.tensor([1e-9, 0, 0]), face + torch.tensor([1e-9, 0, 0])])
    for interpolation, jump in (("linear", True), ("cubic", False)):
        gradient = sdf_grid(noise, GRID, either, interpolation=interpolation).gradient
        assert (float((gradient[0] - gradient[1]).abs().max()) > 1e-3) == jump


@pytest.mark.gradient
@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.usefixtures("simd")
def test_gradcheck(interpolation):
    values, points = make_case(n_points=3, margin=0.0)
    assert torch.autograd.gradcheck(
        lambda v, x: tuple(sdf_grid(v, GRID, x, interpolation=interpolation, num_threads=1)),
        [values.requires_grad_(True), points.requires_grad_(True)],
        eps=1e-6,
        atol=1e-4,  # slopes are of the order of 1e3
    )


@pytest.mark.gradient
@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_gradgradcheck_in_the_values(interpolation):
    values, points = make_case(n_points=2)

    def eikonal(v):
        gradient = sdf_grid(v, GRID, points, interpolation=interpolation, num_threads=1).gradient
        return ((gradient.norm(dim=1) - 1.0) ** 2).sum() / 100.0

    assert torch.autograd.gradcheck(eikonal, [values.requires_grad_(True)], atol=1e-4)
    assert torch.autograd.gradgradcheck(eikonal, [values], atol=1e-4)


@pytest.mark.gradient
@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_eikonal_is_the_same_by_either_gradient(interpolation):
    values, points = make_case(margin=0.0)
    found = []
    for own in (True, False):
        v, x = values.clone().requires_grad_(True), points.clone().requires_grad_(True)
        out = sdf_grid(v, GRID, x, interpolation=interpolation)
        gradient = out.gradient
        if not own:
            (gradient,) = torch.autograd.grad(out.value.sum(), x, create_graph=True)
        (gradient.norm(dim=1) - 1.0).pow(2).sum().backward()
        found.append(v.grad)
    torch.testing.assert_close(*found, rtol=1e-12, atol=1e-9)


def test_a_missing_derivative_is_an_error():
    values, points = make_case(n_points=2)
    x = points.requires_grad_(True)
    gradient = sdf_grid(values, GRID, x).gradient
    (hessian,) = torch.autograd.grad(gradient.sum(), x, create_graph=True)
    with pytest.raises(NotImplementedError, match="Hessian has no gradient"):
        hessian.sum().backward()


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_edges(interpolation):
    values, points = make_case()
    far = sdf_grid(values, GRID, torch.full((1, 3), 1e5), interpolation=interpolation)
    assert far.value.item() == pytest.approx(values[-1, -1, -1].item())
    assert not far.gradient.any()
    assert sdf_grid(values, GRID, points[:0], interpolation=interpolation).gradient.shape == (0, 3)
    one = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=1.0, shape=(1, 1, 1))
    out = sdf_grid(np.full((1, 1, 1), 3.0), one, np.zeros((2, 3)), interpolation=interpolation)
    assert isinstance(out.value, np.ndarray)
    assert out.value.tolist() == [3.0, 3.0]
    assert not out.gradient.any()
    strided = values.permute(2, 1, 0).contiguous().permute(2, 1, 0)
    want = sdf_grid(values, GRID, points, interpolation=interpolation)
    got = sdf_grid(strided, GRID, points, interpolation=interpolation)
    assert torch.equal(got.gradient, want.gradient)
    values[2, 2, 2] = torch.nan
    assert torch.isnan(sdf_grid(values, GRID, points, interpolation=interpolation).value).any()
