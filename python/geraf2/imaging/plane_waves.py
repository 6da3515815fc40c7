"""Plane waves of a raster of antennas, and the depth at which its image is sharpest.

Over a plane, the echo of a scatterer is a sum of waves exp(j (k_h y + k_v z)). Their two-way wave
number is k_h^2 + k_v^2 = (4 pi f / c)^2 sin^2(angle). The matched filter gives them equal weights.
Waves nearly parallel to the plane, which few rasters sample finely enough, are then strongest near
the antennas. The specular return of a flat surface, such as foam or the side of a box, is far
stronger than an edge.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.scene import Pose, Waveform

# Largest distance of antennas from a raster, in steps of it.
_OFF_RASTER = 0.1
# Gaps between sorted coordinates above this share of the largest one are steps of the raster.
_GAP_SHARE = 0.4
# Frequencies of a search over depth: the aperture alone measures the depth, and ranges that alias
# with so few are blurred.
_N_SEARCH_FREQUENCIES = 16
_MAX_SEARCH_WAVES = 1 << 22  # limit of waves times frequencies: 0.2 GB and 10 s
# Share of the upper limit over which a cosine slope ends it: a sharp edge would ring.
_SLOPE = 0.2


def keep_angles(pose: Pose, waveform: Waveform, lowest_deg: float, highest_deg: float) -> Pose:
    """Pose with only the waves that arrive between two angles from the plane's normal.

    The zero-padded signal at each frequency is filtered in the wave number domain of the plane. The
    filter is (1 - exp(-(s / sin lowest)^2)) times a cosine slope that ends at sin highest. s is the
    sine of the angle, |k| c / (4 pi f).

    pose: antennas on a regular raster in the plane; transmitter and receiver are close to each
        other relative to the distance.
    lowest_deg, highest_deg: angles from the plane's normal [degrees]; a lowest_deg of 0 is no
        limit.
    """
    index, shape, steps = _raster_of(pose)
    spectrum, k = _spectrum(pose.signal, index, shape, steps)
    highest = np.sin(np.deg2rad(highest_deg))
    lowest = np.sin(np.deg2rad(lowest_deg))
    for number, frequency in enumerate(waveform.frequencies_hz):
        sine = k * SPEED_OF_LIGHT_M_PER_S / (4 * np.pi * frequency)
        slope = np.clip((highest - sine) / (_SLOPE * highest), 0.0, 1.0)
        weight = np.sin(0.5 * np.pi * slope) ** 2
        if lowest > 0:
            weight *= -np.expm1(-((sine / lowest) ** 2))
        spectrum[..., number] *= weight
    kept = np.fft.ifft2(spectrum, axes=(0, 1))[: shape[0], : shape[1]]
    signal = kept.reshape(-1, waveform.n_samples)[index]
    return replace(pose, signal=np.ascontiguousarray(signal, dtype=np.complex64))


def search_depth(pose: Pose, waveform: Waveform, farthest_m: float) -> tuple[Floats, Floats]:
    """Ascending distances from a raster of antennas [m], and the sharpness of the image at each.

    The image at depth z is the sum of plane waves exp(j sqrt((4 pi f / c)^2 - |k|^2) z) of equal
    weight over the frequencies. Depths start at two wavelengths. Steps are half a wavelength and
    grow to a quarter of the depth of focus 2 lambda z^2 / D^2, with D the longer side of the
    raster. The last depth is D^2 / (4 lambda), where the depth of focus is half the depth, or
    `farthest_m`.

    pose: antennas on a regular raster, as for keep_angles, with steps of up to a wavelength;
        UserError otherwise.
    farthest_m: largest distance [m].
    """
    index, shape, steps = _raster_of(pose)
    most = max(1, min(_N_SEARCH_FREQUENCIES, _MAX_SEARCH_WAVES // (4 * shape[0] * shape[1])))
    every = -(-waveform.n_samples // most)
    frequencies = waveform.frequencies_hz[::every]
    wavelength = waveform.center_wavelength_m
    if max(steps) > wavelength:
        raise UserError(
            what="the raster is too coarse to search the depth",
            expected=f"steps of at most a wavelength, {1e3 * wavelength:.3g} mm",
            got=f"{1e3 * max(steps):.3g} mm",
        )
    spectrum, k = _spectrum(pose.signal[:, ::every], index, shape, steps)
    two_way = 4 * np.pi * frequencies / SPEED_OF_LIGHT_M_PER_S
    squares = two_way**2 - k[..., None] ** 2
    along = np.sqrt(np.maximum(squares, 0.0))
    spectrum *= (squares > 0) * np.exp(0.5j * two_way * waveform.path_bias_m)
    width = max((n - 1) * step for n, step in zip(shape, steps, strict=True))
    farthest = min(farthest_m, 0.25 * width**2 / wavelength)
    depth, step = 2 * wavelength, 0.5 * wavelength
    spectrum *= np.exp(1j * along * depth)
    advance = np.exp(1j * along * step).astype(np.complex64)
    depths: list[float] = []
    sharpness: list[float] = []
    while depth <= farthest or not depths:
        image = np.fft.ifft2(spectrum.sum(axis=-1))[: shape[0], : shape[1]]
        depths.append(depth)
        sharpness.append(float(depth_sharpness(np.abs(image)[None], 0)[0]))
        if 2 * step <= 0.5 * wavelength * (depth / width) ** 2:
            step, advance = 2 * step, advance**2
        spectrum *= advance
        depth += step
    return np.array(depths), np.array(sharpness)


def _spectrum(
    signal: NDArray[np.complex64],
    index: NDArray[np.intp],
    shape: tuple[int, int],
    steps: tuple[float, float],
) -> tuple[NDArray[np.complex64], Floats]:
    """Plane waves of each sample of the zero-padded raster, and their |k| [rad/m]."""
    planes = np.zeros((*shape, signal.shape[1]), dtype=np.complex64)
    planes.reshape(-1, signal.shape[1])[index] = signal
    # Twice the size, so that the periodic transform does not couple opposite edges.
    padded = tuple(2 * n for n in shape)
    spectrum = np.fft.fft2(planes, s=padded, axes=(0, 1)).astype(np.complex64, copy=False)
    k_h, k_v = (2 * np.pi * np.fft.fftfreq(n, step) for n, step in zip(padded, steps, strict=True))
    return spectrum, np.asarray(np.hypot(k_h[:, None], k_v))


def depth_sharpness(volume: NDArray[np.float32], axis: int) -> Floats:
    """Sharpness of each slice across an axis, n sum |v|^4 / (sum |v|^2)^2, (volume.shape[axis],).

    It is 1 for a constant slice, and n, the number of its voxels, for a single bright one.

    volume: magnitude of an image.
    axis: normal of the slices.
    """
    slices = np.moveaxis(np.asarray(volume, dtype=np.float64), axis, 0)
    power = slices.reshape(slices.shape[0], -1) ** 2
    total = power.sum(axis=1)
    return np.asarray(
        power.shape[1]
        * np.divide((power**2).sum(axis=1), total**2, out=np.zeros_like(total), where=total > 0)
    )


def _raster_of(pose: Pose) -> tuple[NDArray[np.intp], tuple[int, int], tuple[float, float]]:
    """Index of each antenna in a raster, its shape (horizontal, vertical), and its steps [m]."""
    across = pose.phase_centers @ pose.axes[1:].T
    numbers, shape, steps = [], [], []
    for coordinates in across.T:
        ordered = np.sort(coordinates)
        gaps = np.diff(ordered)
        if not np.ptp(ordered) > 0:
            _refuse(pose)
        # Smaller gaps separate antennas of one row or column, by the positioner's inaccuracy.
        starts = np.flatnonzero(gaps > _GAP_SHARE * gaps.max()) + 1
        means = np.array([part.mean() for part in np.split(ordered, starts)])
        step = np.ptp(means) / round(np.ptp(means) / np.median(np.diff(means)))
        position = (coordinates - means[0]) / step
        if np.abs(position - np.round(position)).max() > _OFF_RASTER:
            _refuse(pose)
        number = np.round(position).astype(np.intp)
        numbers.append(number)
        shape.append(int(number.max()) + 1)
        steps.append(float(step))
    n_points = shape[0] * shape[1]
    index = numbers[0] * shape[1] + numbers[1]
    # Empty points count as zero, but two antennas at one point cannot be separated.
    if len(np.unique(index)) < len(index) or n_points > 4 * len(index):
        _refuse(pose)
    return index, (shape[0], shape[1]), (steps[0], steps[1])


def _refuse(pose: Pose) -> None:
    raise UserError(
        what=f"plane {pose.name or 'unnamed'} is no regular raster, angles cannot be chosen",
        expected="one antenna at each point of a grid across the looking direction",
    )
