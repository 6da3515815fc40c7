"""Ray march against its slow twin, closed forms and finite differences.

The twin subtracts two sigmoids, so in float64 it is good to 1e-16 of Phi / (Phi step): 1e-9 covers
the sharpness used here. float32 is compared with the float64 twin: a few roundings a sample, and
one product over 64 samples, 64 ulp = 8e-6.
"""

import math

import pytest
import torch

from geraf2.ops import ray_march
from reference import ray_march as reference
from reference.closeness import assert_close

FORMS = ("unbiased", "squared", "none")


def make_case(n_rays=19, n_samples=67, seed=0):
    """Rays that enter and leave surfaces, of sharpness 80 per metre; no multiple of any vector."""
    random = torch.Generator().manual_seed(seed)

    def uniform(low, high):
        u = torch.rand((n_rays, n_samples), generator=random, dtype=torch.float64)
        return low + (high - low) * u

    return (
        uniform(-0.03, 0.12),
        uniform(-1.0, 0.3),
        uniform(0.002, 0.01),
        torch.tensor(80.0, dtype=torch.float64),
    )


@pytest.mark.parametrize("two_way", FORMS)
@pytest.mark.usefixtures("simd")
def test_float64_is_that_of_the_twin(two_way):
    case = make_case()
    for got, want in zip(
        ray_march(*case, two_way=two_way), reference.ray_march(*case, two_way), strict=True
    ):
        torch.testing.assert_close(got, want, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("two_way", FORMS)
@pytest.mark.usefixtures("simd")
def test_float32_is_that_of_the_float64_twin(two_way):
    single = [t.float() for t in make_case()]
    want = reference.ray_march(*(t.double() for t in single), two_way)
    for have, twin in zip(ray_march(*single, two_way=two_way), want, strict=True):
        assert have.dtype == torch.float32
        assert_close(have, twin, element=1e-5, norm=1e-5, cosine=1e-10, bias=1e-5)


def straight_ray(inv_s, n_samples=2000):
    """Head on through a plane 0.5 m ahead."""
    step = torch.full((1, n_samples), 1.0 / n_samples, dtype=torch.float64)
    middle = torch.cumsum(step, dim=1) - step / 2
    return 0.5 - middle, -torch.ones_like(step), step, inv_s, middle[0]


def test_the_unbiased_form_peaks_at_the_surface_and_the_squared_in_front_of_it():
    *case, middle = straight_ray(84.0)
    unbiased = ray_march(*case, two_way="unbiased")
    squared = ray_march(*case, two_way="squared")
    assert float(middle[unbiased.weight[0].argmax()]) == pytest.approx(0.5, abs=5e-4)
    assert float(middle[squared.weight[0].argmax()]) == pytest.approx(
        0.5 - math.log(2.0) / 84.0, abs=5e-4
    )


def test_transmittance_is_phi_and_depth_its_mean():
    # Without bias from step to step: the product of 1 - alpha telescopes to Phi at the far end.
    for n_samples in (50, 2000):
        *case, _ = straight_ray(84.0, n_samples)
        out = ray_march(*case)
        begin = torch.arange(n_samples, dtype=torch.float64) / n_samples
        torch.testing.assert_close(
            out.transmittance[0], torch.sigmoid(84.0 * (0.5 - begin)), rtol=1e-12, atol=1e-15
        )
        assert float(out.weight.sum()) == pytest.approx(1.0, abs=1e-12)
        assert float(out.depth) == pytest.approx(0.5, abs=1e-9)


@pytest.mark.gradient
@pytest.mark.parametrize("two_way", FORMS)
def test_gradcheck(two_way):
    sdf, cos, step, inv_s = make_case(n_rays=2, n_samples=5)
    inputs = [t.requires_grad_(True) for t in (sdf, cos, inv_s)]
    assert torch.autograd.gradcheck(
        lambda f, c, s: tuple(ray_march(f, c, step, s, two_way=two_way)),
        inputs,
        eps=1e-7,
        atol=1e-6,
        rtol=1e-5,
    )


@pytest.mark.gradient
@pytest.mark.parametrize("name", ["alpha", "transmittance", "weight", "depth"])
@pytest.mark.parametrize("two_way", FORMS)
@pytest.mark.usefixtures("simd")
def test_float32_gradients_are_those_of_the_float64_twin(two_way, name):
    single = [t.float() for t in make_case()]
    found = []
    for march, dtype in ((ray_march, torch.float32), (reference.ray_march, torch.float64)):
        sdf, cos, step, inv_s = (t.clone().to(dtype) for t in single)
        inputs = [t.requires_grad_(True) for t in (sdf, cos, inv_s)]
        if march is ray_march:
            out = getattr(march(sdf, cos, step, inv_s, two_way=two_way), name)
        else:
            names = ("alpha", "transmittance", "weight", "depth")
            out = march(sdf, cos, step, inv_s, two_way)[names.index(name)]
        weights = torch.linspace(-1.0, 2.0, out.numel(), dtype=torch.float64).reshape(out.shape)
        (out * weights).sum().backward()
        found.append([t.grad for t in inputs])
    for have, want in zip(*found, strict=True):
        assert have.dtype == torch.float32
        assert_close(have, want, element=2e-4, norm=2e-5, cosine=1e-9, bias=2e-5)


@pytest.mark.gradient
def test_no_gradient_overflows_where_the_ray_is_stopped():
    sdf = torch.tensor([[5.0, 1.0, -1.0, -50.0]], dtype=torch.float32, requires_grad=True)
    cos = torch.tensor([[-1.0, -1.0, -1.0, -1.0]], dtype=torch.float32, requires_grad=True)
    inv_s = torch.tensor(1e6, requires_grad=True)
    out = ray_march(sdf, cos, torch.ones_like(sdf), inv_s)
    sum(part.sum() for part in out).backward()
    for tensor in (*out, sdf.grad, cos.grad, inv_s.grad):
        assert torch.isfinite(tensor).all()
    assert out.transmittance.detach()[0].tolist() == [1.0, 1.0, 1.0, 0.0]


def test_transmittance_ends_in_zero_and_not_in_denormals():
    inside = torch.full((1, 4000), -1.0)
    out = ray_march(inside, inside, torch.full_like(inside, 0.01), 80.0)
    smallest = out.transmittance[out.transmittance > 0].min()
    assert smallest > torch.finfo(torch.float32).tiny
    assert out.transmittance[0, -1] == 0.0


def test_a_ray_that_leaves_sees_nothing():
    sdf, cos, step, inv_s = make_case()
    out = ray_march(sdf, cos.abs(), step, inv_s)
    assert not out.alpha.any()
    assert (out.transmittance == 1.0).all()


def test_threads_empty_strides_and_arrays():
    case = make_case(n_rays=1000)  # enough for three threads
    want = ray_march(*case, num_threads=1)
    for got in (
        ray_march(*case, num_threads=3),
        ray_march(*(t.T.contiguous().T for t in case[:3]), case[3]),
        [torch.from_numpy(a) for a in ray_march(*(t.numpy() for t in case[:3]), 80.0)],
    ):
        assert all(torch.equal(a, b) for a, b in zip(got, want, strict=True))
    for shape in ((0, 5), (4, 0)):
        empty = torch.zeros(shape, requires_grad=True)
        out = ray_march(empty, empty, empty.detach(), 80.0)
        assert out.weight.shape == shape
        assert not out.depth.any()
        out.weight.sum().backward()
        assert empty.grad.shape == shape
