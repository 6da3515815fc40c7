"""Matched filter against its slow twin, its adjoint, finite differences and hostile input."""

import numpy as np
import pytest
import torch

from geraf2.ops import matched_filter
from geraf2.scene import Waveform
from reference import matched_filter as reference

METHODS = ("exact", "block", "auto")


def make_waveform(n_samples=32, path_bias_m=0.15):
    return Waveform(
        start_frequency_hz=77.3704e9,
        chirp_slope_hz_per_s=70.15e12,
        sample_rate_hz=10e6 * n_samples / 512,
        n_samples=n_samples,
        path_bias_m=path_bias_m,
    )


def make_case(n_antennas=37, n_samples=32, n_points=200, spread_m=0.02, seed=0):
    """White noise, bistatic antennas scattered over a plane 0.36 m away, points in a cube."""
    rng = np.random.default_rng(seed)
    tx = np.stack(
        [
            np.full(n_antennas, -0.36),
            rng.uniform(-0.07, 0.07, n_antennas),
            rng.uniform(-0.12, 0.12, n_antennas),
        ],
        axis=1,
    )
    rx = tx + rng.uniform(-0.01, 0.01, tx.shape)
    points = rng.uniform(-spread_m, spread_m, (n_points, 3))
    signal = rng.normal(size=(n_antennas, n_samples)) + 1j * rng.normal(
        size=(n_antennas, n_samples)
    )
    return (
        torch.from_numpy(signal),
        torch.from_numpy(tx),
        torch.from_numpy(rx),
        torch.from_numpy(points),
        make_waveform(n_samples),
    )


def relative_error(got, want):
    return float((got.to(want.dtype) - want).norm() / want.norm())


@pytest.mark.parametrize("n_samples", [1, 2, 31, 32, 200])
@pytest.mark.parametrize("method", METHODS)
def test_float64_image_is_that_of_the_twin(method, n_samples):
    case = make_case(n_samples=n_samples)
    got = matched_filter(*case, method=method, rtol=1e-8)
    # Exact: rounding of 2e3 rad, 1e-13 each. Block: every phasor is within rtol.
    tolerance = 1e-11 if method == "exact" else 1e-8
    assert relative_error(got, reference.matched_filter(*case)) < tolerance
