import numpy as np
import pytest
import torch

from geraf2.fields import BoxSolid
from geraf2.learned.config import RenderConfig
from geraf2.learned.fields import CubeDomain, LearnedSdfGrid
from geraf2.learned.lensless import LenslessRenderer, VisionPrior
from geraf2.learned.ray_sampling import LenslessSampler
from geraf2.scene import LosPrior
from helpers.synthetic import WAVEFORM, point_pose

SIDE_M = 0.16
PRIOR = LosPrior.from_box((SIDE_M, SIDE_M, SIDE_M))
DOMAIN = CubeDomain(center_m=(0.0, 0.0, 0.0), half_side_m=0.1)
POSE = point_pose(30.0, n_side=12, spacing_m=0.01)
RADIUS_M = 0.03


def vision():
    outside = BoxSolid(size_m=PRIOR.size_m)
    return VisionPrior(outside.signed_distance, DOMAIN, 41)


def ball_field(radius=RADIUS_M, center=(0.0, 0.0, 0.0)):
    field = LearnedSdfGrid(DOMAIN, n_per_side=41)
    field.initialise(lambda x: np.linalg.norm(x - np.asarray(center), axis=1) - radius)
    return field.double()


def sampler(n_cells=8, n_samples=16, **options):
    size = {"n_cells": n_cells, "n_samples": n_samples}
    return LenslessSampler(PRIOR, dtype=torch.float64, **size, **options)


def rays_of(lensless, seed=0, **options):
    return lensless.sample(POSE.axes, torch.Generator().manual_seed(seed), **options)


def render(field, rays, inv_s=300.0, antennas=slice(None), lensless=None, **config):
    lensless = sampler() if lensless is None else lensless
    renderer = LenslessRenderer(
        lensless, vision(), WAVEFORM, RenderConfig(**{"lobe_power": 1.0, "n_looks": 1, **config})
    )
    power = torch.tensor(1.0, dtype=torch.float64)
    s = torch.tensor(inv_s, dtype=torch.float64)
    tx, rx = POSE.tx_positions[antennas], POSE.rx_positions[antennas]
    return renderer.render(field, None, power, s, rays, tx, rx)


def test_rays_are_parallel_jittered_and_within_the_scene():
    lensless = sampler()
    rays, again = rays_of(lensless), rays_of(lensless)
    torch.testing.assert_close(rays.points, again.points, rtol=0, atol=0)
    assert (rays.points != rays_of(lensless, seed=1).points).any()
    np.testing.assert_allclose(rays.direction, POSE.axes[0])
    grown = BoxSolid(size_m=(1.1 * SIDE_M,) * 3)
    assert grown.signed_distance(rays.points.reshape(-1, 3).numpy()).max() < 1e-6
    np.testing.assert_allclose(grown.signed_distance(rays.starts.numpy()), 0.0, atol=1e-6)
    # Intervals touch: middle + half a step is where the next begins.
    along = (rays.points - rays.starts[:, None]) @ rays.direction
    ends = along + 0.5 * rays.step
    torch.testing.assert_close(ends[:, :-1], along[:, 1:] - 0.5 * rays.step[:, 1:])
    torch.testing.assert_close(along[:, 0] - 0.5 * rays.step[:, 0], rays.offset)


