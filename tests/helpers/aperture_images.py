"""Single images of sub-apertures, and their peaks."""

from typing import NamedTuple

import numpy as np

from geraf2 import _core  # noqa: TID251 - images, of which the package takes only the peaks
from geraf2.imaging.subapertures import pose_images
from geraf2.ops import subaperture as kernel
from geraf2.ops._threads import resolve_num_threads
from geraf2.ops.subaperture import SubapertureBins


class SubapertureImage(NamedTuple):
    """One image: its magnitude, the middle of its sub-aperture (3,) [m], and its bins."""

    magnitude: np.ndarray
    center: np.ndarray
    bins: SubapertureBins


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
        yield SubapertureImage(magnitude, center, made.bins)
