"""Focused images of small sub-apertures on a grid of range and direction.

The specular return of a smooth surface focuses on the surface only if the aperture is small
relative to the radius of curvature. Over a full plane it moves towards the centre of curvature
(docs/math/images.md#sub-aperture-images).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Interval
from scipy.ndimage import maximum_filter
from scipy.special import gammainccinv

from geraf2._bounds import ApertureM, Bounded
from geraf2._types import Array, Floats, Ints
from geraf2.ops.subaperture import CosineAxis, Lattice, SubapertureBins, Subapertures
from geraf2.scene import Pose, Waveform
from geraf2.scene.aperture import Aperture

# Largest sideways error of a raster's antennas, in wavelengths. The phase error, 4 pi u * offset
# for direction cosines u up to 0.3, stays below 4 pi 0.3 / 20 = 0.19 rad.
_RASTER_TOLERANCE_WAVELENGTHS = 0.05
# Largest share of empty raster points; they count as zeros.
_RASTER_MAX_HOLES = 0.05
MIN_ANTENNAS = 16
"""Least number of irregular antennas of a sub-aperture."""
# Side of a sub-aperture over that of a small plane, and the least of these sides [m].
_SIZE_SHARE, _MIN_SIZE_M = 0.5, 0.03
# Two directions are ambiguous if the power response of irregular antennas to their difference
# exceeds two limits. The first value is above the side lobes of windows. The second is the
# probability with which random positions exceed the other limit.
_ALIAS_POWER, _ALIAS_CHANCE = 0.01, 1e-6
# Number of sub-apertures of a pose whose response is examined.
_N_ALIAS_CUTS = 4


@dataclass(frozen=True, kw_only=True)
class SubapertureConfig(Bounded):
    """Size and sampling of the sub-aperture images."""

    size_m: ApertureM = 0.08
    """Side of a square sub-aperture [m], at most half the longer side of a plane. Smaller ones
    merge weak echoes, larger ones defocus curves."""
    step_m: ApertureM = 0.02
    """Step between sub-apertures [m], smaller where the side is; neighbours overlap by three
    quarters."""
    direction_oversampling: Annotated[float, Interval(gt=0.0, le=32.0)] = 3.0
    """Direction bins per wavelength / size_m, the two-way resolution of the sub-aperture."""
    max_cosine: Annotated[float, Interval(gt=0.0, lt=1.0)] = 0.6
    """Largest direction cosine imaged; less if directions are ambiguous to the antennas. Rasters
    are periodic in 2 x wavelength / (4 spacing)."""
    range_oversampling: Annotated[int, Interval(ge=1, le=32)] = 2
    """Range bins per range cell."""

    def for_planes(self, planes: Sequence[Aperture]) -> "SubapertureConfig":
        """Return the same for small planes: sub-apertures of at most half a plane's longer side.

        A plane then has at least five along that side, as labels need echoes that agree.
        """
        sides_m = [2.0 * float(plane.half_m.max()) for plane in planes]
        size_m = min(self.size_m, max(_MIN_SIZE_M, _SIZE_SHARE * float(np.median(sides_m))))
        return replace(self, size_m=size_m, step_m=self.step_m * (size_m / self.size_m))


@dataclass(frozen=True, kw_only=True, eq=False)
class Raster:
    """Antennas of a pose on a regular lattice along its horizontal and vertical axis."""

    index: Ints
    """Antenna index of each lattice point, -1 if empty, (n_horizontal, n_vertical)."""
    horizontal_m: Floats
    """Lattice coordinates along the pose's horizontal axis, (n_horizontal,) [m]."""
    vertical_m: Floats
    """Lattice coordinates along the pose's vertical axis, (n_vertical,) [m]."""


# Cached, as the search for the box images the same planes: a lattice takes half the time of one.
_RASTERS: WeakKeyDictionary[Pose, dict[float, Raster | None]] = WeakKeyDictionary()


def find_raster(pose: Pose, wavelength_m: float) -> Raster | None:
    """Lattice of the phase centres, or None if the positions are irregular."""
    known = _RASTERS.setdefault(pose, {})
    if wavelength_m not in known:
        known[wavelength_m] = _find_raster(pose, wavelength_m)
    return known[wavelength_m]


