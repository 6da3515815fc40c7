"""Planes of a box's walls, from peaks of a scan.

A flat wall that antennas face squarely returns a flash along its normal, from the front or through
the box from behind. Hypotheses of a cuboid are compared by how many sub-apertures have its flashes
(docs/math/calibration.md#box-from-the-scan).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.calibration.wall_echoes import OVERLAP, WallMiddles
from geraf2.echoes.wall_delay import pair_distance_m
from geraf2.geometry.transforms import triple
from geraf2.imaging.peaks import KeptPeaks, PeakSet, grating_lobes
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import Capture, LosPrior, Waveform

# Half as many sub-apertures and directions as for glints, in a fifth of the time.
_COARSE = SubapertureConfig(step_m=0.04, direction_oversampling=2.0)
# Side of the imaged region over the planes' distance, larger than any box between them.
_REGION = 1.3
# Largest angle between a flash and its wall's normal, by noise and the slopes of a bulge [rad].
MAX_ANGLE_RAD = 0.06
# Steps of the yaw in the first search and around its best.
_YAW_STEPS_RAD = np.deg2rad([1.5, 0.25])
# An expected yaw is preferred within this angle, if it has this share of the highest score.
_LIKE_RAD, _LIKE_SHARE = np.deg2rad(4.0), 0.7
# Other yaws are tried, at most so many, if they have this share of the highest score.
_RIVAL_SHARE, _MAX_RIVALS = 0.9, 3
# Grid of a wall's offset, and standard deviation of its flashes: walls bulge by 1 to 3 mm.
OFFSET_STEP_M, OFFSET_SIGMA_M = 0.002, 0.003
# Grid of a wall's level, standard deviation among walls of one box, and number of levels below the
# strongest peak [dB].
LEVEL_STEP_DB, _LEVEL_SIGMA_DB, _N_LEVELS = 2.0, 4.0, 20
# Lowest level of walls: flat metal is 18 dB stronger. Walls whose faces cancel are 10 dB weaker.
_LOWEST_DB, _LOWEST_PAIR_DB = -22.0, -32.0
# Largest error of the recorded delay, one-way, and its standard deviation [m].
_MAX_SHIFT_M, _SHIFT_SIGMA_M = 0.024, 0.01
# Log-likelihood ratio of a flash on its wall against clutter, whose density is uniform over ranges
# and directions [nats]. Counts below are in flashes, of which four overlap.
_FLASH_NATS = 7.0
# Loss of a sub-aperture that faces a wall without a flash: a detection probability of 0.88.
_MISS = 0.3
# Sub-apertures that face a wall: least cosine, and largest distance of the foot from the middle of
# the scan [m], which the smallest boxes exceed.
_FACING_COSINE, _FOOT_M = 0.98, 0.06
# Least count of a wall, and least share of the largest count on its side.
_MIN_COUNT, _MIN_SHARE = 1.0, 0.5
# Distances of the two echoes of a wall whose faces cancel at the middle of the band, over those
# without loss. The null may lie off the middle.
_PAIR_SHARES = (0.7, 0.8, 0.9, 1.0)
# Leakage, or a reflector that moves with the antennas: largest angle to the looking direction
# [rad], range tolerance [m], least share and number of planes with the same range.
_BROADSIDE, _SAME_RANGE_M, _LEAKING_SHARE, _LEAKING_PLANES = 0.03, 0.003, 0.7, 5
MIN_SIDE_M = 0.04
"""Least side length of a box [m]."""
MIN_REACH_M = 0.5 * MIN_SIDE_M + 2.0 * _MAX_SHIFT_M + OFFSET_STEP_M
"""Least distance of the planes: the smallest box at the largest error of the delay [m]."""
APERTURE_M = _COARSE.size_m
"""Side of the sub-apertures in which walls are searched [m]."""
# Least cosine between a direction and the looking direction.
_MIN_AHEAD = 0.8


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

    def counts(self, normal: Floats, n_offsets: int) -> tuple["Counts", "Counts"]:
        """Flashes of near and of far walls with this outward normal, (3,)."""
        cosine = self.normals @ normal
        own = np.flatnonzero(
            (cosine > np.cos(MAX_ANGLE_RAD))
            & (self.offsets_m > 0.0)
            & (self.offsets_m < n_offsets * OFFSET_STEP_M)
        )
        angle = np.arccos(np.clip(cosine[own], -1.0, 1.0))
        weights = self.weights[own] * (1.0 - (angle / MAX_ANGLE_RAD) ** 2)
        across = self.centers - np.outer(self.centers @ normal, normal)
        is_near = np.linalg.norm(across, axis=1) < _FOOT_M
        toward = self.ahead @ normal
        found = []
        for far, facing in ((False, toward < -_FACING_COSINE), (True, toward > _FACING_COSINE)):
            kind = self.far[own] == far
            density = self.density(own[kind], self.offsets_m[own[kind]], weights[kind], n_offsets)
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
        usable = (np.abs(ahead) > _FACING_COSINE) & (self.levels_db > _LOWEST_DB)
        near, far = (np.flatnonzero(usable & (self.far == kind)) for kind in (False, True))
        best = (0, 0)
        most = round(_MAX_SHIFT_M / OFFSET_STEP_M)
        for shift in range(-most, most + 1, 2) if len(near) and len(far) else ():
            moved = self.offsets_m + shift * OFFSET_STEP_M * np.where(self.far, -1.0, 1.0)
            scaled = np.column_stack(
                [
                    self.normals / MAX_ANGLE_RAD,
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
        level = (self.levels_db[own] / LEVEL_STEP_DB).astype(np.int64) + _N_LEVELS - 1
        level = np.maximum(level, 0)
        cell = (self.subapertures[own] * n_offsets + offset // 4) * _N_LEVELS + level // 4
        order = np.lexsort((-weights, cell))
        first = order[np.unique(cell[order], return_index=True)[1]]
        shape = n_offsets, _N_LEVELS
        count = np.bincount(
            (offset * _N_LEVELS + level)[first], weights[first], n_offsets * _N_LEVELS
        )
        widths = OFFSET_SIGMA_M / OFFSET_STEP_M, _LEVEL_SIGMA_DB / LEVEL_STEP_DB
        smooth = gaussian_filter(count.reshape(shape), widths, mode="constant")
        return np.asarray(2.0 * np.pi * widths[0] * widths[1] * smooth)


class Counts(NamedTuple):
    """Flashes of walls with one normal, from one side."""

    density: Floats
    """Count over offset and level, (n_offsets, n_levels)."""
    n_facing: int
    """Number of sub-apertures that face such a wall."""

    def score(self, pair: int) -> Floats:
        """Count of flashes less missed ones, (n_offsets, n_levels).

        pair: half the distance of a wall's two echoes, in cells; 0 for a single one.
        """
        count, expected = self.density, self.n_facing
        if pair:
            count = 2.0 * np.minimum(shifted(count, pair), shifted(count, -pair))
            expected = 2 * expected
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
    broadside = np.einsum("ij,ij->i", ahead, peaks.directions) > np.cos(_BROADSIDE)
    found = peaks.ranges_m > 2.0 * reach_m
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


def shift_penalty(cells: int) -> float:
    """Flashes that an error of the delay costs by its prior. cells: the error, in offset steps."""
    sigma = _SHIFT_SIGMA_M / OFFSET_STEP_M
    return float(0.5 * (cells / sigma) ** 2 * OVERLAP / _FLASH_NATS)


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
    level_db: float = 0.0
    """Level of the walls relative to the strongest peak [dB]."""

    @property
    def normals(self) -> Floats:
        """Outward normals of the faces against and along each axis, (3, 2, 3)."""
        return np.stack([-self.axes, self.axes], axis=1)


class Hypothesis(NamedTuple):
    """Score of a cuboid, for the best level and delay at a yaw."""

    score: float
    yaw_rad: float
    shift: int
    """Error of the delay, in cells of the offset."""
    pair: int
    """Half the distance of a wall's two echoes, in cells."""
    level: int


