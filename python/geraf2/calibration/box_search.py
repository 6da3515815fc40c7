"""Planes of a box's walls, from peaks of a scan.

A flat wall that antennas face squarely returns a flash along its normal, from the front or through
the box from behind. Hypotheses of a cuboid are compared by how many sub-apertures have its flashes
(docs/math/calibration.md#box-from-the-scan).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.flashes import (
    ANGLE_SIGMA_RAD,
    MAX_ANGLE_RAD,
    OFFSET_SIGMA_M,
    OVERLAP,
    WallMiddles,
    find_flashes,
)
from geraf2.echoes.wall_faces import WallFaces
from geraf2.geometry.transforms import triple
from geraf2.imaging.peaks import REACH_M, KeptPeaks, PeakSet, grating_lobes
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import Capture, LosPrior

COARSE = SubapertureConfig(step_m=0.04, direction_oversampling=2.0)
"""Half as many sub-apertures and directions as for glints, in a fifth of the time: walls have
hundreds of echoes."""
# Side of the imaged region over the planes' distance, larger than any box between them.
_REGION = 1.3
OFFSET_STEP_M = 0.5 * OFFSET_SIGMA_M
"""Grid of a wall's offset [m]."""
# Grid of a wall's level, standard deviation among walls of one box, and number of levels below the
# strongest peak [dB].
LEVEL_STEP_DB, _LEVEL_SIGMA_DB, N_LEVELS = 2.0, 4.0, 20
LOWEST_DB, LOWEST_PAIR_DB = -22.0, -32.0
"""Lowest levels of walls, and of those whose faces cancel [dB]: flat metal is 18 dB stronger."""
MAX_SHIFT_M = 0.024
"""Largest error of the recorded delay, one-way [m]."""
MAX_SHIFT = round(MAX_SHIFT_M / OFFSET_STEP_M)
"""The same in steps of the offset."""
# Log-likelihood ratio of a flash on its wall against clutter, whose density is uniform over ranges
# and directions [nats]. Counts below are in flashes, of which four overlap.
_FLASH_NATS = 7.0
NATS = _FLASH_NATS / OVERLAP
"""Log-likelihood ratio of one counted flash [nats]."""
# Loss of a sub-aperture that faces a wall without a flash: a detection probability of 0.88.
_MISS = 0.3
FACING_COSINE = 0.98
"""Least cosine between a wall's normal and the looking direction of antennas that face it."""
# Largest distance of the foot on such a wall from the middle of the scan [m], which the smallest
# boxes exceed.
_FOOT_M = 0.06
# Leakage, or a reflector that moves with the antennas: least share of planes with the same range;
# four planes may face four walls.
_LEAKING_SHARE = 0.7
MIN_SIDE_M = 0.04
"""Least side length of a box [m]."""
MIN_REACH_M = 0.5 * MIN_SIDE_M + 2.0 * MAX_SHIFT_M + OFFSET_STEP_M
"""Least distance of the planes: the smallest box at the largest error of the delay [m]."""
# Least cosine between a direction and the looking direction.
_MIN_AHEAD = 0.8


