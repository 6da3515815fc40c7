"""Instrument delay, place of the prior, and turntable axis from the walls of the box."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2._validation import require_each, require_positive
from geraf2.calibration.wall_echoes import (
    OffsetPeak,
    WallEchoes,
    WallOffsets,
    collect_echoes,
    find_wall_peak,
    wall_middle_m,
    wall_offsets,
)
from geraf2.geometry.transforms import apply_rigid, rigid
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior, Pose

# Residuals of one echo: range to a wall (0.4 mm on simulated cartons), and its direction, an eighth
# of the lobe of an 8 cm sub-aperture before a wall.
_RANGE_SIGMA_M = 0.0005
_DIRECTION_SIGMA_RAD = 0.02
# Neighbouring sub-apertures overlap by a half in both directions: four echoes tell what one does.
_OVERLAP = 4.0
_N_ROUNDS = 5
_MAX_ANGLE_RAD = (0.2, 0.05)  # of an echo to its wall's normal, in the first and the last round
_MAX_OFFSET_M = (0.02, 0.004)  # of an echo from its wall, in the first and the last round


@dataclass(frozen=True, kw_only=True)
class AlignmentConfig:
    """What may be off, and by how much."""

    delay_search_m: tuple[float, float] = (-0.3, 1.0)
    """Change of the instrument delay to look for, on the two-way path [m]."""
    keep_delay: bool = False
    """Hold the instrument delay; the axis may then also lie nearer or farther."""
    translation_sigma_m: float = 0.01
    """Expected error of the prior's place [m]."""
    rotation_sigma_rad: float = 0.05
    """Expected error of the prior's orientation [rad]."""
    axis_sigma_m: float = 0.005
    """Expected error of the turntable axis [m]."""
    angle_sigma_rad: float = 0.001
    """Expected error of each pose's turntable angle [rad]."""

    def __post_init__(self) -> None:
        sigmas = ("translation_sigma_m", "rotation_sigma_rad", "axis_sigma_m", "angle_sigma_rad")
        require_each(require_positive, self, *(n for n in sigmas if getattr(self, n) != 0.0))
        low, high = self.delay_search_m
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
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
    def prior_to_capture(self) -> Floats:
        """Rigid transform of homogeneous coordinates, (4, 4)."""
        turn = Rotation.from_rotvec(self.rotation_rad).as_matrix()
        return rigid(turn, self.center_m + self.translation_m - turn @ self.center_m)

    def moved_prior(self, prior: LosPrior) -> LosPrior:
        """Prior in the capture frame."""
        vertices = apply_rigid(self.prior_to_capture, prior.vertices)
        return replace(prior, vertices=np.ascontiguousarray(vertices))


def turntable_axis(poses: tuple[Pose, ...]) -> tuple[Floats, Floats]:
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


def align_to_walls(
    capture: Capture,
    prior: LosPrior,
    config: AlignmentConfig | None = None,
    *,
    num_threads: int | None = None,
) -> WallAlignment:
    """Find delay, place of the prior, axis and angles at which wall echoes lie on the prior.

    Robust least squares (Cauchy loss) over the distance of each echo from the plane of its wall,
    less the wall's optical middle, and over its direction against the wall's normal; what the
    walls do not fix stays where it was, with the uncertainty that was assumed.

    prior: outside of the box, roughly in the capture frame; its walls, or else the capture's, say
        how deep behind its outer face a wall echoes.
    config: what may be off.

    Raises UserError: no wall stands out.
    """
    config = config or AlignmentConfig()
    low, high = 0.5 * np.asarray(config.delay_search_m)
    if config.keep_delay:
        low, high = -_MAX_OFFSET_M[0], _MAX_OFFSET_M[0]
    echoes = collect_echoes(capture, prior, (low, high), num_threads=num_threads)
    middle, middle_sigma = wall_middle_m(prior.walls or capture.walls)
    scene = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
    first = wall_offsets(echoes, scene, _MAX_ANGLE_RAD[0])
    peak = find_wall_peak(first.offsets_m - middle, (low, high))
    problem = _Problem(capture, prior, config, middle)
    values = problem.start(0.0 if config.keep_delay else peak.offset_m)
    before = np.zeros(0)
    for number in range(_N_ROUNDS):
        share = number / (_N_ROUNDS - 1)
        angle, reach = (a + share * (b - a) for a, b in (_MAX_ANGLE_RAD, _MAX_OFFSET_M))
        walls = problem.walls_of(echoes, scene, values, (angle, reach))
        if number == 0:
            raw = problem.distances(walls, problem.start(0.0))
            before = raw - np.median(raw)
        solution = least_squares(problem.residuals, values, args=(walls,), loss="cauchy")
        values = solution.x
    distances = problem.distances(walls, values)
    covariance = _OVERLAP * np.linalg.inv(solution.jac.T @ solution.jac)
    return problem.result(values, covariance, middle_sigma, (before, distances), peak)


def _rms(values: Floats) -> float:
    """Root mean square of the middle 95 %."""
    kept = np.sort(np.abs(values))[: max(1, int(0.95 * len(values)))]
    return float(np.sqrt(np.mean(kept**2))) if len(values) else 0.0


