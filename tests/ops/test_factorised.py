"""The factorised matched filter against the direct sum, its adjoint, and hostile geometry.

Tolerances as in test_matched_filter.py. Interpolation adds the rounding of weights whose sum of
magnitudes is below 3 an axis, in up to two levels: relative errors of float32 stay below 1e-5,
and what adjoint and image differ by below 20 ulp.
"""

import os
import re
import signal as signals
import threading

import numpy as np
import pytest
import torch

from geraf2.ops import explain_method, matched_filter
from geraf2.scene import Grid
from helpers.synthetic import waveform_of, white_noise
from reference import matched_filter as reference
from reference.closeness import assert_adjoint

ONE_LEVEL, TWO_LEVELS = 70, 2000  # antennas; from 1536 on the plan takes two levels


GRID = Grid(origin_m=(-0.02, -0.013, -0.017), spacing_m=0.001, shape=(37, 21, 34))


def make_case(n_antennas, n_samples=8):
    """White noise; antennas scattered over a bent plane, each receiver somewhere beside."""
    rng = np.random.default_rng(0)
    y, z = rng.uniform(-0.07, 0.07, n_antennas), rng.uniform(-0.12, 0.12, n_antennas)
    tx = np.stack([-0.36 + 0.5 * y**2 + 0.2 * z, y, z], axis=1)
    rx = tx + rng.uniform(-0.01, 0.01, tx.shape)
    return white_noise((n_antennas, n_samples)), tx, rx, waveform_of(n_samples)


def image_of(case, grid=GRID, **options):
    signal, tx, rx, waveform = case
    return matched_filter(signal, tx, rx, grid, waveform, method="factorised", **options)


def direct_sum(case, grid, n_points=60):
    """The twin at voxels drawn at random; returns their flat indices too."""
    positions = np.random.default_rng(3).integers(0, grid.n_voxels, n_points)
    signal, tx, rx = (torch.from_numpy(np.asarray(a)) for a in case[:3])
    points = torch.from_numpy(grid.points()[positions])
    signal = signal.to(torch.complex128)
    return positions, reference.matched_filter(signal, tx, rx, points, case[3]).numpy()


def relative_error(image, case, grid=GRID):
    positions, want = direct_sum(case, grid)
    return np.linalg.norm(image.ravel()[positions] - want) / np.linalg.norm(want)


@pytest.mark.parametrize("n_antennas", [ONE_LEVEL, TWO_LEVELS])
@pytest.mark.parametrize(
    ("dtype", "tolerances", "rounding"),
    [(np.complex64, (1e-3, 1e-4, 1e-5), 1e-5), (np.complex128, (1e-3, 1e-4, 1e-8), 0.0)],
)
def test_image_is_that_of_the_float64_twin(n_antennas, dtype, tolerances, rounding, simd):
    signal, *rest = make_case(n_antennas)
    case = (signal.astype(dtype), *rest)
    for rtol in tolerances:
        image = image_of(case, rtol=rtol)
        assert image.dtype == dtype
        assert relative_error(image, case) < rtol / 2 + rounding


def test_transmitters_and_receivers_may_stand_far_apart():
    # An array of 30 transmitters and 60 receivers, all pairs: clusters are cut in both.
    rng = np.random.default_rng(1)
    t = np.stack([np.full(30, -0.3), rng.uniform(-0.1, 0.0, 30), np.full(30, 0.1)], axis=1)
    r = np.stack([np.full(60, -0.32), np.full(60, 0.1), rng.uniform(-0.1, 0.1, 60)], axis=1)
    tx, rx = np.repeat(t, 60, axis=0), np.tile(r, (30, 1))
    case = (make_case(1800)[0], tx, rx, waveform_of(8))
    assert relative_error(image_of(case, rtol=1e-4), case) < 1e-4