def _find_raster(pose: Pose, wavelength_m: float) -> Raster | None:
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


def _lattice(values: Floats, tolerance: float) -> tuple[Floats, Ints] | None:
    """Equally spaced lines through all values within the tolerance, and the line of each value."""
    ordered = np.sort(values)
    starts = np.flatnonzero(np.diff(ordered, prepend=-np.inf) > 2.0 * tolerance)
    centers = np.add.reduceat(ordered, starts) / np.diff(starts, append=len(ordered))
    if len(centers) < 2:
        return None
    spacing = float(np.median(np.diff(centers)))
    steps = np.rint((values - centers[0]) / spacing).astype(np.int64)
    n_lines = int(steps.max()) + 1
    if n_lines > 4 * len(centers) or n_lines < 2:
        return None
    start = float(np.mean(values - spacing * steps))
    residual = values - start - spacing * steps
    # Fit the spacing, since rounding errors in the file accumulate over a long line.
    slope = float(residual @ (steps - steps.mean())) / max(float(np.var(steps)) * len(steps), 1.0)
    spacing += slope
    start = float(np.mean(values - spacing * steps))
    if np.abs(values - start - spacing * steps).max() > tolerance:
        return None
    return np.asarray(start + spacing * np.arange(n_lines), dtype=np.float64), steps


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseImages:
    """Sub-apertures of a pose and the bins of their images."""

    pose: Pose
    waveform: Waveform
    subapertures: Subapertures
    centers: Floats
    """Centre of each sub-aperture in the frame, (n_subapertures, 3) [m]."""
    bins: SubapertureBins