@pytest.mark.parametrize(
    ("two_way", "spreading", "lobe_power"),
    [("squared", "none", 1.0), ("unbiased", "none", 1.0), ("unbiased", "two-way", 8.0)],
)
def test_the_amplitude_is_equation_4_or_its_corrected_form(two_way, spreading, lobe_power):
    """One antenna, every factor written out again from the equation."""
    field, lensless = ball_field(), sampler()
    rays = rays_of(lensless)
    form = {"two_way": two_way, "spreading": spreading, "lobe_power": lobe_power}
    got = render(field, rays, antennas=[5], n_clusters=0, lensless=lensless, **form)
    s, antenna = 300.0, 0.5 * (POSE.tx_positions[5] + POSE.rx_positions[5])
    points = rays.points.reshape(-1, 3)
    with torch.no_grad():
        value, gradient = field(points)
    f, n = value.numpy(), gradient.numpy()

    def phi(x):
        return 1.0 / (1.0 + np.exp(-s * x))

    half = 0.5 * rays.step.numpy().reshape(-1) * np.minimum(n @ POSE.axes[0], 0.0)
    alpha = (1.0 - phi(f + half) / phi(f - half)).reshape(rays.step.shape)
    before = np.cumprod(1.0 - alpha, axis=1)
    one_way = np.concatenate([np.ones((len(alpha), 1)), before[:, :-1]], axis=1)
    start = vision()
    first = start.field.sample(rays.starts.numpy()).repeat(rays.step.shape[1])
    entry = lensless.boundary.first_meetings(np.tile(antenna, (len(points), 1)), points.numpy())
    transmittance = one_way.reshape(-1) + phi(start.field.sample(entry)) - phi(first)
    transmittance = np.maximum(transmittance, 0.0) ** (2 if two_way == "squared" else 1)
    normals = n / np.linalg.norm(n, axis=1, keepdims=True)
    tx, rx = POSE.tx_positions[5], POSE.rx_positions[5]
    to_tx, to_rx = points.numpy() - tx, points.numpy() - rx
    d_tx, d_rx = np.linalg.norm(to_tx, axis=1), np.linalg.norm(to_rx, axis=1)
    a, b = to_tx / d_tx[:, None], to_rx / d_rx[:, None]
    outgoing = a - 2.0 * (normals * a).sum(axis=1, keepdims=True) * normals
    cosine = np.maximum((outgoing * -b).sum(axis=1), 0.0)
    amplitude = cosine * transmittance * alpha.reshape(-1) / (4.0 * np.pi) ** 2
    leg = np.linalg.norm(points.numpy() - antenna, axis=1)
    incidence = (normals * (points.numpy() - antenna)).sum(axis=1) / leg
    amplitude *= np.maximum(2.0 * incidence**2 - 1.0, 0.0) ** (lobe_power - 1.0)
    if spreading == "two-way":
        amplitude *= (antenna @ antenna) / leg**2
    path = d_tx + d_rx + WAVEFORM.path_bias_m
    phase = 2.0 * np.pi * path[:, None] * WAVEFORM.frequencies_hz / 299792458.0
    want = (amplitude[:, None] * np.exp(-1j * phase)).sum(axis=0)
    np.testing.assert_allclose(
        got.signal.detach().numpy()[0, 0], want, atol=2e-3 * np.abs(amplitude).sum()
    )


def echo_powers(field, rays, inv_s, lensless, **config):
    """Points and |amplitude|^2 of samples: the signal is linear in reflectivity, so its slope."""
    seen = {}

    def reflectivity(points):
        seen["points"] = points.detach().numpy()
        seen["rho"] = torch.ones(len(points), dtype=torch.float64, requires_grad=True)
        return seen["rho"]

    renderer = LenslessRenderer(lensless, vision(), WAVEFORM, RenderConfig(n_looks=1, **config))
    one, s = torch.tensor(1.0, dtype=torch.float64), torch.tensor(inv_s, dtype=torch.float64)
    antenna = -20.0 * POSE.axes[:1]  # so far that waves are plane
    got = renderer.render(field, reflectivity, one, s, rays, antenna, antenna).signal[0, 0, 0]
    slopes = [
        torch.autograd.grad(part, seen["rho"], retain_graph=True)[0].numpy()
        for part in (got.real, got.imag)
    ]
    return seen["points"], slopes[0] ** 2 + slopes[1] ** 2


