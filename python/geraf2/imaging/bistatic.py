"""Peaks of transmitters and receivers that are decimetres apart, as seen from their midpoints.

An image takes the path of each antenna to the focus as it is. With the half path D(P) from the
middle c of a sub-aperture, whose transmitter is at c + h and receiver at c - h, a reflector P peaks
at the range D(P) - (D(F) - r_F) and the direction cosines g(P) - g(F) along the plane. F is the
focus at r_F, and g = -grad_c D the mean of the directions from transmitter and receiver.
"""

import numpy as np

from geraf2._types import Floats

# At 0.35 m a half baseline of 5 mm lengthens the half path by h^2 / 2 r = 0.04 mm [m].
_MIN_M = 5e-3
# Largest deviation of an antenna from the common half baseline [m].
_SAME_M = 1e-4
# Each round leaves h^2 / r^2 of the error, at most a fifth.
_N_ROUNDS = 8


def common_half_baseline(tx: Floats, rx: Floats) -> Floats | None:
    """Half baseline h of all antennas, (3,) [m]; None where it is short, or antennas differ.

    tx, rx: positions, (n, 3) [m].
    """
    halves = 0.5 * (tx - rx)
    mean = halves.mean(axis=0)
    is_common = float(np.abs(halves - mean).max(initial=0.0)) < _SAME_M
    return np.asarray(mean) if is_common and float(np.linalg.norm(mean)) > _MIN_M else None


def seen_from_midpoints(
    ranges_m: Floats,
    directions: Floats,
    centers: Floats,
    focus: Floats,
    half_m: Floats,
    axes: Floats,
) -> tuple[Floats, Floats]:
    """Ranges (n,) [m] and directions (n, 3) of reflectors from where their images peak.

    ranges_m, directions: of the peaks. centers, focus: of their sub-apertures, (n, 3) [m].
    half_m: half baseline, (3,) [m]. axes: of the plane, (3, 3).
    """
    known, slope = _half_paths(centers, focus, half_m)
    wanted_m = ranges_m + known - np.linalg.norm(focus - centers, axis=1)
    wanted = (directions + slope) @ axes[1:].T
    found_m, cosines = ranges_m, directions @ axes[1:].T
    for _ in range(_N_ROUNDS):
        ahead = np.sqrt(np.maximum(1.0 - (cosines**2).sum(axis=1), 0.0))
        directions = np.column_stack([ahead, cosines]) @ axes
        path, slope = _half_paths(centers, centers + found_m[:, None] * directions, half_m)
        found_m, cosines = found_m + wanted_m - path, cosines + wanted - slope @ axes[1:].T
    return found_m, directions


def _half_paths(centers: Floats, points: Floats, half_m: Floats) -> tuple[Floats, Floats]:
    """Half path via each point, (n,) [m], and the mean direction to it, (n, 3)."""
    legs = [points - centers - half_m, points - centers + half_m]
    lengths = [np.linalg.norm(leg, axis=1) for leg in legs]
    mean = sum(leg / length[:, None] for leg, length in zip(legs, lengths, strict=True))
    return 0.5 * (lengths[0] + lengths[1]), np.asarray(0.5 * mean)
