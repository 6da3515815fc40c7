"""Peaks of an image in NumPy, from the definition; the kernel searches while it images."""

from itertools import product

import numpy as np


def noise_floor(magnitude):
    """Root mean square of the noise per range bin: the median power of every fourth direction."""
    flat = magnitude.reshape(-1, magnitude.shape[2])[::4].astype(np.float64)
    return np.sqrt(np.median(flat**2, axis=0) / np.log(2.0))


def vertex(before, at, after):
    """Position of the top of a parabola through three log magnitudes."""
    low, mid, high = np.log(before), np.log(at), np.log(after)
    if low == mid == high:  # an axis of one bin
        return 0.0
    return 0.5 * (low - high) / (low - 2.0 * mid + high)


def find_peaks(magnitude, wraps, dynamic_range_db, noise_margin_db):
    """Bins (n, 3), positions in bins (n, 3), magnitudes and noise of the peaks, bin by bin."""
    floor = noise_floor(magnitude)
    threshold = np.maximum(
        magnitude.max() * 10.0 ** (-dynamic_range_db / 20.0),
        floor * 10.0 ** (noise_margin_db / 20.0),
    )
    padded = np.pad(magnitude, ((1, 1), (1, 1), (0, 0)), mode="wrap").astype(np.float64)
    found = []
    for i, j, k in np.ndindex(*magnitude.shape):
        at_edge = [n in (0, size - 1) for n, size in zip((i, j, k), magnitude.shape, strict=True)]
        if (at_edge[0] and not wraps[0]) or (at_edge[1] and not wraps[1]) or at_edge[2]:
            continue
        value = padded[i + 1, j + 1, k]
        if not value > threshold[k]:
            continue
        near = {
            (a, b, c): padded[i + 1 + a, j + 1 + b, k + c]
            for a, b, c in product((-1, 0, 1), repeat=3)
        }
        if value < max(near.values()):
            continue
        axes = [((-1, 0, 0), (1, 0, 0)), ((0, -1, 0), (0, 1, 0)), ((0, 0, -1), (0, 0, 1))]
        shift = [vertex(near[low], value, near[high]) for low, high in axes]
        found.append(((i, j, k), np.array([i, j, k]) + shift, value, floor[k]))
    return found
