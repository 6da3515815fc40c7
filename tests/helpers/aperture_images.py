"""Single images of sub-apertures, and their peaks."""

from dataclasses import dataclass

import numpy as np

from geraf2 import _core  # noqa: TID251 - images, of which the package takes only the peaks
from geraf2.imaging.subapertures import pose_images
from geraf2.ops import subaperture as kernel
from geraf2.ops._threads import resolve_num_threads
from geraf2.ops.subaperture import CosineAxis, SubapertureBins


@dataclass(frozen=True, kw_only=True, eq=False)
class SubapertureImage:
    """Magnitude over horizontal direction cosine, vertical direction cosine, and range."""

    magnitude: np.ndarray
    """(n_horizontal, n_vertical, n_ranges); 1 for a unit scatterer straight ahead in range."""
    center: np.ndarray
    """Centre of the sub-aperture in the frame, (3,) [m]."""
    horizontal_cosines: np.ndarray
    """Direction cosine of each row, ascending, equally spaced, (n_horizontal,)."""
    vertical_cosines: np.ndarray
    """Direction cosine of each column, ascending, equally spaced, (n_vertical,)."""
    ranges_m: np.ndarray
    """One-way distance from the centre, instrument delay subtracted, (n_ranges,) [m]."""
    wraps: tuple[bool, bool]
    """Whether the horizontal and the vertical direction axis is periodic."""


def kernel_images(*problem, num_threads=None):
    """Images of all sub-apertures; arguments as in `subaperture_peaks`."""
    arguments = kernel._native_arguments(*problem)
    return _core.subaperture_images(**arguments, num_threads=resolve_num_threads(num_threads))


def image_peaks(magnitude, bins, thresholds_db):
    thresholds = kernel._thresholds(thresholds_db)
    return kernel._peaks(_core.image_peaks(magnitude, bins.native(), thresholds))


def noise_floor(magnitude, bins):
    return _core.noise_floor(magnitude, bins.native())


def subaperture_images(pose, waveform, target, range_span_m, config):
    """Images of all sub-apertures of a pose; arguments as in `pose_images`."""
    made = pose_images(pose, waveform, target, range_span_m, config)
    antennas = pose.signal, pose.tx_positions, pose.rx_positions
    magnitudes = kernel_images(*antennas, waveform, made.subapertures, made.bins)
    for magnitude, center in zip(magnitudes, made.centers, strict=True):
        yield SubapertureImage(
            magnitude=magnitude,
            center=center,
            horizontal_cosines=made.bins.horizontal.values,
            vertical_cosines=made.bins.vertical.values,
            ranges_m=made.bins.ranges_m,
            wraps=(made.bins.horizontal.wraps, made.bins.vertical.wraps),
        )


def find_peaks(image, dynamic_range_db, noise_margin_db):
    return image_peaks(image.magnitude, image_bins(image), (dynamic_range_db, noise_margin_db))


def image_bins(image):
    horizontal, vertical = (
        CosineAxis(count=len(axis), first=float(axis[0]), pitch=_pitch(axis), wraps=wraps)
        for axis, wraps in zip(
            (image.horizontal_cosines, image.vertical_cosines), image.wraps, strict=True
        )
    )
    return SubapertureBins(
        horizontal=horizontal,
        vertical=vertical,
        first_range_m=float(image.ranges_m[0]),
        range_pitch_m=_pitch(image.ranges_m),
        n_ranges=len(image.ranges_m),
    )


def _pitch(axis):
    return float(axis[1] - axis[0])
