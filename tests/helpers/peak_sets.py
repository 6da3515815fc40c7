"""Peaks of planes as a test wants them."""

import numpy as np

from geraf2.imaging.peaks import PeakSet, join_peaks
from helpers.specular import STANDOFF_M, frame


def peaks_of_plane(
    number, positions, cosines, ranges_m, period=np.inf, magnitudes=1.0, n_planes=12
):
    """One peak of each sub-aperture: middles (n, 2) [m], cosines (n, 2), ranges (n,) [m]."""
    n, axes = len(positions), frame(360.0 * number / n_planes)
    ahead = np.sqrt(1.0 - (cosines**2).sum(axis=1))
    return PeakSet(
        subapertures=np.arange(n),
        directions=np.column_stack([ahead, cosines]) @ axes,
        ranges_m=np.asarray(ranges_m, dtype=float),
        magnitudes=np.broadcast_to(magnitudes, n).astype(float),
        noise=np.full(n, 0.01),
        subaperture_centers=-STANDOFF_M * axes[0] + positions @ axes[1:],
        subaperture_coordinates=np.asarray(positions, dtype=float),
        subaperture_planes=np.full(n, number, dtype=np.int64),
        tops=np.ones(n),
        periods=np.full((n, 2), period),
    )


def positions_of(n=4, step_m=0.02):
    """Middles of n x n sub-apertures, (n^2, 2) [m]."""
    steps = step_m * (np.arange(n) - 0.5 * (n - 1))
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)


def sphere_peaks(center, radius_m, planes, period=np.inf, wrap=True, **options):
    """Exact peaks of a sphere; cosines are wrapped into the period as an image shows them."""
    positions, parts = positions_of(), []
    for number in planes:
        axes = frame(30.0 * number)
        leg = np.asarray(center) - (-STANDOFF_M * axes[0] + positions @ axes[1:])
        far = np.linalg.norm(leg, axis=1)
        cosines = (leg / far[:, None]) @ axes[1:].T
        if wrap and np.isfinite(period):
            cosines = cosines - period * np.rint(cosines / period)
        parts.append(peaks_of_plane(number, positions, cosines, far - radius_m, period, **options))
    return join_peaks(parts)
