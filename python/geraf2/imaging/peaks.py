"""Local maxima of sub-aperture images, refined below one bin."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from geraf2.imaging.subapertures import SubapertureImage

# Median of |X|^2 of complex Gaussian noise over its mean is ln 2 = 0.693.
_MEDIAN_OF_POWER = float(np.log(2.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Peaks:
    """Maxima of one sub-aperture image."""

    cosines: NDArray[np.float64]
    """Direction cosines along the pose's horizontal and vertical axis, (n_peaks, 2)."""
    ranges_m: NDArray[np.float64]
    """One-way distance from the sub-aperture's centre, (n_peaks,) [m]."""
    magnitudes: NDArray[np.float64]
    """Amplitude at the maximum, (n_peaks,)."""
    noise: NDArray[np.float64]
    """Root mean square of the noise in the peak's range bin, (n_peaks,)."""


def noise_floor(magnitude: NDArray[np.float32]) -> NDArray[np.float64]:
    """Root mean square of the noise in each range bin, (n_ranges,), from the median direction.

    The median sees the noise as long as echoes fill less than about half of the directions.
    """
    # A fixed subset of the directions is enough: the median of 400 values errs by 6 %.
    flat = magnitude.reshape(-1, magnitude.shape[2])[::4]
    power = np.median(flat.astype(np.float64) ** 2, axis=0)
    return np.asarray(np.sqrt(power / _MEDIAN_OF_POWER))


def find_peaks(image: SubapertureImage, dynamic_range_db: float, noise_margin_db: float) -> Peaks:
    """Maxima among 26 neighbours, above both thresholds, refined by a parabola per axis.

    Parameters
    ----------
    image
        Range bins at both ends never hold a peak.
    dynamic_range_db
        Peaks weaker than the image's largest by more are dropped [dB].
    noise_margin_db
        Peaks less than this above the noise floor of their range bin are dropped [dB].
    """
    magnitude = image.magnitude
    floor = noise_floor(magnitude)
    threshold = np.maximum(
        float(magnitude.max()) * 10.0 ** (-dynamic_range_db / 20.0),
        floor * 10.0 ** (noise_margin_db / 20.0),
    )
    candidate = magnitude > threshold.astype(np.float32)
    candidate[:, :, [0, -1]] = False
    if not image.wraps[0]:
        candidate[[0, -1]] = False
    if not image.wraps[1]:
        candidate[:, [0, -1]] = False
    i, j, k = np.nonzero(candidate)
    values = magnitude[i, j, k]
    n_h, n_v, _ = magnitude.shape
    is_maximum = np.ones(values.shape, dtype=bool)
    for a, b, c in product((-1, 0, 1), repeat=3):
        if (a, b, c) != (0, 0, 0):
            is_maximum &= values >= magnitude[(i + a) % n_h, (j + b) % n_v, k + c]
    i, j, k, values = i[is_maximum], j[is_maximum], k[is_maximum], values[is_maximum]

    di = _vertex(magnitude[(i - 1) % n_h, j, k], values, magnitude[(i + 1) % n_h, j, k])
    dj = _vertex(magnitude[i, (j - 1) % n_v, k], values, magnitude[i, (j + 1) % n_v, k])
    dk = _vertex(magnitude[i, j, k - 1], values, magnitude[i, j, k + 1])
    cosines = np.stack(
        [
            image.horizontal_cosines[i] + di * _pitch(image.horizontal_cosines),
            image.vertical_cosines[j] + dj * _pitch(image.vertical_cosines),
        ],
        axis=1,
    )
    visible = (cosines**2).sum(axis=1) < 1.0
    return Peaks(
        cosines=cosines[visible],
        ranges_m=(image.ranges_m[k] + dk * _pitch(image.ranges_m))[visible],
        magnitudes=values[visible].astype(np.float64),
        noise=floor[k][visible],
    )


def _pitch(axis: NDArray[np.float64]) -> float:
    return float(axis[1] - axis[0])


def _vertex(
    before: NDArray[np.float32], at: NDArray[np.float32], after: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Place of the maximum of a parabola through three log magnitudes, within one bin."""
    tiny = np.finfo(np.float32).tiny  # guards the logarithm of an exact zero
    low, mid, high = (np.log(np.maximum(v, tiny).astype(np.float64)) for v in (before, at, after))
    curvature = low - 2.0 * mid + high
    safe = np.where(curvature < 0.0, curvature, 1.0)
    return np.asarray(np.where(curvature < 0.0, np.clip(0.5 * (low - high) / safe, -1, 1), 0.0))
