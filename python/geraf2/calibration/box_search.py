"""The box of a scan, found from the flashes of its walls: a cuboid of any yaw, size and position.

A flat wall answers where it is seen along its normal, at the foot of the perpendicular: each such
peak is a plane. Planes at right angles make the box; the content's lie inside
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

# Half as many sub-apertures and directions as glints need: a fifth of the time.
_COARSE = SubapertureConfig(step_m=0.04, direction_oversampling=2.0)
# The region that is imaged, over the distance of the planes: a box within them is smaller.
_REGION = 1.3
# Direction of a flash against the wall's normal: 0.6 degrees of noise, and a bulge's slopes.
_MAX_ANGLE_RAD = 0.06
_YAW_STEP_RAD = np.deg2rad(0.5)
# A yaw that is expected wins within this, if it has this share of the densest planes.
_LIKE_RAD, _LIKE_SHARE = np.deg2rad(4.0), 0.7
# Flashes of one wall lie within this; bulges of 1 to 3 mm, and near and far are 3 mm apart.
_OFFSET_STEP_M, _OFFSET_SIGMA_M = 0.001, 0.0025
# Walls of one box reflect alike; content may hide a part, and its own flashes be 20 dB stronger.
_WEAKEST_DB = -15.0
# Of the strongest plane of a direction: less is a side lobe before the wall.
_LEAST_SHARE = 0.25
# The same range ahead of so many planes: leakage, or a reflector that moves with the antennas.
_BROADSIDE, _SAME_RANGE_M, _LEAKING_SHARE, _LEAKING_PLANES = 0.03, 0.003, 0.7, 5
LEAST_SIDE_M = 0.04
"""Of a box."""
# Cosine to the viewing axis of the directions that are considered.
_LEAST_AHEAD = 0.8


def scene_peaks(center_m: Floats, reach_m: float, num_threads: int | None) -> KeptPeaks:
    """Coarse peaks of all that stands between planes, reach_m from their common point [m]."""
    region = LosPrior.from_box((_REGION * reach_m,) * 3, triple(center_m))
    return KeptPeaks(region, _COARSE, num_threads=num_threads)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flashes:
    """Planes that peaks may be the specular return of, each from before and from behind."""

    normals: Floats
    """Outward, (n, 3)."""
    offsets_m: Floats
    """Of the outer face along the normal, from the origin, (n,) [m]."""
    far: Bools
    """Seen from behind, through the box, (n,)."""
    weights: Floats
    """Root of the reflectivity of a large flat wall with this echo, up to a factor, (n,)."""

    @classmethod
    def of(cls, peaks: PeakSet) -> "Flashes":
        """Both readings of each peak; a coarse raster's have some in each possible direction."""
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
        """Those of walls with this outward normal, (3,)."""
        keep = self.normals @ direction > np.cos(_MAX_ANGLE_RAD)
        return Flashes(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


def with_lobes(capture: Capture, peaks: PeakSet) -> tuple[PeakSet, Ints]:
    """Peaks in every direction that looks the same to the raster, and which peak each is of."""
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
    """Peaks in the direction in which they are a wall's flash, and which are one.

    lobes, index: as of `with_lobes`.
    """
    flashes = Flashes.of(lobes)
    off = np.full(len(flashes.offsets_m), np.inf)
    for k, side in np.ndindex(3, 2):
        normal = rough.axes[k] * (1.0 if side else -1.0)
        along = flashes.normals @ normal > np.cos(_MAX_ANGLE_RAD)
        found = np.abs(flashes.offsets_m - rough.offsets_m[k, side])
        off = np.where(along & (found < 3.0 * _OFFSET_SIGMA_M), np.minimum(off, found), off)
    off = off.reshape(2, -1).min(axis=0)  # each lobe once from before and once from behind
    order = np.lexsort((off, index))
    first = order[np.unique(index[order], return_index=True)[1]]
    is_flash = np.isfinite(off[first])
    best = np.where(is_flash, first, np.arange(len(peaks)))
    return replace(peaks, directions=lobes.directions[best]), is_flash


def leaking(capture: Capture, peaks: PeakSet) -> Bools:
    """Peaks ahead of the antennas at a range that most planes share, (n_peaks,)."""
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
    """Density of planes over their offset, and its positions [m]."""
    reach = float(np.abs(offsets_m).max(initial=0.0)) + 0.02
    cells = ((offsets_m + reach) / _OFFSET_STEP_M).astype(np.int64)
    counts = np.bincount(cells, weights, int(2.0 * reach / _OFFSET_STEP_M) + 1)
    middles = np.asarray(_OFFSET_STEP_M * (np.arange(len(counts)) + 0.5) - reach)
    return np.asarray(gaussian_filter1d(counts, _OFFSET_SIGMA_M / _OFFSET_STEP_M)), middles


def find_axes(flashes: Flashes, up: Floats, like: Floats | None = None) -> Floats:
    """Axes at whose yaw the four sides have the densest planes, (3, 3).

    like: axes that are preferred where nearly as many planes agree, (3, 3).
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
        off = yaw - step - 0.5 * np.pi * quarter
        share = np.maximum(1.0 - (off / _MAX_ANGLE_RAD) ** 2, 0.0)
        for side in range(4):
            own = (quarter % 4 == side) & (share > 0.0)
            if own.any():
                scores[number] += _profile(offsets[own], (weights * share)[own])[0].max()
    if like is not None:
        side_axis = like[int(np.abs(like @ up).argmin())]
        off = steps - np.arctan2(side_axis @ second, side_axis @ first)
        near = np.abs(off - 0.5 * np.pi * np.rint(off / (0.5 * np.pi))) < _LIKE_RAD
        if scores[near].max() > _LIKE_SHARE * scores.max():
            scores = np.where(near, scores, 0.0)
    yaw_rad = float(steps[int(scores.argmax())])
    # The nearest to the frame's axes of four that are the same box.
    yaw_rad -= 0.5 * np.pi * (yaw_rad > 0.25 * np.pi)
    x = np.cos(yaw_rad) * first + np.sin(yaw_rad) * second
    return np.stack([x, np.cross(up, x), up])


@dataclass(frozen=True, kw_only=True, eq=False)
class RoughFaces:
    """Planes of a cuboid that flashes show."""

    axes: Floats
    """Rows, unit, (3, 3)."""
    offsets_m: Floats
    """Of the faces against and along each axis, outward from the origin, (3, 2); NaN: unseen."""
    strength: float
    """Weight of the strongest flash of these faces, as of `Flashes`."""

    @property
    def mean_m(self) -> float:
        """Mean of the offsets; -inf where there is none [m]."""
        known = self.offsets_m[np.isfinite(self.offsets_m)]
        return float(known.mean()) if len(known) else -np.inf


def rough_faces(flashes: Flashes, axes: Floats) -> RoughFaces:
    """Outermost strong planes along the axes, near ones first; the origin lies within them."""
    offsets = np.full((3, 2), np.nan)
    own = [[flashes.along(sign * axis) for sign in (-1.0, 1.0)] for axis in axes]
    top = max((float(f.weights.max(initial=0.0)) for pair in own for f in pair), default=0.0)
    least = top * 10.0 ** (_WEAKEST_DB / 40.0)
    for far in (False, True):
        for k, side in np.argwhere(np.isnan(offsets)):
            planes = own[k][side]
            # Each flash of a near wall is a far wall's, too, beyond the origin.
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
    """Positions at which offsets are densest, the outermost first, and which lie there.

    least_share: of the largest density; others are left out.
    """
    if not len(offsets_m):
        return
    density, middles = _profile(offsets_m, weights)
    peaks = 1 + np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:]))
    for peak in peaks[::-1]:
        near = np.flatnonzero(np.abs(offsets_m - middles[peak]) < 2.0 * _OFFSET_SIGMA_M)
        if len(near) and density[peak] >= least_share * density.max():
            yield float(np.average(offsets_m[near], weights=weights[near])), near
