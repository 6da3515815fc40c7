"""Lensless rendering, slowly: every sample, one factor after another, in torch."""

import math

import numpy as np
import torch

from geraf2.ops import ray_march
from reference.signal_tracer import signal_tracer


def amplitudes(alpha, transmittance, gradient, points, shift, center, form):
    """Amplitude (n,) and normals (n, 3) of samples towards antennas about one centre (3,)."""
    normals = torch.nn.functional.normalize(gradient, dim=1, eps=1e-6)
    leg = points - center
    length = torch.linalg.vector_norm(leg, dim=1)
    corrected = (transmittance + shift).clamp(min=0.0)
    amplitude = alpha * corrected ** form["two_way_power"]
    if form["lobe_power"] != 1.0:
        cosine = (normals * leg).sum(dim=1) / length
        lobe = (2.0 * cosine.square() - 1.0).clamp(min=0.0)
        # pow has no derivative to a base of zero where the exponent is below one
        lit = lobe > 0.0
        amplitude = amplitude * torch.where(
            lit, torch.where(lit, lobe, 1.0).pow(form["lobe_power"] - 1.0), 0.0
        )
    if form.get("reference") is not None:
        amplitude = amplitude * (form["reference"] / length).square()
    return amplitude, normals


def render(renderer, field, power, inv_s, rays, tx, rx, groups):
    """Signal (n_looks, n_antennas, n_samples) of `LenslessRenderer.render` without reflectivity."""
    config, points = renderer.config, rays.points.reshape(-1, 3)
    value, gradient = field(points)
    shape = rays.step.shape
    cosine = (gradient @ rays.direction).reshape(shape)
    march = ray_march(value.reshape(shape), cosine, rays.step, inv_s, two_way="none")
    ray, sample = np.indices(shape).reshape(2, -1)
    look = torch.from_numpy((sample + 5 * ray) % config.n_looks)
    first = torch.sigmoid(inv_s * renderer.vision.sample(rays.starts)[0])
    turned = gradient if config.normal_gradient else gradient.detach()
    signal = torch.zeros(
        (config.n_looks, len(tx), renderer.waveform.n_samples), dtype=torch.complex128
    )
    for group in groups:
        center = 0.5 * (tx[group] + rx[group]).mean(axis=0)
        origins = np.broadcast_to(center, points.shape).copy()
        starts = torch.from_numpy(renderer.sampler.boundary.first_meetings(origins, points.numpy()))
        second = torch.sigmoid(inv_s * renderer.vision.sample(starts)[0])
        shift = (second.reshape(shape) - first[:, None]).reshape(-1).detach()
        form = {
            "two_way_power": 2 if config.two_way == "squared" else 1,
            "lobe_power": config.lobe_power,
            "reference": float(np.linalg.norm(center - renderer.sampler.center))
            if config.spreading == "two-way"
            else None,
        }
        amplitude, normals = amplitudes(
            march.alpha.reshape(-1),
            march.transmittance.reshape(-1),
            turned,
            points,
            shift,
            torch.from_numpy(center),
            form,
        )
        amplitude = amplitude * power / (4.0 * math.pi) ** 2
        antennas = [torch.from_numpy(a[group]) for a in (tx, rx)]
        for number in range(config.n_looks):
            mine = torch.where(look == number, amplitude, 0.0)
            signal[number, group] = signal_tracer(
                mine, points, *antennas, renderer.waveform, normals
            )
    return signal
