"""Matched filter against its slow twin, its adjoint and finite differences.

Tolerances. float32: a block's carrier phase is at most 8 half turns, one ulp of which is 1.5e-6
rad, and the phasor recurrence is seeded afresh every 64 samples, 64 ulp = 4e-6: relative errors
stay below 1e-5. float64: the same counts with an ulp of 2e-16, and 2e3 rad of reference phase, an
ulp of which is 2e-13: 1e-11 covers a hundred of them. Block method: the error of every phasor is
below rtol, hence of white noise too, about ten times so.
"""

import numpy as np
import pytest
import torch

from geraf2.ops import matched_filter
from geraf2.scene import Grid
from helpers.antennas import scattered
from helpers.synthetic import waveform_of, white_noise
from reference import matched_filter as reference
from reference.closeness import assert_adjoint, assert_close, relative_error

METHODS = ("exact", "block", "auto")


def make_case(n_antennas=37, n_samples=32, n_points=200, spread_m=0.02, seed=0):
    """White noise, bistatic antennas scattered over a plane 0.36 m away, points in a cube."""
    rng = np.random.default_rng(seed)
    tx, rx = scattered(rng, n_antennas, -0.36, 0.01)
    points = rng.uniform(-spread_m, spread_m, (n_points, 3))
    return (
        torch.from_numpy(white_noise((n_antennas, n_samples), seed=seed)),
        torch.from_numpy(tx),
        torch.from_numpy(rx),
        torch.from_numpy(points),
        waveform_of(n_samples),
    )


@pytest.mark.parametrize("n_samples", [1, 2, 31, 32, 200])
@pytest.mark.parametrize("method", METHODS)
def test_float64_image_is_that_of_the_twin(method, n_samples, simd):
    case = make_case(n_samples=n_samples)
    got = matched_filter(*case, method=method, rtol=1e-8)
    assert relative_error(got, reference.matched_filter(*case)) < (
        1e-11 if method == "exact" else 1e-8
    )


@pytest.mark.parametrize("method", METHODS)
def test_float32_image_is_that_of_the_float64_twin(method, simd):
    case = make_case(n_points=400)
    got = matched_filter(case[0].to(torch.complex64), *case[1:], method=method, rtol=1e-5)
    assert got.dtype == torch.complex64
    want = reference.matched_filter(case[0].to(torch.complex64).to(torch.complex128), *case[1:])
    assert_close(got, want, element=5e-5, norm=2e-6, cosine=1e-9, bias=2e-6)


@pytest.mark.parametrize("method", METHODS)
def test_grid_is_the_same_as_its_points(method):
    signal, tx, rx, _, waveform = make_case()
    grid = Grid(origin_m=(-0.01, 0.0, 0.005), spacing_m=0.0013, shape=(11, 1, 14))
    got = matched_filter(signal, tx, rx, grid, waveform, method=method, rtol=1e-6)
    want = matched_filter(signal, tx, rx, grid.points(), waveform, method="exact")
    assert got.shape == grid.shape
    assert relative_error(got.reshape(-1), want) < 1e-6


def test_auto_mixes_dense_and_scattered_points():
    signal, tx, rx, dense, waveform = make_case(n_points=500, spread_m=0.005)
    scattered = make_case(n_points=150, spread_m=0.3, seed=1)[3]
    order = torch.randperm(650, generator=torch.Generator().manual_seed(0))
    points = torch.cat([dense, scattered])[order]
    got = matched_filter(signal, tx, rx, points, waveform, method="auto", rtol=1e-6)
    want = reference.matched_filter(signal, tx, rx, points, waveform)
    assert relative_error(got, want) < 1e-6


def test_coarse_grid_and_crowded_cell():
    signal, tx, rx, points, waveform = make_case(n_points=2500, spread_m=0.001)
    coarse = Grid.cube((0.0, 0.0, 0.0), 0.1, 5)
    for where in (points, coarse):
        rows = torch.from_numpy(where.points()) if isinstance(where, Grid) else where
        want = reference.matched_filter(signal, tx, rx, rows, waveform)
        for method in METHODS:
            got = matched_filter(signal, tx, rx, where, waveform, method=method, rtol=1e-6)
            assert relative_error(got.reshape(-1), want) < 1e-6


def adjoint(case, image, **options):
    signal = torch.zeros_like(case[0]).requires_grad_(True)
    matched_filter(signal, *case[1:], **options).backward(image)
    return signal.grad


@pytest.mark.gradient
@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
@pytest.mark.parametrize("n_samples", [1, 31, 32, 200])
@pytest.mark.parametrize("method", METHODS)
def test_backward_is_the_adjoint(method, n_samples, dtype, simd):
    # Forward and adjoint use the same approximation, so only rounding may part them: each side is
    # a sum of products whose relative errors, below 100 ulp each, have random signs and shrink by
    # the root of the number of terms (here 200 points or more): 20 ulp of |A x| |y|. Were the
    # approximations different, rtol = 1e-3 would leave about 1e-5.
    case = make_case(n_samples=n_samples)
    x, y = case[0].to(dtype), torch.from_numpy(white_noise(200)).to(dtype)
    image = matched_filter(x, *case[1:], method=method)
    assert_adjoint(x, image, y, adjoint((x, *case[1:]), y, method=method))


@pytest.mark.gradient
def test_adjoint_near_an_antenna_uses_the_same_guard():
    case = make_case(n_points=200)
    near = (case[0], case[1] + torch.tensor([0.345, 0.0, 0.0]), case[2], *case[3:])
    y = torch.from_numpy(white_noise(200))
    image = matched_filter(*near, method="block")
    assert_adjoint(near[0], image, y, adjoint(near, y, method="block"))


