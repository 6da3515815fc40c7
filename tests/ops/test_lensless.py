"""Amplitudes of lensless rendering against their slow twin; pairs traced in one call, in many."""

import numpy as np
import pytest
import torch

from geraf2.ops import EchoForm, signal_tracer
from geraf2.ops.lensless import (
    echo_amplitudes,
    facing_samples,
    length_defect,
    sample_rays,
    trace_pairs,
)
from geraf2.surfaces.clusters import antenna_clusters
from helpers.synthetic import WAVEFORM, point_pose
from reference import lensless as reference

POSE = point_pose(0.0, n_side=5, spacing_m=0.02)
GROUPS = antenna_clusters(POSE.phase_centers, 3)
CENTERS = np.stack([POSE.phase_centers[g].mean(axis=0) for g in GROUPS])
FORMS = [
    {"lobe_power": 4.0, "two_way_power": 2},
    {"lobe_power": 8.0, "two_way_power": 1, "references": np.array([0.4, 0.41, 0.39])},
    {"lobe_power": 1.0, "two_way_power": 2},
    {"lobe_power": 1.5, "two_way_power": 1},
]


def case(dtype=torch.float64, n_rays=9, n_samples=7):
    rng = np.random.default_rng(3)
    n = n_rays * n_samples
    alpha = rng.uniform(0.0, 1.0, (n_rays, n_samples)) * (
        rng.uniform(size=(n_rays, n_samples)) > 0.3
    )
    gradient = rng.normal(size=(n, 3)) * 0.6 + np.array([1.0, 0.0, 0.0])
    points = rng.uniform(-0.05, 0.05, (n, 3))
    samples = [
        torch.from_numpy(a).to(dtype) for a in (alpha, rng.uniform(size=alpha.shape), gradient)
    ]
    return *samples, points


def pairs_of(alpha, gradient, points, form, n_looks=2):
    pairs = facing_samples(alpha, gradient, points, form, n_looks=n_looks)
    rng = np.random.default_rng(4)
    shift = torch.from_numpy(rng.normal(size=len(pairs.sample)) * 0.3).to(alpha.dtype)
    return pairs, shift


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float64, 1e-15), (torch.float32, 3e-8)])
def test_rays_are_cut_at_the_jitter(dtype, atol):
    rng = np.random.default_rng(5)
    origins, near, jitter = rng.normal(size=(4, 3)), rng.uniform(size=4), rng.uniform(size=(4, 9))
    far, direction = near + rng.uniform(0.1, 0.3, 4), np.array([0.6, 0.0, -0.8])
    got = sample_rays(origins, direction, near, far, jitter, dtype=dtype, num_threads=2)
    depth = (np.arange(9) + jitter) / 9 * (far - near)[:, None]
    starts = origins + near[:, None] * direction
    middle = 0.5 * (depth[:, 1:] + depth[:, :-1])
    points = starts[:, None] + middle[..., None] * direction
    for found, want in zip(got, (starts, points, np.diff(depth), depth[:, 0]), strict=True):
        assert found.dtype == dtype
        np.testing.assert_allclose(found, want, rtol=2 * torch.finfo(dtype).eps, atol=atol)


@pytest.mark.parametrize("lobe_power", [1.0, 4.0])
@pytest.mark.parametrize("n_looks", [1, 3])
def test_samples_that_face_a_group_are_found_look_by_look(lobe_power, n_looks):
    alpha, _, gradient, points = case()
    form = EchoForm(centers=CENTERS, lobe_power=lobe_power)
    pairs = facing_samples(alpha, gradient, points, form, n_looks=n_looks)
    want, offsets = [], [0]
    for center in CENTERS:
        for look in range(n_looks):
            for i in range(len(points)):
                ray, position = divmod(i, alpha.shape[1])
                leg = points[i] - center
                cosine = gradient[i].numpy() @ leg / np.linalg.norm(leg)
                cosine /= np.linalg.norm(gradient[i].numpy())
                faces = lobe_power == 1.0 or 2.0 * cosine**2 > 1.0
                if alpha.reshape(-1)[i] != 0.0 and faces and (position + 5 * ray) % n_looks == look:
                    want.append(i)
            offsets.append(len(want))
    assert pairs.sample.tolist() == want
    assert pairs.offsets.tolist() == offsets
    assert 0 < len(want) < len(CENTERS) * np.count_nonzero(alpha) + (lobe_power == 1.0)
    again = facing_samples(alpha, gradient, points, form, n_looks=n_looks, num_threads=3)
    np.testing.assert_array_equal(again.sample, pairs.sample)


def twin(alpha, transmittance, gradient, points, pairs, shift, form):
    amplitudes, normals = [], []
    for part, (begin, end) in enumerate(zip(pairs.offsets[:-1], pairs.offsets[1:], strict=True)):
        group, of = part // pairs.n_looks, torch.from_numpy(pairs.sample[begin:end])
        references = form.references
        a, n = reference.amplitudes(
            alpha.reshape(-1)[of],
            transmittance.reshape(-1)[of],
            gradient[of],
            torch.from_numpy(points).to(alpha.dtype)[of],
            shift[begin:end],
            torch.from_numpy(form.centers[group]).to(alpha.dtype),
            {
                "lobe_power": form.lobe_power,
                "two_way_power": form.two_way_power,
                "reference": None if references is None else float(references[group]),
            },
        )
        amplitudes.append(a)
        normals.append(n)
    return torch.cat(amplitudes), torch.cat(normals)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("dtype", "rtol"), [(torch.float64, 1e-12), (torch.float32, 3e-5)])
