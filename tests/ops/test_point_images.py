"""Several signals imaged in one call: the matched filter's own images, one by one."""

import numpy as np
import pytest
import torch

from geraf2.ops import matched_filter
from geraf2.ops.point_images import point_images
from helpers.synthetic import WAVEFORM, point_pose

POSE = point_pose(0.0, n_side=5, spacing_m=0.02)
POSITIONS = POSE.tx_positions, POSE.rx_positions


def case(dtype, n_points):
    rng = np.random.default_rng(0)
    signal = rng.normal(size=(4, len(POSE.signal), 2 * WAVEFORM.n_samples)).view(np.complex128)
    points = rng.uniform(-0.1, 0.1, (n_points, 3))
    return torch.from_numpy(signal).to(dtype), points


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
@pytest.mark.parametrize("n_points", [1, 130])
def test_images_and_gradients_are_those_of_the_exact_method(dtype, n_points):
    signals, points = case(dtype, n_points)
    signals.requires_grad_()
    want = torch.stack(
        [matched_filter(s, *POSITIONS, points, WAVEFORM, method="exact") for s in signals]
    )
    weight = torch.randn(want.shape, generator=torch.Generator().manual_seed(0), dtype=dtype)
    (slope,) = torch.autograd.grad((want[:3] * weight[:3]).real.sum(), signals)
    for num_threads in (1, 3):
        got = point_images(
            *(signals[:3], signals[3:], *POSITIONS, points, WAVEFORM), num_threads=num_threads
        )
        torch.testing.assert_close(torch.cat(got), want, rtol=1e-5, atol=1e-5)
        (found,) = torch.autograd.grad((got.of_signals * weight[:3]).real.sum(), signals)
        torch.testing.assert_close(found, slope, rtol=1e-5, atol=1e-5 * float(slope.abs().max()))
        assert not got.of_others.requires_grad


@pytest.mark.gradient
def test_images_and_their_gradient_are_adjoint():
    signals, points = case(torch.complex128, 21)
    images = point_images(signals.requires_grad_(), signals[:0], *POSITIONS, points, WAVEFORM)
    weight = torch.randn(images.of_signals.shape, dtype=torch.complex128)
    (back,) = torch.autograd.grad(images.of_signals, signals, weight)
    one = torch.vdot(weight.reshape(-1), images.of_signals.detach().reshape(-1))
    other = torch.vdot(back.reshape(-1), signals.detach().reshape(-1))
    torch.testing.assert_close(one, other)
