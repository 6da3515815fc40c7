"""A plan of one geometry: the images of `matched_filter`, its adjoint, and wrong use.

Tolerances are those of test_matched_filter.py.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import geraf2
from geraf2.scene import Grid
from helpers.antennas import scattered
from helpers.synthetic import WAVEFORM, white_noise
from reference.closeness import assert_adjoint

N_ANTENNAS = 41
RNG = np.random.default_rng(3)
TX, RX = scattered(RNG, N_ANTENNAS, -0.36, 0.01)
GRID = Grid.cube((0.0, 0.0, 0.0), 0.02, 9)
LIST = RNG.uniform(-0.02, 0.02, (130, 3))


def make_plan(points, dtype=np.complex128, **options):
    return geraf2.MatchedFilterPlan(TX, RX, points, WAVEFORM, dtype=dtype, **options)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize(
    ("method", "points"), [("exact", LIST), ("block", GRID), ("auto", LIST), ("factorised", GRID)]
)
def test_execution_gives_the_bits_of_the_function(method, points, dtype):
    plan = make_plan(points, dtype, method=method)
    signal = white_noise(plan.signal_shape, dtype)
    once = geraf2.matched_filter(signal, TX, RX, points, WAVEFORM, method=method)
    for _ in range(2):
        np.testing.assert_array_equal(plan.execute(signal), once)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize(
    ("method", "points"),
    [*((m, p) for m in ("exact", "block") for p in (GRID, LIST)), ("factorised", GRID)],
)
def test_the_adjoint_is_the_adjoint(method, points, dtype):
    plan = make_plan(points, dtype, method=method)
    signal, image = white_noise(plan.signal_shape, dtype), white_noise(plan.image_shape, dtype)
    assert_adjoint(signal, plan.execute(signal), image, plan.adjoint(image), ulp=50)


def test_threads_may_share_a_plan():
    plan = make_plan(GRID, num_threads=1)
    signals = [k * white_noise(plan.signal_shape, np.complex128) for k in (1, 2, 3, 4)]
    with ThreadPoolExecutor(4) as pool:
        images = list(pool.map(plan.execute, signals))
    for signal, image in zip(signals, images, strict=True):
        np.testing.assert_array_equal(image, plan.execute(signal))
