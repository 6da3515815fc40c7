"""The matched filter straight from its equation, in float64 torch; slow."""

import math

import torch

SPEED_OF_LIGHT = 299792458.0


def matched_filter(signal, tx, rx, points, waveform):
    """(n_antennas, n_samples), (n_antennas, 3), (n_antennas, 3), (n_points, 3) -> (n_points,)."""
    path = (points[:, None] - tx[None]).norm(dim=-1) + (points[:, None] - rx[None]).norm(dim=-1)
    delay = (path + waveform.path_bias_m) / SPEED_OF_LIGHT
    time = torch.arange(waveform.n_samples, dtype=torch.float64) / waveform.sample_rate_hz
    frequency = waveform.start_frequency_hz + waveform.chirp_slope_hz_per_s * time
    phase = 2.0 * math.pi * frequency * delay[..., None]
    return torch.einsum("at,pat->p", signal, torch.exp(1j * phase)) / signal.shape[0]
