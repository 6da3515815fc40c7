"""Stated against achieved error of the matched filter, over its whole range of tolerances.

One antenna's one sample makes the image that sample's phasor, so its error is the error that `rtol`
states. The last sample and an antenna at the rim are the worst. float32 adds 64 ulp of a phasor,
4e-6, and the rounding of a reference phase of 8 half turns, 1.5e-6 (test_matched_filter.py).
Interpolation weighs such phasors by weights whose magnitudes sum to less than 3 an axis.
"""

import numpy as np
import pytest

from geraf2.ops import matched_filter
from geraf2.scene import Grid
from helpers.antennas import scattered
from helpers.synthetic import waveform_of

TOLERANCES = np.logspace(-1, -10, 28)
GRID = Grid(origin_m=(-0.02, -0.013, -0.017), spacing_m=0.001, shape=(37, 21, 34))
ROUNDING = {
    ("block", np.complex64): 1e-5,
    ("factorised", np.complex64): 5e-5,
    ("block", np.complex128): 1e-12,
    ("factorised", np.complex128): 1e-11,
}


@pytest.fixture(scope="module")
def aperture():
    """Antennas, the loudest of them, and its phasors on the grid."""
    n, waveform = 300, waveform_of(8)
    tx, rx = scattered(np.random.default_rng(1), n, -0.36, 0.005)
    one = int(np.argmax(np.abs(tx[:, 1:]).sum(axis=1)))
    signal = np.zeros((n, waveform.n_samples), dtype=np.complex128)
    signal[one, -1] = n
    alone = (signal[one : one + 1] / n, tx[one : one + 1], rx[one : one + 1])
    return signal, tx, rx, waveform, matched_filter(*alone, GRID, waveform, method="exact")


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize("method", ["block", "factorised"])
def test_the_achieved_error_is_below_the_stated_one_at_every_tolerance(method, dtype, aperture):
    signal, tx, rx, waveform, exact = aperture
    achieved, rounding = [], ROUNDING[method, dtype]
    for rtol in TOLERANCES:
        image = matched_filter(
            signal.astype(dtype), tx, rx, GRID, waveform, method=method, rtol=rtol
        )
        achieved.append(float(np.abs(image - exact).max()))
    assert (np.array(achieved) < TOLERANCES + rounding).all(), achieved
    # A tolerance ten times smaller never gives a larger error, and ten of them give a smaller one.
    later, earlier = np.array(achieved[3:]), np.array(achieved[:-3])
    assert (later <= np.maximum(earlier, rounding)).all(), achieved
    assert achieved[-1] < max(1e-6 * achieved[0], rounding)
