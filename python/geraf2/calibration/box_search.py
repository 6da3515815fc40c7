"""Search for the box of a scan by its walls' flashes: a cuboid of any yaw, size and position.

A flat wall returns a flash along its normal, from the foot of the perpendicular, so each such peak
defines a plane. Planes at right angles form the box; those of the content lie inside
(docs/math/calibration.md#box-from-the-scan).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from geraf2._types import Bools, Floats, Ints
from geraf2.calibration.wall_echoes import UNKNOWN_MIDDLES_M
from geraf2.geometry.transforms import triple
from geraf2.imaging.peaks import KeptPeaks, PeakSet, grating_lobes
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import Capture, LosPrior

# Half as many sub-apertures and directions as for glints, in a fifth of the time.
_COARSE = SubapertureConfig(step_m=0.04, direction_oversampling=2.0)
# Side of the imaged region over the planes' distance, larger than any box between them.
_REGION = 1.3
# Largest angle between a flash and its wall's normal, by noise and the slopes of a bulge [rad].
_MAX_ANGLE_RAD = 0.06
_YAW_STEP_RAD = np.deg2rad(0.5)
# An expected yaw is preferred within this angle, if it has this share of the highest score.
_LIKE_RAD, _LIKE_SHARE = np.deg2rad(4.0), 0.7
# Standard deviation of the flashes of one wall, which may bulge by 1 to 3 mm.
_OFFSET_STEP_M, _OFFSET_SIGMA_M = 0.001, 0.0025
# Least strength of a wall relative to the strongest flash; flashes of content are 20 dB stronger.
_WEAKEST_DB = -15.0
# Least density relative to the densest plane of a direction; side lobes have less.
_LEAST_SHARE = 0.25
# Leakage, or a reflector that moves with the antennas: largest angle to the looking direction
# [rad], range tolerance [m], least share and number of planes with the same range.
_BROADSIDE, _SAME_RANGE_M, _LEAKING_SHARE, _LEAKING_PLANES = 0.03, 0.003, 0.7, 5
LEAST_SIDE_M = 0.04
"""Least side length of a box [m]."""
# Least cosine between a direction and the looking direction.
_LEAST_AHEAD = 0.8


def scene_peaks(center_m: Floats, reach_m: float, num_threads: int | None) -> KeptPeaks:
    """Coarse peaks of everything between planes at the distance reach_m from center_m [m]."""
    region = LosPrior.from_box((_REGION * reach_m,) * 3, triple(center_m))
    return KeptPeaks(region, _COARSE, num_threads=num_threads)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flashes:
    """Planes whose specular return a peak may be, seen from the front or from behind."""

    normals: Floats
    """Outward unit normals, (n, 3)."""
    offsets_m: Floats
    """Offset of the outer face along the normal, from the origin, (n,) [m]."""
    far: Bools
    """Whether it is a far wall, seen from behind through the box, (n,)."""
    weights: Floats
    """Square root of the reflectivity of a large flat wall, up to a factor, (n,)."""

    @classmethod
    def of(cls, peaks: PeakSet) -> "Flashes":
        """Both interpretations of each peak, as a near and as a far wall."""
        along = np.einsum("ij,ij->i", peaks.centers, peaks.directions)
        (near_m, _), (far_m, _) = UNKNOWN_MIDDLES_M
        near = near_m - along - peaks.ranges_m
        far = far_m + along + peaks.ranges_m
        weights = np.sqrt(peaks.strengths)
        return cls(
            normals=np.concatenate([-peaks.directions, peaks.directions]),
            offsets_m=np.concatenate([near, far]),
            far=np.repeat([False, True], len(peaks)),
            weights=np.tile(weights, 2),
        )

    def along(self, direction: Floats) -> "Flashes":
        """Flashes of walls with this outward normal, (3,)."""
        keep = self.normals @ direction > np.cos(_MAX_ANGLE_RAD)
        return Flashes(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


def with_lobes(capture: Capture, peaks: PeakSet) -> tuple[PeakSet, Ints]:
    """Add the grating lobes of each peak, and return the index of the peak of each direction."""
    parts, index = [peaks], [np.arange(len(peaks))]
    for number in np.unique(peaks.planes):
        own = np.flatnonzero(peaks.planes == number)
        periods = peaks.periods[peaks.subapertures[own[0]]]
        axes = capture.poses[number].axes
        for directions in grating_lobes(peaks.directions[own], axes, periods):
            known = np.isfinite(directions).all(axis=1) & (directions @ axes[0] > _LEAST_AHEAD)
            if known.any():
                index.append(own[known])
                parts.append(replace(peaks.select(own[known]), directions=directions[known]))
    chosen = np.concatenate(index)
    directions = np.concatenate([part.directions for part in parts])
    return replace(peaks.select(chosen), directions=directions), chosen


def without_lobes(
    peaks: PeakSet, lobes: PeakSet, index: Ints, rough: "RoughFaces"
) -> tuple[PeakSet, Bools]:
    """Peaks in the direction of a wall's flash, and mask of those that are a flash.

    lobes, index: from `with_lobes`.
    """
    flashes = Flashes.of(lobes)
    deviation = np.full(len(flashes.offsets_m), np.inf)
    for k, side in np.ndindex(3, 2):
        normal = rough.axes[k] * (1.0 if side else -1.0)
        along = flashes.normals @ normal > np.cos(_MAX_ANGLE_RAD)
        found = np.abs(flashes.offsets_m - rough.offsets_m[k, side])
        deviation = np.where(
            along & (found < 3.0 * _OFFSET_SIGMA_M), np.minimum(deviation, found), deviation
        )
    deviation = deviation.reshape(2, -1).min(axis=0)  # each lobe as a near and as a far wall
    order = np.lexsort((deviation, index))
    first = order[np.unique(index[order], return_index=True)[1]]
    is_flash = np.isfinite(deviation[first])
    best = np.where(is_flash, first, np.arange(len(peaks)))
    return replace(peaks, directions=lobes.directions[best]), is_flash


def leaking(capture: Capture, peaks: PeakSet) -> Bools:
    """Mask of peaks in the looking direction at a range that most planes share, (n_peaks,)."""
    ahead = np.stack([pose.axes[0] for pose in capture.poses])[peaks.planes]
    broadside = np.einsum("ij,ij->i", ahead, peaks.directions) > np.cos(_BROADSIDE)
    found = np.zeros(len(peaks), dtype=bool)
    index = np.flatnonzero(broadside)
    ranges, planes = peaks.ranges_m[index], peaks.planes[index]
    n_planes = len(np.unique(peaks.planes))
    least = max(_LEAKING_PLANES, _LEAKING_SHARE * n_planes)
    for middle in np.unique(np.rint(ranges / _SAME_RANGE_M)) * _SAME_RANGE_M:
        same = np.abs(ranges - middle) < _SAME_RANGE_M
        if len(np.unique(planes[same])) >= least:
            found[index[same]] = True
    return found


def upward(capture: Capture) -> Floats:
    """Axis of the capture's frame nearest to the planes' vertical axes, (3,)."""
    mean = np.mean([pose.axes[2] for pose in capture.poses if pose.n_antennas], axis=0)
    nearest = int(np.abs(mean).argmax())
    return np.asarray(np.eye(3)[nearest] * np.sign(mean[nearest]))


def _profile(offsets_m: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Density of planes over their offset, and its sampling positions [m]."""
    reach = float(np.abs(offsets_m).max(initial=0.0)) + 0.02
    cells = ((offsets_m + reach) / _OFFSET_STEP_M).astype(np.int64)
    counts = np.bincount(cells, weights, int(2.0 * reach / _OFFSET_STEP_M) + 1)
    middles = np.asarray(_OFFSET_STEP_M * (np.arange(len(counts)) + 0.5) - reach)
    return np.asarray(gaussian_filter1d(counts, _OFFSET_SIGMA_M / _OFFSET_STEP_M)), middles


