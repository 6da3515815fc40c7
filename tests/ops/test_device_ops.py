"""The ops of a training step in torch alone: the kernels' results, on whatever device they get."""

import numpy as np
import pytest
import torch

from geraf2.ops import EchoForm, _device_ops, _tensors, ray_march, sdf_grid
from geraf2.ops.lensless import echo_amplitudes, facing_samples, length_defect, trace_pairs
from geraf2.ops.point_images import point_images
from geraf2.scene import Grid
from geraf2.surfaces.clusters import antenna_clusters
from helpers.synthetic import WAVEFORM, point_pose

POSE = point_pose(0.0, n_side=4, spacing_m=0.02)
POSITIONS = POSE.tx_positions, POSE.rx_positions
GROUPS = antenna_clusters(POSE.phase_centers, 3)
CENTERS = np.stack([POSE.phase_centers[g].mean(axis=0) for g in GROUPS])
FORMS = [
    EchoForm(centers=CENTERS, lobe_power=4.0, two_way_power=2),
    EchoForm(centers=CENTERS, lobe_power=8.0, references=np.array([0.4, 0.41, 0.39])),
    EchoForm(centers=CENTERS, lobe_power=1.5),
    EchoForm(centers=CENTERS),
]
GRID = Grid(origin_m=(-0.06, -0.05, -0.04), spacing_m=0.02, shape=(7, 5, 4))


DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def random(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64)


def both_directions(monkeypatch, call, inputs, device):
    """Results and gradients of `call` with the kernels, then without on a device."""
    found = []
    for kernels in (True, False):
        with monkeypatch.context() as patched:
            patched.setattr(_tensors, "has_kernels", lambda *_, kernels=kernels: kernels)
            mine = [x.to("cpu" if kernels else device, copy=True).requires_grad_() for x in inputs]
            out = call(*mine)
        total = sum(
            (torch.view_as_real(o) if o.is_complex() else o).mul(w).sum()
            for number, o in enumerate(out)
            for w in [random(*(o.shape + (2,) * o.is_complex()), seed=number).to(o.device)]
        )
        slopes = torch.autograd.grad(total, mine, allow_unused=True)
        found.append([o.detach().cpu() for o in (*out, *slopes)])
    assert len(found[0]) == len(found[1])
    return found


def agree(monkeypatch, call, inputs, device, rtol=1e-9):
    for want, got in zip(*both_directions(monkeypatch, call, inputs, device), strict=True):
        assert float(want.abs().max()) > 0.0
        torch.testing.assert_close(got, want, rtol=rtol, atol=rtol * float(want.abs().max()))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_grid_values_gradients_and_second_derivatives(monkeypatch, interpolation, device):
    points = 0.05 * random(60, 3) * torch.tensor([1.4, 1.2, 1.0])  # some beyond the rim

    def call(values, points):
        value, gradient = sdf_grid(values, GRID, points, interpolation=interpolation)
        (slope,) = torch.autograd.grad(value.square().sum(), points, create_graph=True)
        return value, gradient, (gradient.norm(dim=1) - 1.0).square(), slope

    # trilinear has no second derivative along an axis: both give zeros there
    agree(monkeypatch, call, [random(*GRID.shape), points], device)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("two_way", ["squared", "unbiased"])
def test_marches(monkeypatch, two_way, device):
    sdf, step = 0.04 * random(9, 12), 0.004 + 0.002 * torch.rand(9, 12).double()

    def call(sdf, cos, inv_s):
        return ray_march(sdf, cos, step.to(sdf.device), inv_s, two_way=two_way)

    agree(monkeypatch, call, [sdf, random(9, 12, seed=1), torch.tensor(150.0).double()], device)


def samples(n_rays=7, n_samples=6):
    n = n_rays * n_samples
    alpha = torch.rand(n_rays, n_samples, generator=torch.Generator().manual_seed(2)).double()
    alpha[alpha < 0.2] = 0.0
    gradient = 0.6 * random(n, 3) + torch.tensor([1.0, 0.0, 0.0])
    return alpha, 0.2 + 0.8 * alpha.flip(0), gradient, (0.04 * random(n, 3, seed=4)).numpy()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("form", FORMS)
