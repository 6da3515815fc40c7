"""Instrument delay, place of the prior, and turntable axis from the walls of the box."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._bounds import Bounded, MarginM, MarginRad, SignedM
from geraf2._types import Bools, Floats, Ints
from geraf2.calibration.wall_echoes import (
    OffsetPeak,
    WallMiddles,
    WallOffsets,
    find_wall_peak,
    wall_offsets,
    wall_peaks,
)
from geraf2.calibration.wall_faces import MODE_SIGMAS_M, N_MODES, WallFaces
from geraf2.geometry.transforms import rigid
from geraf2.imaging.peaks import KeptPeaks, PeakSet
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior, Pose

# Range error of one strong echo of a near and of a far wall, on whose way the content lies: 0.4 mm
# on simulated cartons; of one 20 dB below the strongest 1.4 times that.
_RANGE_SIGMAS_M = (0.0005, 0.001)
_WEAK_SHARE = 0.1
# Neighbouring sub-apertures overlap by a half in both directions: four echoes tell what one does.
_OVERLAP = 4.0
# Echoes that a wall's rim cuts are left out where that moves ranges by as much as they err anyhow.
_MAX_RIM_BIAS_M = 0.0005
_N_ROUNDS = 6
_MAYBE_RAD, _MAYBE_M = 0.3, 0.04  # the same, before the box is known to be turned or moved
_MAX_ANGLE_RAD = (0.2, 0.05)  # of an echo to its wall's normal, in the first and the last round
_MAX_OFFSET_M = (0.02, 0.004)  # of an echo from its wall, in the first and the last round
MIN_FAR = 12
"""Echoes of far walls that tell the walls' shapes from the delay."""
NEAR_SEARCH_M, WIDE_SEARCH_M = (-0.03, 0.03), (-0.3, 1.0)


@dataclass(frozen=True, kw_only=True)
class AlignmentConfig(Bounded):
    """What may be off, and by how much."""

    delay_search_m: tuple[SignedM, SignedM] | None = None
    """Change of the instrument delay to look for, on the two-way path [m]. When not given, -0.03 to
    0.03: a delay that was recorded is right to a few millimetres. One of 0 was not recorded, and
    -0.3 to 1 is looked through."""
    keep_delay: bool = False
    """Hold the instrument delay; the axis may then also lie nearer or farther."""
    translation_sigma_m: MarginM = 0.01
    """Expected error of the prior's place [m]."""
    rotation_sigma_rad: MarginRad = 0.05
    """Expected error of the prior's orientation [rad]."""
    axis_sigma_m: MarginM = 0.005
    """Expected error of the turntable axis [m]."""
    angle_sigma_rad: MarginRad = 0.001
    """Expected error of each pose's turntable angle [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.delay_search_m or NEAR_SEARCH_M
        if not low < high:
            msg = f"delay_search_m must be two ascending numbers, got {self.delay_search_m}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True, eq=False)
class WallAlignment:
    """What the walls say; all corrections are to be added."""

    delay_m: float
    """Change of the instrument delay, two-way path [m]."""
    delay_sigma_m: float
    center_m: Floats
    """Middle of the prior, about which it turns, (3,) [m]."""
    rotation_rad: Floats
    """Rotation vector from the prior to the capture frame, (3,) [rad]."""
    rotation_sigma_rad: Floats
    translation_m: Floats
    """Shift of the prior, (3,) [m]."""
    translation_sigma_m: Floats
    axis_shift_m: Floats
    """True turntable axis less the recorded one: towards the radar, and across, (2,) [m]."""
    axis_shift_sigma_m: Floats
    angles_rad: Floats
    """Change of each pose's angle, (n_poses,) [rad]."""
    angle_sigma_rad: Floats
    shapes_m: Floats
    """How far each wall lies outside of the prior, by mode of `wall_faces`, (n_walls, n_modes)."""
    n_echoes: int
    rms_before_m: float
    """Of the echoes' distance from the walls, delay taken off but nothing else [m]."""
    rms_after_m: float
    peak: OffsetPeak
    offsets_before_m: Floats
    """Distance of each echo from its wall, the median taken off, before calibration [m]."""
    offsets_after_m: Floats
    """Distance of each echo from its wall after calibration, (n_echoes,) [m]."""

    @property
    def bulge_m(self) -> float:
        """Largest bulge of a wall, at its middle against its rim [m]; outward is positive."""
        bulges = self.shapes_m[:, -1] - self.shapes_m[:, 3] - self.shapes_m[:, 5]
        return float(bulges[np.abs(bulges).argmax()]) if len(bulges) else 0.0

    @property
    def prior_to_capture(self) -> Floats:
        """Rigid transform of homogeneous coordinates, (4, 4)."""
        turn = Rotation.from_rotvec(self.rotation_rad).as_matrix()
        return rigid(turn, self.center_m + self.translation_m - turn @ self.center_m)