class BoxSearch:
    """Search for the cuboid with most flashes at one level and one delay."""

    def __init__(self, flashes: Flashes, up: Floats, reach_m: float, waveform: Waveform) -> None:
        self.flashes, self.up = flashes, up
        self.first = np.abs(np.roll(up, 1))
        self.second = np.cross(up, self.first)
        self.n_offsets = max(int(reach_m / OFFSET_STEP_M), 2)
        pair_m = pair_distance_m(waveform)
        shares = [round(share * pair_m / OFFSET_STEP_M) for share in _PAIR_SHARES]
        self.pairs = sorted({0, *shares})
        # A pair of echoes lies around the middle of the faces.
        self.unmoved = -round(flashes.loss_shift_m / OFFSET_STEP_M)
        self.upright = [flashes.counts(normal, self.n_offsets) for normal in (-up, up)]

    def axes(self, yaw_rad: float) -> Floats:
        """Axes of a box, (3, 3)."""
        x = np.cos(yaw_rad) * self.first + np.sin(yaw_rad) * self.second
        return np.stack([x, np.cross(self.up, x), self.up])

    def sides(self, yaw_rad: float) -> list[tuple[Counts, Counts]]:
        """Flashes of the faces against and along each axis."""
        x, y, _ = self.axes(yaw_rad)
        return [self.flashes.counts(n, self.n_offsets) for n in (-x, x, -y, y)] + self.upright

    def lowest_level(self, pair: int) -> int:
        """Index of the lowest level of walls. pair: half the distance of two echoes, in cells."""
        return _N_LEVELS + int((_LOWEST_PAIR_DB if pair else _LOWEST_DB) / LEVEL_STEP_DB)

    def best(self, yaws: Iterable[float], shifts: Sequence[int]) -> list[Hypothesis]:
        """Best hypothesis at each yaw.

        shifts: of the delay, in cells of the offset.
        """
        penalty = np.array([shift_penalty(shift) for shift in shifts])
        most = max(abs(shift) for shift in shifts)
        least = max(round(0.5 * MIN_SIDE_M / OFFSET_STEP_M), most)
        end = self.n_offsets - most
        found = []
        for yaw in yaws:
            sides = self.sides(yaw)
            tries = []
            for pair in self.pairs:
                total = np.repeat(-penalty[:, None], _N_LEVELS, axis=1)
                start = self.unmoved if pair else 0
                for near, far in sides:
                    n, f = shifted(near.score(pair), start), shifted(far.score(pair), -start)
                    for number, shift in enumerate(shifts):
                        both = n[least - shift : end - shift] + f[least + shift : end + shift]
                        total[number] += both.max(axis=0)
                total[:, : self.lowest_level(pair)] = -np.inf
                row, level = divmod(int(total.argmax()), _N_LEVELS)
                tries.append(Hypothesis(float(total.max()), yaw, start + shifts[row], pair, level))
            found.append(max(tries))
        return found

    def faces(self, found: Hypothesis) -> Floats:
        """Outermost plane of each side with enough flashes, (3, 2) [m]; NaN without."""
        offsets = [self._outermost(side, found) for side in self.sides(found.yaw_rad)]
        return np.array(offsets).reshape(3, 2)

    def _outermost(self, side: tuple[Counts, Counts], found: Hypothesis) -> float:
        """Outermost offset of a side with enough flashes [m]; NaN without.

        side: near and far flashes of its normal.
        """
        near, far = (counts.score(found.pair) for counts in side)
        score = shifted(near, found.shift) + shifted(far, -found.shift)
        count = score[:, found.level]
        count[: round(0.5 * MIN_SIDE_M / OFFSET_STEP_M)] = 0.0
        least = max(_MIN_COUNT, _MIN_SHARE * float(count.max()))
        rises, falls = np.diff(count, prepend=0.0) > 0.0, np.diff(count, append=0.0) <= 0.0
        peaks = np.flatnonzero(rises & falls & (count >= least))
        return (peaks[-1] + 0.5) * OFFSET_STEP_M if len(peaks) else np.nan