def test_amplitudes_and_their_gradients_are_those_of_the_twin(form, dtype, rtol):
    form = EchoForm(centers=CENTERS, **form)
    *tensors, points = case(dtype)
    tensors[2][5] = 1e-8 * tensors[2][5]  # a gradient too short to have a direction
    pairs, shift = pairs_of(tensors[0], tensors[2], points, form)
    weights, found = None, []
    for method in (echo_amplitudes, twin):
        inputs = [t.clone().requires_grad_() for t in tensors]
        amplitude, normals = method(*inputs, points, pairs, shift, form)
        if weights is None:
            generator = torch.Generator().manual_seed(0)
            weights = [
                torch.randn(t.shape, generator=generator, dtype=dtype) for t in (amplitude, normals)
            ]
        total = (amplitude * weights[0]).sum() + (normals * weights[1]).sum()
        found.append([amplitude.detach(), normals.detach(), *torch.autograd.grad(total, inputs)])
    assert (found[1][0] == 0.0).any()  # some are shifted to nothing
    for got, want in zip(*found, strict=True):
        torch.testing.assert_close(got, want, rtol=rtol, atol=rtol * float(want.abs().max()))


@pytest.mark.gradient
@pytest.mark.parametrize("form", FORMS)
def test_amplitudes_have_the_gradient_that_differences_show(form):
    form = EchoForm(centers=CENTERS, **form)
    alpha, transmittance, gradient, points = case(n_rays=3, n_samples=4)
    pairs, shift = pairs_of(alpha, gradient, points, form)
    inputs = [t.requires_grad_() for t in (alpha, transmittance, gradient)]
    # where a clamp or the lobe begins there is no derivative; 1e-6 away there is
    assert torch.autograd.gradcheck(
        lambda *x: echo_amplitudes(*x, points, pairs, shift, form), inputs
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("n_looks", [1, 3])
def test_pairs_traced_in_one_call_are_those_traced_part_by_part(dtype, n_looks):
    alpha, _, gradient, points = case(dtype, n_rays=40)
    form = EchoForm(centers=CENTERS, lobe_power=4.0)
    pairs, amplitude = pairs_of(alpha, gradient, points, form, n_looks)
    normals = torch.nn.functional.normalize(gradient, dim=1)[torch.from_numpy(pairs.sample)]
    inputs = [amplitude.requires_grad_(), normals.requires_grad_()]
    positions = POSE.tx_positions, POSE.rx_positions

    def part_by_part(amplitude, normals):
        signal = [[None] * len(POSE.signal) for _ in range(n_looks)]
        for part in range(len(pairs.offsets) - 1):
            of = slice(pairs.offsets[part], pairs.offsets[part + 1])
            group, look = divmod(part, n_looks)
            tx, rx = (p[GROUPS[group]] for p in positions)
            at = points[pairs.sample[of]]
            rows = signal_tracer(amplitude[of], at, tx, rx, WAVEFORM, normals=normals[of])
            for antenna, row in zip(GROUPS[group], rows, strict=True):
                signal[look][antenna] = row
        return torch.stack([torch.stack(rows) for rows in signal])

    def together(amplitude, normals, num_threads):
        return trace_pairs(
            *(amplitude, points, normals, pairs, *positions, GROUPS, WAVEFORM),
            num_threads=num_threads,
        )

    want = part_by_part(*inputs)
    assert want.shape == (n_looks, len(POSE.signal), WAVEFORM.n_samples)
    weight = torch.randn(want.shape, generator=torch.Generator().manual_seed(1), dtype=want.dtype)
    slopes = torch.autograd.grad((want * weight).real.sum(), inputs)
    for num_threads in (1, 2, 20):  # fewer parts than threads: threads within each
        got = together(*inputs, num_threads)
        torch.testing.assert_close(got, want, rtol=0, atol=0)
        found = torch.autograd.grad((got * weight).real.sum(), inputs)
        for one, other in zip(found, slopes, strict=True):
            scale = float(other.abs().max())
            torch.testing.assert_close(one, other, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize(("dtype", "rtol"), [(torch.float64, 1e-13), (torch.float32, 1e-6)])
def test_the_defect_of_lengths_and_its_gradient_are_those_of_torch(dtype, rtol):
    gradients = torch.randn(2500, 3, generator=torch.Generator().manual_seed(0), dtype=dtype)
    gradients[7] = 0.0
    found = []
    for num_threads in (None, 1, 3):
        g = gradients.clone().requires_grad_()
        if num_threads is None:
            value = (torch.sqrt(g.square().sum(dim=1) + 1e-12) - 1.0).square().mean()
        else:
            value = length_defect(g, num_threads=num_threads)
        found.append((value.detach(), torch.autograd.grad(3.0 * value, g)[0]))
    for got in found[1:]:
        torch.testing.assert_close(got, found[0], rtol=rtol, atol=1e-9)
    assert torch.equal(found[1][0], found[2][0])