def scene_peaks(
    center_m: Floats, reach_m: float, num_threads: int | None, farther_m: float = 0.0
) -> KeptPeaks:
    """Coarse peaks of everything between planes at the distance reach_m from center_m [m].

    farther_m: by which an unknown delay may move echoes away from the antennas, one-way [m].
    """
    region = LosPrior.from_box((_REGION * reach_m,) * 3, triple(center_m))
    near, far = REACH_M
    return KeptPeaks(region, COARSE, reach_m=(near, far + farther_m), num_threads=num_threads)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flashes:
    """Planes whose specular return a peak may be, seen from the front or from behind."""

    normals: Floats
    """Outward unit normals, (n, 3)."""
    offsets_m: Floats
    """Offset of the outer face along the normal, from the origin, (n,) [m]."""
    far: Bools
    """Whether it is a far wall, seen from behind through the box, (n,)."""
    levels_db: Floats
    """Strength relative to the strongest; a flat wall's is that of its reflectivity, (n,)."""
    weights: Floats
    """1, or less for one of several directions of a peak, (n,)."""
    subapertures: Ints
    """Sub-aperture of the peak, (n,)."""
    centers: Floats
    """Centre of each sub-aperture, (n_subapertures, 3) [m]."""
    ahead: Floats
    """Looking direction of each sub-aperture, (n_subapertures, 3)."""
    loss_shift_m: float
    """Part of the offsets by which a loss in the walls moves a single peak [m]."""

    @classmethod
    def of(cls, capture: Capture, peaks: PeakSet, lobes: PeakSet, index: Ints) -> "Flashes":
        """Both interpretations, as a near and as a far wall, of each peak in each direction.

        lobes, index: from `with_lobes`.
        """
        along = np.einsum("ij,ij->i", lobes.centers, lobes.directions)
        middles = WallMiddles.of(capture.walls, capture.waveform)
        near_m, far_m = middles.depths_m
        level = 20.0 * np.log10(lobes.strengths / lobes.strengths.max(initial=1e-300))
        n_directions = np.bincount(index, minlength=len(peaks))[index]
        weight = np.maximum(1.0 - np.log(n_directions) / _FLASH_NATS, 0.0)
        return cls(
            normals=np.concatenate([-lobes.directions, lobes.directions]),
            offsets_m=np.concatenate(
                [near_m - along - lobes.ranges_m, along + lobes.ranges_m - far_m]
            ),
            far=np.repeat([False, True], len(lobes)),
            levels_db=np.tile(level, 2),
            weights=np.tile(weight, 2),
            subapertures=np.tile(lobes.subapertures, 2),
            centers=peaks.subaperture_centers,
            ahead=np.stack([pose.axes[0] for pose in capture.poses])[peaks.subaperture_planes],
            loss_shift_m=middles.loss_shift_m,
        )

    def counts(self, normal: Floats, n_offsets: int, margin: int = 0) -> tuple["Counts", "Counts"]:
        """Flashes of near and of far walls with this outward normal, (3,).

        margin: further offsets at both ends.
        """
        cosine = self.normals @ normal
        n_offsets += 2 * margin
        own = np.flatnonzero(cosine > np.cos(MAX_ANGLE_RAD))
        offsets_m = self.offsets_m[own] + margin * OFFSET_STEP_M
        inside = (offsets_m > 0.0) & (offsets_m < n_offsets * OFFSET_STEP_M)
        own, offsets_m = own[inside], offsets_m[inside]
        angle = np.arccos(np.clip(cosine[own], -1.0, 1.0))
        weights = self.weights[own] * (1.0 - (angle / MAX_ANGLE_RAD) ** 2)
        across = self.centers - np.outer(self.centers @ normal, normal)
        is_near = np.linalg.norm(across, axis=1) < _FOOT_M
        toward = self.ahead @ normal
        found = []
        for far, facing in ((False, toward < -FACING_COSINE), (True, toward > FACING_COSINE)):
            kind = self.far[own] == far
            density = self.density(own[kind], offsets_m[kind], weights[kind], n_offsets)
            found.append(Counts(density, int((is_near & facing).sum())))
        return found[0], found[1]

    def walls_beside(self, sides: Floats) -> tuple[int, int]:
        """Count sub-apertures with flashes of walls along and beside these sides.

        Board of any shape answers from the front and, through the box, from behind with one normal,
        one offset and one level; metal does not answer from behind. The error of the delay is the
        one at which most flashes have such a partner.

        sides: outward normals of a cuboid, or of some of its sides, (n, 3).
        """
        ahead = np.einsum("ij,ij->i", self.ahead[self.subapertures], self.normals)
        usable = (np.abs(ahead) > FACING_COSINE) & (self.levels_db > LOWEST_DB)
        near, far = (np.flatnonzero(usable & (self.far == kind)) for kind in (False, True))
        best = (0, 0)
        for shift in range(-MAX_SHIFT, MAX_SHIFT + 1, 2) if len(near) and len(far) else ():
            moved = self.offsets_m + shift * OFFSET_STEP_M * np.where(self.far, -1.0, 1.0)
            scaled = np.column_stack(
                [
                    self.normals / (2.0 * ANGLE_SIGMA_RAD),
                    moved / (2.0 * OFFSET_SIGMA_M),
                    self.levels_db / (2.0 * _LEVEL_SIGMA_DB),
                ]
            )
            distances, _ = KDTree(scaled[far]).query(scaled[near])
            found = near[(distances < 1.0) & (moved[near] > 0.5 * MIN_SIDE_M)]
            along = (self.normals[found] @ sides.T > np.cos(MAX_ANGLE_RAD)).any(axis=1)
            own = set(self.subapertures[found[along]])
            # Grating lobes of a side's flash lie beside it.
            others = set(self.subapertures[found[~along]]) - own
            best = max(best, (len(own), len(others)), key=sum)
        return best

    def density(self, own: Ints, offsets_m: Floats, weights: Floats, n_offsets: int) -> Floats:
        """Smoothed count over offset and level, one flash of each sub-aperture in a few cells."""
        offset = (offsets_m / OFFSET_STEP_M).astype(np.int64)
        level = (self.levels_db[own] / LEVEL_STEP_DB).astype(np.int64) + N_LEVELS - 1
        level = np.maximum(level, 0)
        cell = (self.subapertures[own] * n_offsets + offset // 4) * N_LEVELS + level // 4
        order = np.lexsort((-weights, cell))
        first = order[np.diff(cell[order], prepend=-1) > 0]
        shape = n_offsets, N_LEVELS
        count = np.bincount(
            (offset * N_LEVELS + level)[first], weights[first], n_offsets * N_LEVELS
        )
        widths = OFFSET_SIGMA_M / OFFSET_STEP_M, _LEVEL_SIGMA_DB / LEVEL_STEP_DB
        smooth = gaussian_filter(count.reshape(shape), widths, mode="constant")
        return np.asarray(2.0 * np.pi * widths[0] * widths[1] * smooth)


@dataclass(frozen=True, eq=False)
class Counts:
    """Flashes of walls with one normal, from one side."""

    density: Floats
    """Count over offset and level, (n_offsets, n_levels)."""
    n_facing: int
    """Number of sub-apertures that face such a wall."""
    _scores: dict[int, Floats] = field(default_factory=dict)

    def score(self, pair: int) -> Floats:
        """Count of flashes less missed ones, (n_offsets, n_levels).

        pair: half the distance of a wall's two echoes, in cells; 0 for a single one.
        """
        if pair not in self._scores:
            self._scores[pair] = self._without_missed(self._count(pair), pair)
        return self._scores[pair]

    def largest(self, pair: int) -> Floats:
        """Largest score over the offsets, (n_levels,): scores grow with the count."""
        return self._without_missed(self._count(pair).max(axis=0), pair)

    def _count(self, pair: int) -> Floats:
        if not pair:
            return self.density
        return 2.0 * np.minimum(shifted(self.density, pair), shifted(self.density, -pair))

    def _without_missed(self, count: Floats, pair: int) -> Floats:
        expected = 2 * self.n_facing if pair else self.n_facing
        usual = 0.75  # mean weight of a flash by its angle
        return np.maximum(count - _MISS * np.maximum(expected - count / usual, 0.0), 0.0)


def shifted(values: Floats, cells: int) -> Floats:
    """Values moved along the first axis by a number of cells, zero beyond the ends."""
    moved = np.zeros_like(values)
    low, high = max(cells, 0), len(values) + min(cells, 0)
    moved[low:high] = values[low - cells : high - cells]
    return moved


def with_lobes(capture: Capture, peaks: PeakSet) -> tuple[PeakSet, Ints]:
    """Add the grating lobes of each peak, and return the index of the peak of each direction."""
    parts, index = [peaks], [np.arange(len(peaks))]
    for number in np.unique(peaks.planes):
        own = np.flatnonzero(peaks.planes == number)
        periods = peaks.periods[peaks.subapertures[own[0]]]
        axes = capture.poses[number].axes
        for directions in grating_lobes(peaks.directions[own], axes, periods):
            known = np.isfinite(directions).all(axis=1) & (directions @ axes[0] > _MIN_AHEAD)
            if known.any():
                index.append(own[known])
                parts.append(replace(peaks.select(own[known]), directions=directions[known]))
    chosen = np.concatenate(index)
    directions = np.concatenate([part.directions for part in parts])
    return replace(peaks.select(chosen), directions=directions), chosen


def leaking(capture: Capture, peaks: PeakSet, reach_m: float) -> Bools:
    """Mask of peaks in the looking direction at a range that most planes share, (n_peaks,).

    Peaks from behind the opposite planes are leakage, too, from a multiple of the largest range.

    reach_m: distance of the planes from the middle [m].
    """
    ahead = np.stack([pose.axes[0] for pose in capture.poses])[peaks.planes]
    broadside = np.einsum("ij,ij->i", ahead, peaks.directions) > np.cos(ANGLE_SIGMA_RAD)
    found = peaks.ranges_m > 2.0 * reach_m
    index = np.flatnonzero(broadside)
    ranges, planes = peaks.ranges_m[index], peaks.planes[index]
    n_planes = len(np.unique(peaks.planes))
    for middle in np.unique(np.rint(ranges / OFFSET_SIGMA_M)) * OFFSET_SIGMA_M:
        same = np.abs(ranges - middle) < OFFSET_SIGMA_M
        if len(np.unique(planes[same])) > max(4.0, _LEAKING_SHARE * n_planes):
            found[index[same]] = True
    return found


def upward(capture: Capture) -> Floats:
    """Axis of the capture's frame nearest to the planes' vertical axes, (3,)."""
    mean = np.mean([pose.axes[2] for pose in capture.poses if pose.n_antennas], axis=0)
    nearest = int(np.abs(mean).argmax())
    return np.asarray(np.eye(3)[nearest] * np.sign(mean[nearest]))


@dataclass(frozen=True, kw_only=True, eq=False)
class RoughFaces:
    """Planes of a box from flashes."""

    axes: Floats
    """Unit vectors in rows, (3, 3)."""
    offsets_m: Floats
    """Offsets of the faces against and along each axis, outward, (3, 2) [m]; NaN: unseen."""
    shift_m: float = 0.0
    """All ranges are longer by it: error of the delay, and of the walls' depth, one-way [m]."""
    pair_m: float = 0.0
    """Half the distance between the two echoes of each wall, whose faces cancel; 0: one [m]."""

    @property
    def normals(self) -> Floats:
        """Outward normals of the faces against and along each axis, (3, 2, 3)."""
        return np.stack([-self.axes, self.axes], axis=1)


def explained(
    peaks: PeakSet, lobes: PeakSet, index: Ints, rough: RoughFaces, middles: WallMiddles
) -> PeakSet:
    """Peaks with the walls' flashes in their true direction and at the wall's range.

    All ranges are corrected for the error of the delay. Both echoes of a wall whose faces cancel
    are moved to their middle.

    lobes, index: from `with_lobes`.
    """
    seen = ~np.isnan(rough.offsets_m)
    faces = WallFaces.of_planes(rough.normals[seen], rough.offsets_m[seen])
    deviation, longer = np.full(len(lobes), np.inf), np.zeros(len(lobes))
    for pair_m in {-rough.pair_m, rough.pair_m}:
        moved = replace(lobes, ranges_m=lobes.ranges_m - rough.shift_m + pair_m)
        flashes = find_flashes(moved, faces, middles)
        own = np.full(len(lobes), np.inf)
        np.minimum.at(own, flashes.index, flashes.deviations(middles))
        longer[own < deviation] = pair_m
        deviation = np.minimum(deviation, own)
    order = np.lexsort((deviation, index))
    first = order[np.unique(index[order], return_index=True)[1]]
    best = np.where(np.isfinite(deviation[first]), first, np.arange(len(peaks)))
    return replace(
        peaks,
        directions=lobes.directions[best],
        ranges_m=peaks.ranges_m + longer[best] - rough.shift_m,
    )