def rough_faces(
    flashes: Flashes, up: Floats, reach_m: float, waveform: Waveform, like: Floats | None = None
) -> Iterator[RoughFaces]:
    """Cuboids around the origin of which most sub-apertures show flashes, the best first.

    The walls of a box have one level, and one error of the delay moves near and far walls apart. A
    flat face of content is seen from few sides, or differs in level.

    up: the box's vertical, an axis of the frame, (3,).
    reach_m: distance of the planes, beyond which no wall lies [m].
    like: axes that are preferred if nearly as many flashes agree, (3, 3).
    """
    search = BoxSearch(flashes, up, reach_m, waveform)
    most = round(_MAX_SHIFT_M / OFFSET_STEP_M)
    coarse, fine = _YAW_STEPS_RAD
    found = search.best(np.arange(0.0, 0.5 * np.pi, coarse), range(-most, most + 1, 2))
    score = np.array([each.score for each in found])
    is_peak = (score >= np.roll(score, 1)) & (score >= np.roll(score, -1))
    is_peak &= score >= _RIVAL_SHARE * score.max()
    rivals = sorted((found[k] for k in np.flatnonzero(is_peak)), reverse=True)[:_MAX_RIVALS]
    if like is not None:
        side = like[int(np.abs(like @ up).argmin())]
        turn = np.array([each.yaw_rad for each in found])
        turn -= np.arctan2(side @ search.second, side @ search.first)
        near = np.abs(turn - 0.5 * np.pi * np.rint(turn / (0.5 * np.pi))) < _LIKE_RAD
        alike = max(each for each, is_near in zip(found, near, strict=True) if is_near)
        if alike.score > _LIKE_SHARE * score.max():
            rivals.insert(0, alike)
    for rival in rivals:
        yaws = rival.yaw_rad + np.arange(-coarse, coarse + 0.5 * fine, fine)
        yield _faces_of(search, max(search.best(yaws, range(-most, most + 1))))