def test_pairs_amplitudes_and_signals(monkeypatch, form, device):
    alpha, transmittance, gradient, points = samples()
    pairs = facing_samples(alpha, gradient, points, form, n_looks=3)
    alone = _device_ops.facing_samples(alpha, gradient, points, form, 3)
    np.testing.assert_array_equal(alone[0], pairs.sample)
    np.testing.assert_array_equal(alone[1], pairs.offsets)
    assert len(pairs.sample) > 20
    monkeypatch.setattr(_device_ops, "_PHASORS", 2**12)  # several portions
    shift = 0.3 * random(len(pairs.sample), seed=5)

    def call(alpha, transmittance, gradient):
        amplitude, normals = echo_amplitudes(
            alpha, transmittance, gradient, points, pairs, shift.to(alpha.device), form
        )
        signal = trace_pairs(
            *(amplitude, points, normals, pairs, *POSITIONS, GROUPS, WAVEFORM), rtol=1e-12
        )
        return amplitude, normals, signal

    # the tracer sums in blocks, whose error `rtol` bounds
    agree(monkeypatch, call, [alpha, transmittance, gradient], device, rtol=1e-8)


@pytest.mark.parametrize("device", DEVICES)
def test_images_and_lengths(monkeypatch, device):
    others, points = torch.view_as_complex(random(2, 16, 32, 2, seed=7)), 0.1 * random(90, 3)
    monkeypatch.setattr(_device_ops, "_PHASORS", 2**14)

    def call(parts, lengths):
        signals = torch.view_as_complex(parts)
        images = point_images(
            signals, others.to(signals.device), *POSITIONS, points.numpy(), WAVEFORM
        )
        assert not images.of_others.requires_grad
        return *images, length_defect(lengths)

    agree(monkeypatch, call, [random(3, 16, 32, 2), random(50, 3, seed=8)], device)


@pytest.mark.parametrize("device", DEVICES)
def test_single_precision_is_that_of_the_kernels(monkeypatch, device):
    alpha, transmittance, gradient, points = samples()
    pairs = facing_samples(alpha, gradient, points, FORMS[0], n_looks=2)
    amplitude, normals = (
        t.float()
        for t in echo_amplitudes(
            *(alpha, transmittance, gradient, points, pairs),
            torch.zeros(len(pairs.sample), dtype=torch.float64),
            FORMS[0],
        )
    )

    def call(amplitude, normals):
        return [trace_pairs(amplitude, points, normals, pairs, *POSITIONS, GROUPS, WAVEFORM)]

    agree(monkeypatch, call, [amplitude, normals], device, rtol=1e-3)


def test_nothing_is_made_on_another_device_than_the_inputs():
    """Tensors of the device `meta` hold no numbers, but refuse to be mixed with others."""
    alpha, transmittance, gradient, points = samples()
    form = FORMS[1]
    pairs = facing_samples(alpha, gradient, points, form, n_looks=2)
    shift = torch.zeros(len(pairs.sample), device="meta", dtype=torch.float64)
    leaves = [
        t.to("meta").requires_grad_()
        for t in (alpha, transmittance, gradient, random(*GRID.shape), torch.tensor(90.0).double())
    ]
    amplitude, normals = echo_amplitudes(*leaves[:3], points, pairs, shift, form)
    signal = trace_pairs(amplitude, points, normals, pairs, *POSITIONS, GROUPS, WAVEFORM)
    images = point_images(signal, signal.detach(), *POSITIONS, points, WAVEFORM)
    value, slope = sdf_grid(leaves[3], GRID, points, interpolation="cubic")
    march = ray_march(value.reshape(7, 6), slope[:, 0].reshape(7, 6), leaves[0].detach(), leaves[4])
    out = [images.of_signals.abs().sum(), length_defect(slope), *(part.sum() for part in march)]
    assert {o.device.type for o in out} == {"meta"}
    grads = torch.autograd.grad(sum(out), leaves)
    assert all(g.shape == leaf.shape for g, leaf in zip(grads, leaves, strict=True))