class _Problem:
    """Unknowns in one vector: delay, rotation, translation, axis, one angle per pose.

    Each is scaled by its expected error, so that its prior residual is itself.
    """

    def __init__(
        self, capture: Capture, prior: LosPrior, config: AlignmentConfig, middle_m: float
    ) -> None:
        self.middle_m = middle_m
        self.center = prior.bounds.mean(axis=0)
        self.axes = np.stack([pose.axes for pose in capture.poses])
        self.axis = turntable_axis(tuple(p for p in capture.poses if p.n_antennas))
        n_poses = len(capture.poses)
        several = n_poses > 1
        # Nearer by as much for all poses is a shorter delay: only one of them can be found.
        self.scales = np.concatenate(
            [
                [0.0 if config.keep_delay else 0.5],
                np.full(3, config.rotation_sigma_rad),
                np.full(3, config.translation_sigma_m),
                [config.axis_sigma_m if several and config.keep_delay else 0.0],
                [config.axis_sigma_m if several else 0.0],
                np.full(n_poses, config.angle_sigma_rad if several else 0.0),
            ]
        )

    def start(self, offset_m: float) -> Floats:
        values = np.zeros(len(self.scales))
        if self.scales[0] > 0:
            values[0] = offset_m / self.scales[0]
        return values

    def split(self, values: Floats) -> tuple[Floats, ...]:
        x = values * self.scales
        return x[:1], x[1:4], x[4:7], x[7:9], x[9:]

    def placed(self, echoes: WallEchoes, values: Floats) -> WallEchoes:
        """Echoes with everything corrected, as the prior sees them."""
        offset, rotation, translation, axis_shift, angles = self.split(values)
        point, up = self.axis
        turn = Rotation.from_rotvec(angles[echoes.poses, None] * up)
        axes = self.axes[echoes.poses]
        centers = echoes.centers + axis_shift[0] * axes[:, 0] - axis_shift[1] * axes[:, 1]
        centers = turn.apply(centers - point) + point
        back = Rotation.from_rotvec(rotation).inv()
        return WallEchoes(
            centers=back.apply(centers - self.center - translation) + self.center,
            directions=back.apply(turn.apply(echoes.directions)),
            ranges_m=echoes.ranges_m - offset[0],
            poses=echoes.poses,
        )

    def walls_of(
        self, echoes: WallEchoes, scene: MeshScene, values: Floats, limits: tuple[float, float]
    ) -> "_Walls":
        """Echoes that are a wall's by what is known so far, and the planes of their walls."""
        max_angle, max_offset = limits
        placed = self.placed(echoes, values)
        numbered = replace(placed, poses=np.arange(len(placed.poses)))
        found: WallOffsets = wall_offsets(numbered, scene, max_angle)
        near = np.abs(found.offsets_m - self.middle_m) < max_offset
        chosen = np.zeros(len(echoes.poses), dtype=bool)
        chosen[found.echoes.poses[near]] = True
        return _Walls(
            echoes=echoes.select(chosen),
            normals=found.normals[near],
            corners=scene.vertices[scene.faces[found.faces[near], 0]],
        )

    def distances(self, walls: "_Walls", values: Floats) -> Floats:
        """How far behind its wall's optical middle each echo lies, (n,) [m].

        A plane answers from the foot of the perpendicular, whatever direction was measured.
        """
        placed = self.placed(walls.echoes, values)
        height = np.einsum("ij,ij->i", placed.centers - walls.corners, walls.normals)
        return np.asarray(placed.ranges_m - height - self.middle_m)

    def residuals(self, values: Floats, walls: "_Walls") -> Floats:
        placed = self.placed(walls.echoes, values)
        across = np.cross(placed.directions, walls.normals)
        return np.concatenate(
            [
                self.distances(walls, values) / _RANGE_SIGMA_M,
                across.ravel() / _DIRECTION_SIGMA_RAD,
                np.sqrt(_OVERLAP) * values,
            ]
        )

    def result(
        self,
        values: Floats,
        covariance: Floats,
        middle_sigma_m: float,
        distances: tuple[Floats, Floats],
        peak: OffsetPeak,
    ) -> WallAlignment:
        offset, rotation, translation, axis_shift, angles = self.split(values)
        sigmas = self.split(np.sqrt(np.maximum(np.diag(covariance), 0.0)))
        return WallAlignment(
            delay_m=2.0 * float(offset[0]),
            delay_sigma_m=2.0 * float(np.hypot(sigmas[0][0], middle_sigma_m)),
            center_m=self.center,
            rotation_rad=rotation,
            rotation_sigma_rad=sigmas[1],
            translation_m=translation,
            translation_sigma_m=sigmas[2],
            axis_shift_m=axis_shift,
            axis_shift_sigma_m=sigmas[3],
            angles_rad=angles,
            n_echoes=len(distances[1]),
            rms_before_m=_rms(distances[0]),
            rms_after_m=_rms(distances[1]),
            peak=peak,
            offsets_before_m=distances[0],
            offsets_after_m=distances[1],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Walls:
    """Echoes of walls and the plane of each one's wall, in the prior's frame."""

    echoes: WallEchoes
    normals: Floats
    corners: Floats