def pose_images(
    pose: Pose,
    waveform: Waveform,
    target: Floats,
    range_span_m: tuple[float, float],
    config: SubapertureConfig,
) -> PoseImages:
    """Divide a pose into sub-apertures and define their images.

    pose: antennas on or near a plane; a raster is imaged in half the time.
    waveform: the chirp; its instrument delay is subtracted.
    target: point on which the near field is focused, (3,) [m].
    range_span_m: smallest and largest one-way distance to image [m].
    """
    raster = find_raster(pose, waveform.center_wavelength_m)
    if raster is None:
        cuts = _irregular_cuts(pose, waveform, config)
    else:
        cuts = _raster_cuts(pose, raster, waveform, config)
    normal = pose.axes[0]
    # Each sub-aperture is focused along its normal, at the distance of the target.
    focus_range = (target - cuts.centers) @ normal
    subapertures = Subapertures(
        offsets=np.concatenate([[0], np.cumsum([len(part) for part in cuts.antennas])]),
        antennas=_join(cuts.antennas, np.zeros(0, dtype=np.int64)),
        weights=_join(cuts.weights, np.zeros(0)),
        positions=_join(cuts.offsets, np.zeros((0, 2))),
        focus=cuts.centers + focus_range[:, None] * normal,
        focus_range_m=focus_range,
        lattice=cuts.lattice,
    )
    spacing = waveform.range_cell_m / config.range_oversampling
    first = max(int(np.floor(range_span_m[0] / spacing)) - 1, 1)
    last = int(np.ceil(range_span_m[1] / spacing)) + 1
    bins = SubapertureBins(
        horizontal=cuts.axes[0],
        vertical=cuts.axes[1],
        first_range_m=spacing * first,
        range_pitch_m=spacing,
        n_ranges=last - first + 1,
    )
    return PoseImages(
        pose=pose, waveform=waveform, subapertures=subapertures, centers=cuts.centers, bins=bins
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cuts:
    """Sub-apertures of a pose, one list entry each."""

    antennas: list[Ints]
    weights: list[Floats]
    offsets: list[Floats]
    centers: Floats
    lattice: Lattice | None
    axes: tuple[CosineAxis, CosineAxis]


def _join(parts: list[Array], nothing: Array) -> Array:
    return np.concatenate(parts) if parts else nothing


def hann(n: int) -> Floats:
    """Hann window of length n without its zero ends."""
    return np.asarray(np.hanning(n + 2)[1:-1], dtype=np.float64)


def _starts(n_lines: int, length: int, spacing: float, step: float) -> Ints:
    """First line of each sub-aperture: equal steps of at most `step` that include both ends."""
    spare = n_lines - length
    n_steps = max(1, int(np.ceil(spare * spacing / step - 1e-9)))
    return np.unique(np.rint(np.linspace(0, spare, n_steps + 1)).astype(np.int64))


def _raster_cuts(
    pose: Pose, raster: Raster, waveform: Waveform, config: SubapertureConfig
) -> _Cuts:
    h_lines, v_lines = raster.horizontal_m, raster.vertical_m
    h_spacing, v_spacing = float(h_lines[1] - h_lines[0]), float(v_lines[1] - v_lines[0])
    n_h = max(2, min(round(config.size_m / h_spacing), len(h_lines)))
    n_v = max(2, min(round(config.size_m / v_spacing), len(v_lines)))
    depth = float((pose.phase_centers @ pose.axes[0]).mean())

    antennas, weights, used_offsets, centers = [], [], [], []
    axes = _offsets(n_h, h_spacing), _offsets(n_v, v_spacing)
    offsets = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    window = np.outer(hann(n_h), hann(n_v))
    whole = window.ravel() / window.ravel().sum()
    starts = (
        _starts(len(h_lines), n_h, h_spacing, config.step_m),
        _starts(len(v_lines), n_v, v_spacing, config.step_m),
    )
    middles = (
        [float(h_lines[start : start + n_h].mean()) for start in starts[0]],
        [float(v_lines[start : start + n_v].mean()) for start in starts[1]],
    )
    for (i, j), middle in zip(product(*starts), product(*middles), strict=True):
        index = raster.index[i : i + n_h, j : j + n_v]
        filled = index >= 0
        is_whole = bool(filled.all())
        antennas.append(index.ravel() if is_whole else index[filled])
        weights.append(whole if is_whole else window[filled] / window[filled].sum())
        used_offsets.append(offsets.reshape(-1, 2) if is_whole else offsets[filled])
        centers.append((depth, *middle))
    return _Cuts(
        antennas=antennas,
        weights=weights,
        offsets=used_offsets,
        centers=np.asarray(centers, dtype=np.float64).reshape(-1, 3) @ pose.axes,
        lattice=Lattice(shape=(n_h, n_v), spacing_m=(h_spacing, v_spacing)),
        axes=(
            _cosines(h_spacing, waveform.center_wavelength_m, config),
            _cosines(v_spacing, waveform.center_wavelength_m, config),
        ),
    )


def _cosines(spacing: float, wavelength: float, config: SubapertureConfig) -> CosineAxis:
    """Direction cosines of one image axis, periodic for a coarse raster."""
    pitch = wavelength / (config.size_m * config.direction_oversampling)
    unambiguous = wavelength / (4.0 * spacing)
    if unambiguous <= config.max_cosine:
        n = int(np.ceil(2.0 * unambiguous / pitch))
        return CosineAxis.symmetric(n, 2.0 * unambiguous / n, wraps=True)
    return CosineAxis.symmetric(2 * int(np.ceil(config.max_cosine / pitch)) + 1, pitch, wraps=False)


def _offsets(n_lines: int, spacing: float) -> Floats:
    """Positions of the lines of a sub-aperture relative to its centre [m]."""
    return np.asarray(spacing * (np.arange(n_lines) - 0.5 * (n_lines - 1)), dtype=np.float64)


def _irregular_cuts(pose: Pose, waveform: Waveform, config: SubapertureConfig) -> _Cuts:
    local = pose.phase_centers @ pose.axes.T
    depth = float(local[:, 0].mean())
    antennas, weights, offsets, centers = [], [], [], []
    for middle in product(_centers(local[:, 1], config), _centers(local[:, 2], config)):
        offset = local[:, 1:] - middle
        inside = np.nonzero((np.abs(offset) < config.size_m / 2).all(axis=1))[0]
        if len(inside) < MIN_ANTENNAS:
            continue
        weight = np.prod(np.cos(np.pi * offset[inside] / config.size_m), axis=1) ** 2
        antennas.append(inside)
        weights.append(weight / weight.sum())
        offsets.append(offset[inside])
        centers.append((depth, *middle))
    limits = _alias_free(offsets, weights, waveform.center_wavelength_m, config)
    pitch = waveform.center_wavelength_m / (config.size_m * config.direction_oversampling)
    return _Cuts(
        antennas=antennas,
        weights=weights,
        offsets=offsets,
        centers=np.asarray(centers, dtype=np.float64).reshape(-1, 3) @ pose.axes,
        lattice=None,
        axes=(_up_to(limits[0], pitch), _up_to(limits[1], pitch)),
    )


def _up_to(limit: float, pitch: float) -> CosineAxis:
    """Direction cosines from -limit to limit in steps of at most a pitch."""
    n = int(np.ceil(limit / pitch))
    return CosineAxis.symmetric(2 * n + 1, limit / n, wraps=False)


def _alias_free(
    offsets: list[Floats], weights: list[Floats], wavelength: float, config: SubapertureConfig
) -> tuple[float, float]:
    """Largest direction cosines without ambiguous directions, for irregular antennas.

    Directions u and u + s give a sub-aperture the same signals if its response
    |sum_a w_a exp(-2 j k s . delta_a)| is 1. It is near 1 at the period of a jittered or incomplete
    raster, and by chance for random positions (docs/math/images.md#sub-aperture-images).
    """
    reach = 2.0 * config.max_cosine  # the largest difference within the limits
    chosen = np.unique(
        np.linspace(0, len(offsets) - 1, min(len(offsets), _N_ALIAS_CUTS)).astype(int)
    )
    # Half the resolution of the window.
    step = wavelength / (2.0 * config.size_m)
    n = int(np.ceil(reach / step))
    v: Floats = step * np.arange(-n, n + 1, dtype=np.float64)
    h = v[n:]
    power, chance, lobe = np.zeros((len(h), len(v))), 0.0, np.zeros(2)
    for offset, weight in ((offsets[i], weights[i].astype(np.float32)) for i in chosen):
        phases = (
            np.outer(s, x) * (4.0 * np.pi / wavelength)
            for s, x in zip((h, v), offset.T, strict=True)
        )
        waves_h, waves_v = (np.exp(-1j * phase).astype(np.complex64) for phase in phases)
        power += np.abs((waves_h * weight) @ waves_v.T) ** 2
        chance += float(weight @ weight)
        lobe = np.maximum(lobe, 2.0 * wavelength / np.maximum(np.ptp(offset, axis=0), wavelength))
    by_chance = chance * gammainccinv(max(len(chosen), 1), _ALIAS_CHANCE) / max(len(chosen), 1)
    ambiguous = power > max(by_chance, _ALIAS_POWER * len(chosen))
    ambiguous &= power == maximum_filter(power, 3, mode="nearest")
    ambiguous &= (h[:, None] > lobe[0]) | (np.abs(v) > lobe[1])
    at = np.nonzero(ambiguous)
    return _largest_rectangle(h[at[0]], np.abs(v[at[1]]), reach)


def _largest_rectangle(h: Floats, v: Floats, reach: float) -> tuple[float, float]:
    """Half sides of the largest rectangle with a corner at zero that contains no point."""
    sides = [
        (side, float(v[h < side].min(initial=reach)))
        for side in {reach, *(min(x, reach) for x in h[h > 0.0].tolist())}
    ]
    side_h, side_v = max(sides, key=lambda pair: (pair[0] * pair[1], pair))
    return 0.5 * side_h, 0.5 * side_v


def _centers(values: Floats, config: SubapertureConfig) -> Floats:
    low, high = float(values.min()), float(values.max())
    spare = high - low - config.size_m
    if spare <= 0.0:
        return np.array([0.5 * (low + high)])
    n_steps = max(1, int(np.ceil(spare / config.step_m)))
    return np.linspace(low + config.size_m / 2, high - config.size_m / 2, n_steps + 1)
