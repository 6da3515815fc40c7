"""The sub-aperture image as one sum over antennas and samples, bin by bin; slow."""

import numpy as np

SPEED_OF_LIGHT = 299792458.0


def cosine_squared(n):
    """Hann weights at n positions, none of them zero."""
    return np.sin(np.pi * (np.arange(n) + 1.0) / (n + 1.0)) ** 2


def image(signal, tx, rx, axes, weights, center, target, waveform, bins):
    """|sum w s exp(j k (2 r + focus + bias)) exp(-j 4 pi u . offset / lambda_c)| / sum w.

    signal (n_antennas, n_samples), weights (n_antennas,), bins = (cosines, cosines, ranges).
    """
    frequency = (
        waveform.start_frequency_hz
        + waveform.chirp_slope_hz_per_s * np.arange(waveform.n_samples) / waveform.sample_rate_hz
    )
    time_weights = cosine_squared(waveform.n_samples)
    ahead = (target - center) @ axes[0]
    focus = center + ahead * axes[0]
    result = np.zeros([len(axis) for axis in bins])
    for position in np.ndindex(*result.shape):
        u, v, r = (axis[index] for axis, index in zip(bins, position, strict=True))
        total = 0.0
        for a in range(len(signal)):
            path = np.linalg.norm(tx[a] - focus) + np.linalg.norm(rx[a] - focus) - 2.0 * ahead
            offset = 0.5 * (tx[a] + rx[a]) - center
            tilt = 2.0 * (u * (offset @ axes[1]) + v * (offset @ axes[2]))
            near = 2.0 * r + path + waveform.path_bias_m
            phase = frequency * near - frequency.mean() * tilt
            turn = np.exp(2j * np.pi / SPEED_OF_LIGHT * phase)
            total += weights[a] * (time_weights * signal[a] * turn).sum()
        result[position] = abs(total) / (weights.sum() * time_weights.sum())
    return result