@pytest.mark.gradient
@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
@pytest.mark.parametrize("n_antennas", [ONE_LEVEL, TWO_LEVELS])
def test_backward_is_the_adjoint(n_antennas, dtype, simd):
    # Were image and adjoint different approximations, rtol = 1e-3 would leave about 1e-6.
    signal, tx, rx, waveform = make_case(n_antennas)
    x = torch.from_numpy(signal).to(dtype).requires_grad_(True)
    image = image_of((x, tx, rx, waveform))
    y = torch.from_numpy(white_noise(GRID.shape)).to(dtype)
    image.backward(y)
    assert_adjoint(x, image, y, x.grad)


@pytest.mark.gradient
def test_adjoint_of_boxes_left_to_the_block_method():
    signal, tx, rx, waveform = make_case(ONE_LEVEL)
    x = torch.from_numpy(signal).requires_grad_(True)
    near = [a + np.array([0.33, 0.0, 0.0]) for a in (tx, rx)]
    image = image_of((x, *near, waveform))
    y = torch.ones_like(image)
    image.backward(y)
    assert_adjoint(x, image, y, x.grad)
    assert relative_error(image.detach().numpy(), (signal, *near, waveform)) < 5e-4


@pytest.mark.gradient
def test_gradcheck_of_the_signal():
    signal, tx, rx, waveform = make_case(3, n_samples=5)
    x = torch.from_numpy(signal).requires_grad_(True)
    grid = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=0.001, shape=(20, 12, 17))
    assert torch.autograd.gradcheck(
        lambda s: image_of((s, tx, rx, waveform), grid), (x,), fast_mode=True
    )


@pytest.mark.gradient
def test_gradients_to_positions_are_those_of_exact():
    signal, tx, rx, waveform = make_case(5)
    grid = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=0.001, shape=(9, 9, 9))
    found = []
    for method in ("factorised", "exact"):
        t = torch.from_numpy(tx).requires_grad_(True)
        matched_filter(signal, t, rx, grid, waveform, method=method).real.sum().backward()
        found.append(t.grad)
    assert torch.equal(*found)


@pytest.mark.parametrize(
    ("n_antennas", "n_samples", "spacing_m", "shape"),
    [
        (1, 5, 0.001, (1, 1, 1)),
        (1, 5, 0.001, (20, 20, 20)),
        (17, 5, 0.001, (1, 70, 1)),
        (5, 5, 0.0001, (3, 90, 40)),
        (40, 5, 0.02, (5, 6, 7)),
        (60, 1, 0.001, (37, 21, 34)),
    ],
)
def test_odd_sizes(n_antennas, n_samples, spacing_m, shape):
    case = make_case(n_antennas, n_samples)
    grid = Grid(origin_m=(-0.01, -0.02, -0.03), spacing_m=spacing_m, shape=shape)
    image = image_of(case, grid, rtol=1e-6)
    assert image.shape == shape
    assert relative_error(image, case, grid) < 1e-6


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_a_grid_around_the_antennas(dtype, simd):
    # Voxels lie on antennas, and boxes near them are left to the block method.
    signal, tx, rx, waveform = make_case(30)
    tx[0] = (-0.36, 0.0, 0.0)
    grid = Grid(origin_m=(-0.40, -0.02, -0.02), spacing_m=0.004, shape=(50, 11, 11))
    case = (signal.astype(dtype), tx, rx, waveform)
    image = image_of(case, grid)
    assert np.isfinite(image).all()
    assert relative_error(image, case, grid) < 5e-4


def test_coincident_antennas_and_far_away_ones():
    signal, tx, rx, waveform = make_case(100)
    case = (signal, np.tile(tx[:1], (100, 1)), np.tile(rx[:1], (100, 1)), waveform)
    assert relative_error(image_of(case), case) < 5e-4
    # At 1e6 m double precision leaves a path 1e-10 m, 3e-7 rad.
    far = (signal, tx + 5e5, rx + 5e5, waveform)
    assert relative_error(image_of(far), far) < 5e-4


