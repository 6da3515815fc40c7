"""Focused images of small sub-apertures on a grid of range and direction.

A specular echo of a smooth surface focuses where the surface is only as long as the aperture is
small against the surface's curvature; over a full scan plane it moves towards the centre of
curvature (docs/math.md, sub-aperture images).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._validation import require_positive
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.scene import Pose, Waveform

# A raster's antennas may miss their place sideways by this part of a wavelength: the error,
# u * offset for direction cosines u up to 0.3, stays below 4 pi 0.3 / 20 = 0.19 rad.
_RASTER_TOLERANCE_WAVELENGTHS = 0.05
# Share of raster places that may be empty; they count as zeros.
_RASTER_MAX_HOLES = 0.05


@dataclass(frozen=True, kw_only=True)
class SubapertureConfig:
    """Size and sampling of the sub-aperture images."""

    size_m: float = 0.08
    """Side of a square sub-aperture [m]. Smaller blurs weak echoes together, larger moves echoes
    of curved surfaces: 0.045 m costs 0.10 of F1 at 5 mm, 0.14 m 0.06."""
    step_m: float = 0.02
    """Step from one sub-aperture to the next [m]; neighbours overlap by three quarters."""
    direction_oversampling: float = 3.0
    """Direction bins per wavelength / size_m, the distance of two directions that a sub-aperture
    of uniform weight would just resolve on the two-way path."""
    max_cosine: float = 0.6
    """Largest direction cosine imaged; a coarser raster cannot tell directions further apart
    than wavelength / (2 spacing), and its image wraps around there."""
    range_oversampling: int = 2
    """Range bins per range cell."""

    def __post_init__(self) -> None:
        require_positive("size_m", self.size_m)
        require_positive("step_m", self.step_m)
        require_positive("direction_oversampling", self.direction_oversampling)
        if not 0.0 < self.max_cosine < 1.0:
            msg = f"max_cosine must lie between 0 and 1, got {self.max_cosine}"
            raise ValueError(msg)
        if self.range_oversampling < 1:
            msg = f"range_oversampling must be at least 1, got {self.range_oversampling}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True, eq=False)
class SubapertureImage:
    """Magnitude over horizontal direction cosine, vertical direction cosine, and range."""

    magnitude: NDArray[np.float32]
    """(n_horizontal, n_vertical, n_ranges). A point scatterer of unit echo, straight ahead at
    the expected range, gives 1."""
    center: NDArray[np.float64]
    """Centre of the sub-aperture in the frame, (3,) [m]."""
    horizontal_cosines: NDArray[np.float64]
    """Direction cosine of each row, ascending, equally spaced, (n_horizontal,)."""
    vertical_cosines: NDArray[np.float64]
    """Direction cosine of each column, ascending, equally spaced, (n_vertical,)."""
    ranges_m: NDArray[np.float64]
    """One-way distance from the centre, instrument delay taken off, (n_ranges,) [m]."""
    wraps: tuple[bool, bool]
    """Whether the horizontal and the vertical direction axis is periodic."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Raster:
    """Antennas of a pose on a regular lattice of its horizontal and vertical axis."""

    index: NDArray[np.int64]
    """Antenna at each place, -1 where there is none, (n_horizontal, n_vertical)."""
    horizontal_m: NDArray[np.float64]
    """Lattice coordinates along the pose's horizontal axis, (n_horizontal,) [m]."""
    vertical_m: NDArray[np.float64]
    """Lattice coordinates along the pose's vertical axis, (n_vertical,) [m]."""


def find_raster(pose: Pose, wavelength_m: float) -> Raster | None:
    """Lattice on which the phase centres lie, or None when the positions are irregular."""
    local = pose.phase_centers @ pose.axes.T
    tolerance = _RASTER_TOLERANCE_WAVELENGTHS * wavelength_m
    lines = [_lattice(local[:, axis], tolerance) for axis in (1, 2)]
    if lines[0] is None or lines[1] is None:
        return None
    (h_lines, h_index), (v_lines, v_index) = lines[0], lines[1]
    index = np.full((len(h_lines), len(v_lines)), -1, dtype=np.int64)
    index[h_index, v_index] = np.arange(pose.n_antennas)
    n_placed = int((index >= 0).sum())
    enough = n_placed >= (1.0 - _RASTER_MAX_HOLES) * index.size
    if n_placed < pose.n_antennas or not enough:
        return None
    return Raster(index=index, horizontal_m=h_lines, vertical_m=v_lines)