def find_axes(flashes: Flashes, up: Floats, like: Floats | None = None) -> Floats:
    """Axes of the box, at the yaw with the densest planes on the four sides, (3, 3).

    like: axes that are preferred if nearly as many planes agree, (3, 3).
    """
    first = np.abs(np.roll(up, 1))
    second = np.cross(up, first)
    level = np.abs(flashes.normals @ up) < np.sin(_MAX_ANGLE_RAD)
    yaw = np.arctan2(flashes.normals[level] @ second, flashes.normals[level] @ first)
    offsets, weights = flashes.offsets_m[level], flashes.weights[level]
    steps = np.arange(0.0, 0.5 * np.pi, _YAW_STEP_RAD)
    scores = np.zeros(len(steps))
    for number, step in enumerate(steps):
        quarter = np.rint((yaw - step) / (0.5 * np.pi))
        deviation = yaw - step - 0.5 * np.pi * quarter
        share = np.maximum(1.0 - (deviation / _MAX_ANGLE_RAD) ** 2, 0.0)
        for side in range(4):
            own = (quarter % 4 == side) & (share > 0.0)
            if own.any():
                scores[number] += _profile(offsets[own], (weights * share)[own])[0].max()
    if like is not None:
        side_axis = like[int(np.abs(like @ up).argmin())]
        deviation = steps - np.arctan2(side_axis @ second, side_axis @ first)
        near = np.abs(deviation - 0.5 * np.pi * np.rint(deviation / (0.5 * np.pi))) < _LIKE_RAD
        if scores[near].max() > _LIKE_SHARE * scores.max():
            scores = np.where(near, scores, 0.0)
    yaw_rad = float(steps[int(scores.argmax())])
    # Four yaws describe the same box: choose the nearest to the frame's axes.
    yaw_rad -= 0.5 * np.pi * (yaw_rad > 0.25 * np.pi)
    x = np.cos(yaw_rad) * first + np.sin(yaw_rad) * second
    return np.stack([x, np.cross(up, x), up])