def _faces_of(search: BoxSearch, best: Hypothesis) -> RoughFaces:
    """Faces of a hypothesis, at the one of four equal yaws that is nearest to the frame's axes."""
    offsets = search.faces(best)
    quarters = round(best.yaw_rad / (0.5 * np.pi) - 1e-9)
    axes = search.axes(best.yaw_rad - 0.5 * np.pi * quarters)
    for _ in range(quarters % 4):
        offsets = offsets[[1, 0, 2]]
        offsets[0] = offsets[0, ::-1]
    return RoughFaces(
        axes=axes,
        offsets_m=offsets,
        shift_m=best.shift * OFFSET_STEP_M,
        pair_m=best.pair * OFFSET_STEP_M,
        level_db=LEVEL_STEP_DB * (best.level + 1 - _N_LEVELS),
    )


def explained(
    peaks: PeakSet, lobes: PeakSet, index: Ints, flashes: Flashes, rough: RoughFaces
) -> PeakSet:
    """Peaks with the walls' flashes in their true direction and at the wall's range.

    All ranges are corrected for the error of the delay. Both echoes of a wall whose faces cancel
    are moved to their middle.

    lobes, index: from `with_lobes`.
    """
    deviation = np.full(len(flashes.offsets_m), np.inf)
    outward = np.zeros(len(deviation))
    shift = np.where(flashes.far, rough.shift_m, -rough.shift_m)
    for k, side in np.ndindex(3, 2):
        along = flashes.normals @ rough.normals[k, side] > np.cos(MAX_ANGLE_RAD)
        beyond = flashes.offsets_m - shift - rough.offsets_m[k, side]
        for pair in {-rough.pair_m, rough.pair_m}:
            closer = along & (np.abs(beyond - pair) < np.minimum(deviation, 3.0 * OFFSET_SIGMA_M))
            deviation[closer] = np.abs(beyond - pair)[closer]
            outward[closer] = pair
    n, rows = len(lobes), np.arange(len(lobes))
    kind = deviation.reshape(2, n).argmin(axis=0)  # each lobe as a near and as a far wall
    deviation, outward = deviation.reshape(2, n)[kind, rows], outward.reshape(2, n)[kind, rows]
    order = np.lexsort((deviation, index))
    first = order[np.unique(index[order], return_index=True)[1]]
    is_flash = np.isfinite(deviation[first])
    best = np.where(is_flash, first, np.arange(len(peaks)))
    longer = np.where(kind[best] == 0, outward[best], -outward[best]) * is_flash
    return replace(
        peaks,
        directions=lobes.directions[best],
        ranges_m=peaks.ranges_m + longer - rough.shift_m,
    )