def turntable_axis(poses: Sequence[Pose]) -> tuple[Floats, Floats]:
    """Point on the axis the poses stand around, and its direction, each (3,).

    The point nearest to all looking axes, and the mean of the poses' vertical axes.
    """
    centers = np.stack([pose.phase_centers.mean(axis=0) for pose in poses])
    looking = np.stack([pose.axes[0] for pose in poses])
    across = np.eye(3) - looking[:, :, None] * looking[:, None, :]
    point = np.linalg.lstsq(
        across.sum(axis=0), np.einsum("pij,pj->i", across, centers), rcond=1e-3
    )[0]
    up = np.mean([pose.axes[2] for pose in poses], axis=0)
    return point, up / np.linalg.norm(up)


def moved_pose(
    pose: Pose, axis_shift_m: Floats, angle_rad: float, axis: tuple[Floats, Floats]
) -> Pose:
    """Pose whose antennas stand around the shifted axis, turned by a small angle.

    Seen from the object, a radar whose turntable axis lies nearer to it stands nearer itself.
    """
    point, up = axis
    turn = Rotation.from_rotvec(angle_rad * up).as_matrix()
    shift = axis_shift_m[0] * pose.axes[0] - axis_shift_m[1] * pose.axes[1]

    def moved(positions: Floats) -> Floats:
        return np.asarray((positions + shift - point) @ turn.T + point)

    return replace(
        pose,
        tx_positions=moved(pose.tx_positions),
        rx_positions=moved(pose.rx_positions),
        axes=np.asarray(pose.axes @ turn.T),
    )


Group = Literal["delay", "frame", "axis"]
"""What can be corrected on its own: delay; place of the prior; turntable axis and angles."""
GROUPS: tuple[Group, ...] = ("delay", "frame", "axis")


@dataclass(frozen=True, kw_only=True, eq=False)
class WallFit:
    """Values of all unknowns, with their covariance."""

    values: Floats
    covariance: Floats
    n_echoes: int