def _lattice(
    values: NDArray[np.float64], tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Equally spaced lines through all values within the tolerance, and each value's line."""
    ordered = np.sort(values)
    groups = np.split(ordered, np.nonzero(np.diff(ordered) > 2.0 * tolerance)[0] + 1)
    centers = np.array([group.mean() for group in groups])
    if len(centers) < 2:
        return None
    spacing = float(np.median(np.diff(centers)))
    steps = np.rint((values - centers[0]) / spacing).astype(np.int64)
    n_lines = int(steps.max()) + 1
    if n_lines > 4 * len(centers) or n_lines < 2:
        return None
    start = float(np.mean(values - spacing * steps))
    residual = values - start - spacing * steps
    # Least squares over the spacing, since rounding in the file adds up over a long line.
    slope = float(residual @ (steps - steps.mean())) / max(float(np.var(steps)) * len(steps), 1.0)
    spacing += slope
    start = float(np.mean(values - spacing * steps))
    if np.abs(values - start - spacing * steps).max() > tolerance:
        return None
    return np.asarray(start + spacing * np.arange(n_lines), dtype=np.float64), steps


def subaperture_images(
    pose: Pose,
    waveform: Waveform,
    target: NDArray[np.float64],
    range_span_m: tuple[float, float],
    config: SubapertureConfig,
) -> Iterator[SubapertureImage]:
    """Images of all sub-apertures of a pose.

    Parameters
    ----------
    pose
        Rasters are imaged by Fourier transforms, irregular positions by the direct sum
        over the antennas.
    waveform
        The chirp; its instrument delay is taken off.
    target
        Point on which the near field is focused, (3,) [m].
    range_span_m
        Smallest and largest one-way distance to image [m].
    config
        Size and sampling.
    """
    raster = find_raster(pose, waveform.center_wavelength_m)
    if raster is None:
        yield from _irregular_images(pose, waveform, target, range_span_m, config)
    else:
        yield from _raster_images(pose, raster, waveform, target, range_span_m, config)


def _range_bins(
    waveform: Waveform, range_span_m: tuple[float, float], oversampling: int
) -> NDArray[np.float64]:
    spacing = waveform.range_cell_m / oversampling
    first = max(int(np.floor(range_span_m[0] / spacing)) - 1, 1)
    last = int(np.ceil(range_span_m[1] / spacing)) + 1
    return np.asarray(spacing * np.arange(first, last + 1), dtype=np.float64)


def hann(n: int) -> NDArray[np.float64]:
    """Hann window of length n without its zero ends."""
    return np.asarray(np.hanning(n + 2)[1:-1], dtype=np.float64)


def _starts(n_lines: int, length: int, spacing: float, step: float) -> NDArray[np.int64]:
    """First line of each sub-aperture: both ends reached, equal steps of at most `step`."""
    spare = n_lines - length
    n_steps = max(1, int(np.ceil(spare * spacing / step - 1e-9)))
    return np.unique(np.rint(np.linspace(0, spare, n_steps + 1)).astype(np.int64))


def _raster_images(
    pose: Pose,
    raster: Raster,
    waveform: Waveform,
    target: NDArray[np.float64],
    range_span_m: tuple[float, float],
    config: SubapertureConfig,
) -> Iterator[SubapertureImage]:
    wavenumber = 2.0 * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    ranges = _range_bins(waveform, range_span_m, config.range_oversampling)
    to_range = _range_transform(ranges, waveform)

    h_lines, v_lines = raster.horizontal_m, raster.vertical_m
    h_spacing, v_spacing = float(h_lines[1] - h_lines[0]), float(v_lines[1] - v_lines[0])
    n_h = max(2, min(round(config.size_m / h_spacing), len(h_lines)))
    n_v = max(2, min(round(config.size_m / v_spacing), len(v_lines)))
    window = np.outer(hann(n_h), hann(n_v))
    h_cosines, h_wraps = _cosines(h_spacing, waveform.center_wavelength_m, config)
    v_cosines, v_wraps = _cosines(v_spacing, waveform.center_wavelength_m, config)
    to_h = _direction_transform(h_cosines, _offsets(n_h, h_spacing), waveform)
    to_v = _direction_transform(v_cosines, _offsets(n_v, v_spacing), waveform)
    depth = float((pose.phase_centers @ pose.axes[0]).mean())

    for i in _starts(len(h_lines), n_h, h_spacing, config.step_m):
        for j in _starts(len(v_lines), n_v, v_spacing, config.step_m):
            index = raster.index[i : i + n_h, j : j + n_v]
            h_mid, v_mid = float(h_lines[i : i + n_h].mean()), float(v_lines[j : j + n_v].mean())
            center = np.array([depth, h_mid, v_mid]) @ pose.axes
            used = np.where(index >= 0, window, 0.0)
            delay = _focus_path(pose, index, center, target) + waveform.path_bias_m
            focus = np.exp(1j * wavenumber * delay[..., None]) * (used / used.sum())[..., None]
            samples = pose.signal[index] * focus.astype(np.complex64)
            profile = samples.reshape(-1, waveform.n_samples) @ to_range
            image = to_h @ profile.reshape(n_h, -1)
            image = to_v @ image.reshape(len(h_cosines), n_v, -1)
            yield SubapertureImage(
                magnitude=np.abs(image),
                center=center,
                horizontal_cosines=h_cosines,
                vertical_cosines=v_cosines,
                ranges_m=ranges,
                wraps=(h_wraps, v_wraps),
            )


def _cosines(
    spacing: float, wavelength: float, config: SubapertureConfig
) -> tuple[NDArray[np.float64], bool]:
    """Direction cosines of one image axis, and whether the raster makes them periodic."""
    pitch = wavelength / (config.size_m * config.direction_oversampling)
    unambiguous = wavelength / (4.0 * spacing)
    if unambiguous <= config.max_cosine:
        n = int(np.ceil(2.0 * unambiguous / pitch))
        return 2.0 * unambiguous * (np.arange(n) / n - 0.5), True
    half = int(np.ceil(config.max_cosine / pitch))
    return np.asarray(pitch * np.arange(-half, half + 1), dtype=np.float64), False


def _offsets(n_lines: int, spacing: float) -> NDArray[np.float64]:
    """Places of the lines of a sub-aperture about its middle [m]."""
    return np.asarray(spacing * (np.arange(n_lines) - 0.5 * (n_lines - 1)), dtype=np.float64)


def _range_transform(ranges: NDArray[np.float64], waveform: Waveform) -> NDArray[np.complex64]:
    """Hann-weighted exp(+j 4 pi f r / c), (n_samples, n_ranges)."""
    wavenumber = 2.0 * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    window = hann(waveform.n_samples)[:, None]
    transform = np.exp(2j * wavenumber[:, None] * ranges) * window / window.sum()
    return np.asarray(transform, dtype=np.complex64)


def _direction_transform(
    cosines: NDArray[np.float64], offsets: NDArray[np.float64], waveform: Waveform
) -> NDArray[np.complex64]:
    """exp(-j 4 pi u offset / lambda) at mid-band, (n_cosines, n_offsets)."""
    phase = 4.0 * np.pi / waveform.center_wavelength_m * np.outer(cosines, offsets)
    return np.asarray(np.exp(-1j * phase), dtype=np.complex64)


def _focus_path(
    pose: Pose,
    index: NDArray[np.int64],
    center: NDArray[np.float64],
    target: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Two-way path of each antenna to the focus, less that of the centre [m].

    The focus lies straight ahead of the sub-aperture, as far away as the target; exact for any
    baseline between transmitter and receiver, and for antennas off the plane.
    """
    look = pose.axes[0]
    focus_range = float((target - center) @ look)
    focus = center + focus_range * look
    path = np.linalg.norm(pose.tx_positions[index] - focus, axis=-1) + np.linalg.norm(
        pose.rx_positions[index] - focus, axis=-1
    )
    return np.asarray(path - 2.0 * focus_range)


def _irregular_images(
    pose: Pose,
    waveform: Waveform,
    target: NDArray[np.float64],
    range_span_m: tuple[float, float],
    config: SubapertureConfig,
) -> Iterator[SubapertureImage]:
    local = pose.phase_centers @ pose.axes.T
    depth = float(local[:, 0].mean())
    ranges = _range_bins(waveform, range_span_m, config.range_oversampling)
    # A spacing so fine that the directions do not wrap around.
    cosines, _ = _cosines(1e-6, waveform.center_wavelength_m, config)
    to_range = _range_transform(ranges, waveform)
    wavenumber = 2.0 * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S

    for h_mid in _centers(local[:, 1], config):
        for v_mid in _centers(local[:, 2], config):
            dh, dv = local[:, 1] - h_mid, local[:, 2] - v_mid
            inside = (np.abs(dh) < config.size_m / 2) & (np.abs(dv) < config.size_m / 2)
            if int(inside.sum()) < 16:  # fewer antennas form no image
                continue
            weight = (
                np.cos(np.pi * dh[inside] / config.size_m)
                * np.cos(np.pi * dv[inside] / config.size_m)
            ) ** 2
            center = np.array([depth, h_mid, v_mid]) @ pose.axes
            # One focus for all ranges, as on a raster: focused bin by bin, the peak of a curved
            # surface moves to where its wavefront fits better, 0.9 mm inwards on a 4 cm sphere.
            delay = _focus_path(pose, np.nonzero(inside)[0], center, target) + waveform.path_bias_m
            focus = np.exp(1j * wavenumber * delay[:, None]) * (weight / weight.sum())[:, None]
            profile = (pose.signal[inside] * focus.astype(np.complex64)) @ to_range
            to_h = _direction_transform(cosines, dh[inside], waveform)
            to_v = _direction_transform(cosines, dv[inside], waveform)
            magnitude = np.stack([np.abs((row * to_v) @ profile) for row in to_h])
            yield SubapertureImage(
                magnitude=magnitude,
                center=center,
                horizontal_cosines=cosines,
                vertical_cosines=cosines,
                ranges_m=ranges,
                wraps=(False, False),
            )


def _centers(values: NDArray[np.float64], config: SubapertureConfig) -> NDArray[np.float64]:
    low, high = float(values.min()), float(values.max())
    spare = high - low - config.size_m
    if spare <= 0.0:
        return np.array([0.5 * (low + high)])
    n_steps = max(1, int(np.ceil(spare / config.step_m)))
    return np.linspace(low + config.size_m / 2, high - config.size_m / 2, n_steps + 1)