@pytest.mark.gradient
@pytest.mark.parametrize("method", METHODS)
def test_gradcheck_of_the_signal(method):
    # 2 mm wide, so that all points share one block
    signal, *geometry = make_case(n_antennas=3, n_samples=5, n_points=7, spread_m=0.001)
    assert torch.autograd.gradcheck(
        lambda s: matched_filter(s, *geometry, method=method, num_threads=1),
        (signal.requires_grad_(True),),
    )


@pytest.mark.gradient
@pytest.mark.parametrize("n_samples", [1, 4, 5])
def test_gradcheck_of_the_positions(n_samples):
    signal, tx, rx, points, waveform = make_case(n_antennas=3, n_samples=n_samples, n_points=3)
    inputs = [t.requires_grad_(True) for t in (signal, tx, rx, points)]
    # A step of 1e-7 m turns the phase by 3e-4 rad: truncation 2e-8, rounding 1e-9 of the slope.
    assert torch.autograd.gradcheck(
        lambda *args: matched_filter(*args, waveform, method="exact", num_threads=1),
        inputs,
        eps=1e-7,
        atol=1e-3,  # slopes are of the order of 1e4
        rtol=1e-6,
    )


def gradients(case, image_grad, **options):
    inputs = [t.clone().requires_grad_(True) for t in case[:4]]
    matched_filter(*inputs, case[4], **options).backward(image_grad)
    return [t.grad for t in inputs]


@pytest.mark.gradient
@pytest.mark.parametrize("method", METHODS)
def test_float32_gradients_are_those_of_the_float64_twin(method, simd):
    case = make_case(n_antennas=40, n_points=150)
    image_grad = torch.from_numpy(white_noise(150))
    single = [case[0].to(torch.complex64), *(t.float() for t in case[1:4]), case[4]]
    got = gradients(single, image_grad.to(torch.complex64), method=method, rtol=1e-5)
    # The twin sees the rounded positions: a float32 ulp of 0.36 m is 3e-8 m, or 1e-4 rad.
    inputs = [t.to(torch.complex128 if t.is_complex() else torch.float64) for t in single[:4]]
    inputs = [t.requires_grad_(True) for t in inputs]
    reference.matched_filter(*inputs, case[4]).backward(image_grad)
    for have, want, name in zip(got, inputs, ("signal", "tx", "rx", "points"), strict=True):
        assert have.dtype == (torch.complex64 if name == "signal" else torch.float32)
        assert_close(have, want.grad, element=1e-4, norm=5e-6, cosine=1e-9, bias=5e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
def test_point_on_an_antenna(method, dtype, simd):
    # In the block method the point, the block's centre and the transmitter all coincide.
    signal, tx, rx, _, waveform = make_case(n_antennas=5)
    case = (signal.to(dtype), tx, rx, tx[:1].clone(), waveform)
    got = matched_filter(*case, method=method)
    assert relative_error(got, reference.matched_filter(signal, *case[1:]).to(dtype)) < 1e-3
    found = gradients(case, torch.ones(1, dtype=dtype), method=method)
    assert all(torch.isfinite(grad).all() for grad in found)
    # Moving both legs of the other antennas still moves the point's gradient; its own does not.
    assert not found[1][0].any()
    assert found[2][0].any()


def test_strides_and_conjugate_views_change_nothing():
    signal, tx, rx, points, waveform = make_case()
    want = matched_filter(signal, tx, rx, points, waveform)
    strided = torch.empty((32, 37), dtype=torch.complex128).T
    strided.copy_(signal)
    view = signal.conj().resolve_conj().conj()
    assert view.is_conj()
    rows = torch.empty((3, 200), dtype=torch.float64).T
    rows.copy_(points)
    reversed_rx = rx.numpy()[::-1]
    for s, p in ((strided, points), (view, points), (signal, rows)):
        assert torch.equal(matched_filter(s, tx, rx, p, waveform), want)
    flipped = matched_filter(
        signal.flip(0), tx.flip(0), np.ascontiguousarray(reversed_rx), points, waveform
    )
    assert torch.equal(
        matched_filter(signal.flip(0), tx.flip(0), rx.flip(0), points, waveform), flipped
    )


@pytest.mark.gradient
def test_strided_and_conjugate_gradients_arrive():
    case = make_case(n_points=12)
    image_grad = torch.from_numpy(white_noise(12))
    want = adjoint(case, image_grad)
    spread = torch.empty((12, 2), dtype=torch.complex128)[:, 0]
    spread.copy_(image_grad)
    view = image_grad.conj().resolve_conj().conj()
    assert torch.equal(adjoint(case, spread), want)
    assert torch.equal(adjoint(case, view), want)


@pytest.mark.data
def test_block_agrees_with_exact_on_a_capture(shared_data):
    # Echoes, unlike white noise, add up: the error is small beside the brightest voxel as well.
    frame = shared_data / "spot_carton" / "mf" / "0_0_0"
    load = {
        name: np.load(frame / f"{name}.npy", allow_pickle=False)
        for name in ("tpos", "rpos", "adcr", "adci")
    }
    signal = (load["adcr"] + 1j * load["adci"]).astype(np.complex64)
    grid = Grid.cube((0.0, 0.0, 0.0), 0.06, 21)
    block, exact = (
        matched_filter(signal, load["tpos"], load["rpos"], grid, waveform_of(), method=method)
        for method in ("block", "exact")
    )
    assert np.linalg.norm(block - exact) < 5e-4 * np.linalg.norm(exact)
    assert np.abs(block - exact).max() < 5e-4 * np.abs(exact).max()
