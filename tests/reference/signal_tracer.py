"""The signal tracer straight from its equations, in float64 torch; slow."""

import math

import torch

SPEED_OF_LIGHT = 299792458.0


def specular_factor(points, tx, rx, normals):
    """(w_o . w_r)+ of the paper's equation 2 -> (n_antennas, n_points); zero on an antenna."""

    def direction(v):
        length = v.norm(dim=-1, keepdim=True)
        return torch.where(length > 0, v / torch.where(length > 0, length, 1.0), 0.0)

    incoming = direction(points[None] - tx[:, None])  # w_i, from the transmitter to the point
    cosine = (normals * incoming).sum(-1, keepdim=True)
    outgoing = incoming - 2.0 * cosine * normals  # w_o
    to_receiver = direction(rx[:, None] - points[None])  # w_r
    return (outgoing * to_receiver).sum(-1).clamp(min=0.0)


def signal_tracer(amplitude, points, tx, rx, waveform, normals=None):
    """(n_points,) or (n_antennas, n_points), ... -> (n_antennas, n_samples)."""
    path = (points[None] - tx[:, None]).norm(dim=-1) + (points[None] - rx[:, None]).norm(dim=-1)
    delay = (path + waveform.path_bias_m) / SPEED_OF_LIGHT
    time = torch.arange(waveform.n_samples, dtype=torch.float64) / waveform.sample_rate_hz
    frequency = waveform.start_frequency_hz + waveform.chirp_slope_hz_per_s * time
    phasor = torch.exp(-2j * math.pi * frequency * delay[..., None])
    weight = amplitude.expand(path.shape)
    if normals is not None:
        weight = weight * specular_factor(points, tx, rx, normals)
    return (weight[..., None] * phasor).sum(dim=1)