@dataclass(frozen=True, kw_only=True, eq=False)
class _Walls:
    """Echoes that are walls' by what is known so far; near ones and far ones."""

    index: Ints
    """Which echoes, (n,)."""
    side: Floats
    """1 of a near wall, -1 of a far one."""
    normals: Floats
    corners: Floats
    walls: Ints
    """Of `WallFaces`, -1 of none."""

    def select(self, keep: Bools) -> "_Walls":
        """Subset by mask."""
        return _Walls(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


class WallProblem:
    """Delay, place of the prior, axis and angles at which wall echoes lie on the prior.

    Robust least squares over the distance of each echo from the plane of its wall, less its
    optical middle and its shape; near and far walls. What they do not fix keeps its value, with
    the uncertainty that was assumed. Unknowns in one vector: delay, rotation, translation, axis,
    angle per pose, middles, shapes; linearised, as turns are small.
    """

    def __init__(
        self,
        capture: Capture,
        prior: LosPrior,
        config: AlignmentConfig,
        echoes: PeakSet,
        scene: MeshScene,
        size_m: float,
    ) -> None:
        self.echoes, self.scene, self.config, self.size_m = echoes, scene, config, size_m
        self.middles = WallMiddles.of(prior.walls or capture.walls)
        self.shapes = WallFaces.of(prior)
        self.center = prior.bounds.mean(axis=0)
        self.axes = np.stack([pose.axes for pose in capture.poses])
        self.axis = turntable_axis(tuple(p for p in capture.poses if p.n_antennas))
        n_poses, n_walls = len(capture.poses), len(self.shapes.centers)
        several = 1.0 if n_poses > 1 else 0.0
        # Nearer by as much for all poses is a shorter delay: only one of them can be found.
        radial = config.axis_sigma_m * several if config.keep_delay else 0.0
        self.sigmas = np.concatenate(
            [
                [0.0 if config.keep_delay else 0.5],
                np.full(3, config.rotation_sigma_rad),
                np.full(3, config.translation_sigma_m),
                [radial, config.axis_sigma_m * several],
                np.full(n_poses, config.angle_sigma_rad * several),
                [self.middles.near_sigma_m, self.middles.far_sigma_m],
                np.tile(MODE_SIGMAS_M, n_walls),
            ]
        )
        ends = np.cumsum([1, 3, 3, 2, n_poses, 2])
        names = ("delay", "rotation", "translation", "axis", "angles", "middles", "shapes")
        self.parts = dict(zip(names, np.split(np.arange(len(self.sigmas)), ends), strict=True))
        kinds = []
        for far, middle in ((False, self.middles.near_m), (True, self.middles.far_m)):
            found = wall_offsets(echoes, scene, _MAX_ANGLE_RAD[0], far=far)
            kinds.append((found.offsets_m - middle, echoes.magnitudes[found.index]))
        self.peak = find_wall_peak(kinds[0], kinds[1], _search(capture, config))
        # Lines of sight meet the same walls wherever the box turns out to be.
        self.maybe = self._candidates()

    @classmethod
    def of(
        cls,
        capture: Capture,
        prior: LosPrior,
        config: AlignmentConfig,
        peaks: KeptPeaks | None = None,
        *,
        num_threads: int | None = None,
    ) -> "WallProblem":
        """Select the peaks of a capture around its prior; UserError: no wall stands out."""
        peaks = peaks or KeptPeaks(prior, num_threads=num_threads)
        echoes = wall_peaks(capture, prior, _search(capture, config), peaks)
        scene = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
        return cls(capture, prior, config, echoes, scene, peaks.subaperture.size_m)

    def fit(self, groups: Collection[Group], use: Bools | None = None) -> WallFit:
        """Values at which the walls' echoes lie on the walls.

        groups: what may change; shapes of the walls always may.
        use: echoes that take part, (n_echoes,); all when None.

        Iteratively reweighted least squares with the Cauchy loss; the first round starts at the
        peak of the offsets.
        """
        free = self._free(groups)
        # Near walls alone cannot tell a bulge from a delay: shapes are then no values, but doubt.
        moving = free.copy()
        if self.peak.n_far < MIN_FAR:
            moving[self.parts["shapes"]] = False
        values = np.zeros(len(self.sigmas))
        if free[0]:
            values[0] = self.peak.offset_m
        precision = np.diag(1.0 / self.sigmas[free] ** 2)
        for number in range(_N_ROUNDS):
            share = number / (_N_ROUNDS - 1)
            angle, reach = (a + share * (b - a) for a, b in (_MAX_ANGLE_RAD, _MAX_OFFSET_M))
            walls = self.walls_of(values, (angle, reach), use)
            residual, design = self.linearised(values, walls)
            design = design[:, free]
            weight = self._weights(residual, walls) / _OVERLAP
            matrix = design.T @ (weight[:, None] * design) + precision
            pull = design.T @ (weight * residual) + precision @ values[free]
            some = moving[free]
            values[moving] -= np.linalg.solve(matrix[np.ix_(some, some)], pull[some])
        meat = self._scatter(design * (weight * residual)[:, None], walls) + precision
        inverse = np.linalg.inv(matrix)
        spread = inverse @ meat @ inverse
        # The larger of what the model says and of how plane and plane disagree.
        grow = np.sqrt(np.maximum(np.diag(spread) / np.diag(inverse), 1.0))
        covariance = np.zeros((len(values), len(values)))
        covariance[np.ix_(free, free)] = inverse * np.outer(grow, grow)
        return WallFit(values=values, covariance=covariance, n_echoes=len(residual))

    def folds(self) -> tuple[Bools, Bools]:
        """Two halves of the echoes: every other sub-aperture of each plane."""
        _, number = np.unique(self.echoes.subapertures, return_inverse=True)
        odd = number.ravel() % 2 == 1
        return odd, ~odd

    def placed_points(self, fit: WallFit) -> tuple[Floats, Floats]:
        """Where all echoes lie, as the prior sees them, (n, 3) [m], and magnitudes, (n,)."""
        every = np.arange(len(self.echoes.planes))
        centers, directions = self.placed(fit.values, every)
        ranges = self.echoes.ranges_m - fit.values[0]
        return centers + ranges[:, None] * directions, self.echoes.magnitudes

    def cost(self, fit: WallFit, use: Bools) -> float:
        """Mean robust misfit of echoes, those of walls by what the peak says; 0 without any."""
        start = np.zeros(len(self.sigmas))
        start[0] = self.peak.offset_m
        walls = self.walls_of(start, (_MAX_ANGLE_RAD[0], _MAX_OFFSET_M[0]), use)
        if len(walls.index) == 0:
            return 0.0
        residual, _ = self.linearised(fit.values, walls)
        return float(np.mean(np.log1p((residual / self._range_sigmas(walls)) ** 2)))

    def _free(self, groups: Collection[Group]) -> Bools:
        free = self.sigmas > 0.0
        held = {
            "delay": ("delay",),
            "frame": ("rotation", "translation"),
            "axis": ("axis", "angles"),
        }
        for group, names in held.items():
            if group not in groups:
                for name in names:
                    free[self.parts[name]] = False
        return free

    def _range_sigmas(self, walls: _Walls) -> Floats:
        sigma = np.where(walls.side > 0, *_RANGE_SIGMAS_M)
        magnitude = self.echoes.magnitudes[walls.index]
        for side in (1.0, -1.0):
            own = walls.side == side
            if own.any():
                strong = float(np.quantile(magnitude[own], 0.9))
                sigma[own] *= np.hypot(1.0, _WEAK_SHARE * strong / magnitude[own])
        return np.asarray(sigma)

    def _weights(self, residual: Floats, walls: _Walls) -> Floats:
        sigma = self._range_sigmas(walls)
        scaled = residual / sigma
        scale = max(1.0, 1.48 * float(np.median(np.abs(scaled)))) if len(scaled) else 1.0
        return np.asarray(1.0 / (1.0 + (scaled / scale) ** 2) / (sigma * scale) ** 2)

    def _scatter(self, scores: Floats, walls: _Walls) -> Floats:
        """Covariance of the sum of scores, from how planes differ: near and far walls apart."""
        block = 2 * self.echoes.planes[walls.index] + (walls.side > 0)
        sums = np.zeros((2 * len(self.axes), scores.shape[1]))
        np.add.at(sums, block, scores)
        n = len(np.unique(block))
        return np.asarray(n / max(n - 1, 1) * (sums.T @ sums))

    def placed(self, values: Floats, index: Ints) -> tuple[Floats, Floats]:
        """Centres and directions of echoes with everything corrected, as the prior sees them."""
        point, up = self.axis
        rotation, translation, axis_shift, angles = (
            values[self.parts[name]] for name in ("rotation", "translation", "axis", "angles")
        )
        poses = self.echoes.planes[index]
        turn = Rotation.from_rotvec(angles[poses, None] * up)
        axes = self.axes[poses]
        shift = axis_shift[0] * axes[:, 0] - axis_shift[1] * axes[:, 1]
        centers = turn.apply(self.echoes.centers[index] + shift - point) + point
        back = Rotation.from_rotvec(rotation).inv()
        moved = back.apply(centers - self.center - translation) + self.center
        return moved, back.apply(turn.apply(self.echoes.directions[index]))

    def _candidates(self) -> _Walls:
        """Echoes that may be a wall's, and which; a box turned by 5 degrees is among them."""
        found: list[WallOffsets] = []
        for far, middle in ((False, self.middles.near_m), (True, self.middles.far_m)):
            one = wall_offsets(self.echoes, self.scene, _MAYBE_RAD, far=far)
            found.append(one.select(np.abs(one.offsets_m - middle - self.peak.offset_m) < _MAYBE_M))
        faces = np.concatenate([one.faces for one in found])
        return _Walls(
            index=np.concatenate([one.index for one in found]),
            side=np.repeat([1.0, -1.0], [len(one.index) for one in found]),
            normals=np.concatenate([one.normals for one in found]),
            corners=self.scene.vertices[self.scene.faces[faces, 0]],
            walls=self.shapes.of_face[faces],
        )

    def walls_of(
        self, values: Floats, limits: tuple[float, float], use: Bools | None = None
    ) -> _Walls:
        """Echoes that are a wall's by what is known so far, and the planes of their walls."""
        maybe, (max_angle, max_offset) = self.maybe, limits
        centers, directions = self.placed(values, maybe.index)
        cosine = -maybe.side * np.einsum("ij,ij->i", directions, maybe.normals)
        height = maybe.side * np.einsum("ij,ij->i", centers - maybe.corners, maybe.normals)
        middle = np.where(maybe.side > 0, self.middles.near_m, self.middles.far_m)
        off = self.echoes.ranges_m[maybe.index] - height / cosine - middle - values[0]
        keep = (cosine > np.cos(max_angle)) & (np.abs(off) < max_offset)
        flat = np.flatnonzero(maybe.walls >= 0)
        seen = self.axes[self.echoes.planes[maybe.index[flat]]], self.size_m
        bias = self.shapes.rim_bias(maybe.walls[flat], centers[flat], *seen)
        keep[flat] &= bias < _MAX_RIM_BIAS_M
        if use is not None:
            keep &= use[maybe.index]
        return maybe.select(keep)

    def linearised(self, values: Floats, walls: _Walls) -> tuple[Floats, Floats]:
        """How far behind its wall each echo lies, (n,) [m], and the derivatives, (n, n_unknowns).

        A plane answers from the foot of the perpendicular, whatever direction was measured.
        """
        centers, _ = self.placed(values, walls.index)
        side, normals, n = walls.side, walls.normals, len(walls.index)
        height = np.einsum("ij,ij->i", centers - walls.corners, normals)
        point, up = self.axis
        poses, far = self.echoes.planes[walls.index], (walls.side < 0).astype(np.int64)
        parts, rows = self.parts, np.arange(n)
        design = np.zeros((n, len(values)))
        design[:, 0] = -1.0
        towards = side[:, None] * normals
        design[:, parts["rotation"]] = np.cross(centers - self.center, towards)
        design[:, parts["translation"]] = towards
        axes = self.axes[poses]
        design[:, parts["axis"][0]] = -np.einsum("ij,ij->i", towards, axes[:, 0])
        design[:, parts["axis"][1]] = np.einsum("ij,ij->i", towards, axes[:, 1])
        turned = np.cross(up, centers - point)
        design[rows, parts["angles"][poses]] = -np.einsum("ij,ij->i", towards, turned)
        design[rows, parts["middles"][far]] = -1.0
        shaped = walls.walls >= 0
        feet = centers - height[:, None] * normals
        modes = self.shapes.modes(walls.walls[shaped], feet[shaped]) * side[shaped, None]
        columns = parts["shapes"].reshape(-1, N_MODES)[walls.walls[shaped]]
        design[rows[shaped, None], columns] = modes
        linear = np.concatenate([parts["middles"], parts["shapes"]])
        middle = np.where(side > 0, self.middles.near_m, self.middles.far_m)
        off = self.echoes.ranges_m[walls.index] - values[0] - side * height - middle
        return off + design[:, linear] @ values[linear], design

    def result(self, fit: WallFit) -> WallAlignment:
        """Say what was fitted, as people read it."""
        limits = (_MAX_ANGLE_RAD[1], _MAX_OFFSET_M[1])
        walls = self.walls_of(fit.values, limits)
        after, _ = self.linearised(fit.values, walls)
        raw, _ = self.linearised(np.zeros(len(fit.values)), walls)
        raw = raw - (np.median(raw) if len(raw) else 0.0)
        sigmas = np.sqrt(np.diag(fit.covariance))

        def of(name: str) -> tuple[Floats, Floats]:
            part = self.parts[name]
            return fit.values[part], sigmas[part]

        delay, rotation, translation, axis = (
            of(name) for name in ("delay", "rotation", "translation", "axis")
        )
        return WallAlignment(
            delay_m=2.0 * float(delay[0][0]),
            delay_sigma_m=2.0 * float(delay[1][0]),
            center_m=self.center,
            rotation_rad=rotation[0],
            rotation_sigma_rad=rotation[1],
            translation_m=translation[0],
            translation_sigma_m=translation[1],
            axis_shift_m=axis[0],
            axis_shift_sigma_m=axis[1],
            angles_rad=fit.values[self.parts["angles"]],
            angle_sigma_rad=sigmas[self.parts["angles"]],
            shapes_m=fit.values[self.parts["shapes"]].reshape(-1, N_MODES),
            n_echoes=len(after),
            rms_before_m=_rms(raw),
            rms_after_m=_rms(after),
            peak=self.peak,
            offsets_before_m=raw,
            offsets_after_m=after,
        )


def _search(capture: Capture, config: AlignmentConfig) -> tuple[float, float]:
    """One-way offsets at which walls may be found [m]."""
    if config.keep_delay:
        return -_MAX_OFFSET_M[0], _MAX_OFFSET_M[0]
    low, high = delay_search(capture, config.delay_search_m)
    return 0.5 * low, 0.5 * high


def delay_search(capture: Capture, asked_m: tuple[float, float] | None) -> tuple[float, float]:
    """Give the changes of the delay to look for, see `AlignmentConfig.delay_search_m` [m]."""
    if asked_m is not None:
        return asked_m
    return WIDE_SEARCH_M if capture.waveform.path_bias_m == 0.0 else NEAR_SEARCH_M


def _rms(values: Floats) -> float:
    """Root mean square of the middle 95 %."""
    kept = np.sort(np.abs(values))[: max(1, int(0.95 * len(values)))]
    return float(np.sqrt(np.mean(kept**2))) if len(values) else 0.0