def test_a_nan_sample_spreads_over_the_image():
    case = make_case(TWO_LEVELS)
    case[0][3, 4] = complex(np.nan, 0.0)
    assert not np.isfinite(image_of(case)).any()


def test_little_memory_changes_rounding_only():
    signal, *rest = make_case(26_000, n_samples=3)
    case = (signal.astype(np.complex64), *rest)
    with pytest.raises(ValueError, match=r"max_memory must be at least \d+ MB .* got 1 MB") as seen:
        image_of(case, max_memory=1e6, num_threads=1)
    least = 1e6 * float(re.findall(r"at least (\d+) MB", str(seen.value))[0])
    roomy = image_of(case, num_threads=1)
    tight = image_of(case, num_threads=1, max_memory=least)
    assert not np.array_equal(roomy, tight)  # several portions of antennas
    assert np.linalg.norm(roomy - tight) < 1e-6 * np.linalg.norm(roomy)


@pytest.mark.parametrize("method", ["exact", "block", "factorised", "auto"])
def test_progress_rises_to_one(method):
    signal, tx, rx, waveform = make_case(ONE_LEVEL)
    seen = []
    got = matched_filter(signal, tx, rx, GRID, waveform, method=method, progress=seen.append)
    assert seen == sorted(seen)
    assert 0.0 < seen[0] <= seen[-1] == pytest.approx(1.0)
    assert np.array_equal(got, matched_filter(signal, tx, rx, GRID, waveform, method=method))


@pytest.mark.parametrize("method", ["block", "factorised"])
def test_an_interrupt_ends_a_long_call(method):
    signal, tx, rx, waveform = make_case(512)
    grid = Grid.cube((0.0, 0.0, 0.0), 0.05, 200)  # 4e9 pairs: seconds, if it is not stopped
    interrupt = threading.Timer(0.1, os.kill, (os.getpid(), signals.SIGINT))
    # A test run started in the background of a shell script inherits "ignore".
    before = signals.signal(signals.SIGINT, signals.default_int_handler)
    try:
        interrupt.start()
        with pytest.raises(KeyboardInterrupt):
            matched_filter(signal.astype(np.complex64), tx, rx, grid, waveform, method=method)
        interrupt.join()
    finally:
        signals.signal(signals.SIGINT, before)


def sparse_points(_):
    return np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3))


CHOICES = {
    "dense": (2000, lambda grid: grid, "factorised", r"factorised costs about \d+ times less"),
    "list": (2000, Grid.points, "block", "factorised needs a Grid"),
    "few": (20, lambda grid: grid, "block", "too few for factorised to pay"),
    "coarse": (
        300,
        lambda _: Grid.cube((0, 0, 0), 0.9, 20),
        "exact",
        "too few of the points lie within a block",
    ),
    "scattered": (300, sparse_points, "exact", "too few of the points lie within a block"),
}


@pytest.mark.parametrize("name", CHOICES)
def test_auto_takes_the_form_that_it_reports(name):
    n_antennas, points_of, method, reason = CHOICES[name]
    signal, tx, rx, waveform = make_case(n_antennas)
    points = points_of(GRID)
    choice = explain_method(tx, rx, points, waveform, dtype=np.complex128)
    assert choice.method == method
    assert re.search(reason, choice.reason)
    got = matched_filter(signal, tx, rx, points, waveform)
    assert np.array_equal(got, matched_filter(signal, tx, rx, points, waveform, method=method))


def test_auto_reports_the_number_of_voxels_that_are_too_near():
    _, tx, rx, waveform = make_case(20_000, n_samples=1)
    grid = Grid(origin_m=(-0.36, -0.05, -0.05), spacing_m=0.001, shape=(400, 40, 40))
    choice = explain_method(tx, rx, grid, waveform)
    assert "% of the voxels are too near the antennas" in choice.reason