@pytest.mark.parametrize(("two_way", "want"), [("squared", 5.0 / 6.0), ("unbiased", 0.0)])
@pytest.mark.parametrize("inv_s", [120.0, 300.0])
def test_equation_4_echoes_of_a_plate_lie_five_sixths_of_1_over_s_in_front(two_way, want, inv_s):
    """docs/math/ray-march-and-lensless.md#lensless-level: mean over power, of Beta(2 m, 2) in Phi,
    m = 2 and 1."""
    axis, lensless = POSE.axes[0], sampler(3, 600)
    field = LearnedSdfGrid(DOMAIN, n_per_side=5)
    field.initialise(lambda x: -(x @ axis))
    keep = np.zeros(lensless.n_rays, dtype=bool)
    keep[lensless.n_rays // 2] = True
    rays = rays_of(lensless, keep=keep)
    points, power = echo_powers(field.double(), rays, inv_s, lensless, two_way=two_way)
    assert len(power) == 600
    # Intervals are uneven, and an amplitude is in proportion to its own.
    density = power / rays.step.numpy()[0]
    in_front = -(density * (points @ axis)).sum() / density.sum()
    assert in_front == pytest.approx(want / inv_s, abs=0.03 / inv_s)


def test_a_distance_that_falls_nowhere_gives_no_signal():
    axis = POSE.axes[0]
    field = LearnedSdfGrid(DOMAIN, n_per_side=11)
    field.initialise(lambda x: x @ axis)  # grows along the rays
    got = render(field.double(), rays_of(sampler()), n_looks=2)
    assert got.signal.shape[0] == 2
    assert got.signal.abs().max() == 0.0
    (got.signal.abs().sum() + got.gradient.square().sum()).backward()
    assert all(torch.isfinite(p.grad).all() for p in field.parameters() if p.grad is not None)


def test_without_ulos_the_field_under_training_corrects_without_a_gradient():
    field, lensless = ball_field(radius=0.075), sampler()
    rays = rays_of(lensless)
    on = render(field, rays, inv_s=60.0, lensless=lensless)
    off = render(field, rays, inv_s=60.0, ulos=False, lensless=lensless)
    assert (on.signal - off.signal).abs().max() > 0.01 * on.signal.abs().max()


def test_looks_share_out_the_samples_and_add_up_to_the_signal():
    field, lensless = ball_field(), sampler()
    rays = rays_of(lensless)
    one = render(field, rays, lensless=lensless).signal.detach()
    looks = render(field, rays, lensless=lensless, n_looks=5).signal.detach()
    assert looks.shape == (5, *one.shape[1:])
    assert (looks.abs().amax(dim=(1, 2)) > 0.0).all()
    torch.testing.assert_close(looks.sum(dim=0), one[0], rtol=0, atol=1e-3 * float(one.abs().max()))


@pytest.mark.gradient
@pytest.mark.parametrize(
    "config",
    [{}, {"two_way": "unbiased", "spreading": "two-way", "lobe_power": 8.0}, {"n_looks": 3}],
)
def test_the_signal_has_the_gradient_that_differences_show(config):
    lensless = sampler(4, 8)
    rays = rays_of(lensless)
    field = LearnedSdfGrid(DOMAIN, n_per_side=7)
    field.initialise(lambda x: np.linalg.norm(x, axis=1) - 0.05)
    field = field.double()
    antennas = [0, 70, 143]

    def loss():
        signal = render(field, rays, 80.0, antennas, lensless, **config).signal
        return signal.abs().square().sum() * 1e6

    loss().backward()
    gradient = field.values.grad.clone()
    direction = torch.randn(gradient.shape, generator=torch.Generator().manual_seed(1)).double()
    step = 1e-6
    with torch.no_grad():
        field.values += step * direction
        above = loss()
        field.values -= 2 * step * direction
        below = loss()
    slope = (above - below) / (2 * step)
    assert (gradient * direction).sum().item() == pytest.approx(slope.item(), rel=2e-3)