@dataclass(frozen=True, kw_only=True, eq=False)
class RoughFaces:
    """Planes of a cuboid from flashes."""

    axes: Floats
    """Unit vectors in rows, (3, 3)."""
    offsets_m: Floats
    """Offsets of the faces against and along each axis, outward, (3, 2) [m]; NaN: unseen."""
    strength: float
    """Weight of the strongest flash of these faces, as in `Flashes`."""

    @property
    def mean_m(self) -> float:
        """Mean of the offsets; -inf without any [m]."""
        known = self.offsets_m[np.isfinite(self.offsets_m)]
        return float(known.mean()) if len(known) else -np.inf


def rough_faces(flashes: Flashes, axes: Floats) -> RoughFaces:
    """Outermost strong planes along the axes around the origin, near walls before far ones."""
    offsets = np.full((3, 2), np.nan)
    own = [[flashes.along(sign * axis) for sign in (-1.0, 1.0)] for axis in axes]
    top = max((float(f.weights.max(initial=0.0)) for pair in own for f in pair), default=0.0)
    least = top * 10.0 ** (_WEAKEST_DB / 40.0)
    for far in (False, True):
        for k, side in np.argwhere(np.isnan(offsets)):
            planes = own[k][side]
            # Each near wall's flash is also interpreted as a far wall, beyond the origin.
            kind = (planes.far == far) & (planes.offsets_m > 0.5 * LEAST_SIDE_M)
            found = _outermost(planes, kind, least)
            if found is not None:
                offsets[k, side] = found
    return RoughFaces(axes=axes, offsets_m=offsets, strength=top)


def _outermost(planes: Flashes, kind: Bools, least: float) -> float | None:
    """Offset of the outermost plane with a strong flash [m]."""
    offsets, weights = planes.offsets_m[kind], planes.weights[kind]
    for position, members in densest_planes(offsets, weights, _LEAST_SHARE):
        if (weights[members] > least).any():
            return position
    return None


def densest_planes(
    offsets_m: Floats, weights: Floats, least_share: float = 0.0
) -> Iterator[tuple[float, Ints]]:
    """Positions of the density's maxima, the outermost first, and the indices of their members.

    least_share: least density relative to the largest.
    """
    if not len(offsets_m):
        return
    density, middles = _profile(offsets_m, weights)
    peaks = 1 + np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:]))
    for peak in peaks[::-1]:
        near = np.flatnonzero(np.abs(offsets_m - middles[peak]) < 2.0 * _OFFSET_SIGMA_M)
        if len(near) and density[peak] >= least_share * density.max():
            yield float(np.average(offsets_m[near], weights=weights[near])), near
