"""Delay and frame of the box from its walls' echoes, by Gauss-Newton.

A flat wall returns a flash along its normal, in a direction that does not depend on the delay. The
range minus the distance to the prior's wall is common to all near and far walls. Echoes of the
content have no such common offset (docs/math/calibration.md#delay-and-box).
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._bounds import Bounded, Few, MarginM, MarginRad, SignedM
from geraf2._types import Bools, Floats, Ints
from geraf2.calibration.acceptance import Gain
from geraf2.calibration.box_search import COARSE, LOWEST_DB, MAX_SHIFT_M
from geraf2.calibration.cuboid_search import MAX_PATH_M
from geraf2.echoes.flashes import (
    MAX_ANGLE_RAD,
    MAX_OFFSET_M,
    N_SIGMAS,
    OFFSET_SIGMA_M,
    OVERLAP,
    WallEchoes,
    WallMiddles,
    wall_echoes,
)
from geraf2.echoes.wall_delay import DEGREES_OF_FREEDOM, DELAY_SIGMA_M, MIN_WALL_ECHOES, max_shift_m
from geraf2.echoes.wall_faces import MIDDLE_BULGE, MODE_SIGMAS_M, N_MODES, WallFaces
from geraf2.errors import UserError
from geraf2.geometry.transforms import rigid
from geraf2.imaging.peaks import MAX_RANGE_SHIFT_M, KeptPeaks, PeakSet, box_spans, collect_peaks
from geraf2.scene import Capture, LosPrior
from geraf2.scene.summary import is_delay_given

# Standard deviations of an echo of a near and of a far wall, whose path crosses the content: of
# range [m], and of both directions [rad]. Most of it is from short waves of a bulge.
_RANGE_SIGMAS_M, _DIRECTION_SIGMAS_RAD = np.array([4e-4, 6e-4]), np.array([0.01, 0.015])
_N_ROUNDS = 6
# Share of the near walls' largest density that replaces hidden far walls. It is enough to find a
# delay from near walls alone, and too small to interpret a far wall as a near one.
_MISSING_FAR_SHARE = 0.1

Group = Literal["delay", "frame"]
"""Groups that are accepted separately: delay; position of the prior."""
GROUPS: tuple[Group, ...] = ("delay", "frame")
_PARTS: dict[Group, tuple[str, ...]] = {
    "delay": ("delay",),
    "frame": ("rotation", "translation"),
}


@dataclass(frozen=True, kw_only=True)
class AlignmentConfig(Bounded):
    """Prior of the estimate: expected errors as standard deviations."""

    delay_search_m: tuple[SignedM, SignedM] | None = None
    """Searched changes of the instrument delay, on the two-way path [m]. By default those that the
    search for the box allows a recorded delay, and any delay of 0 to 0.6 m if none was recorded."""
    keep_delay: bool = False
    """Keep the instrument delay."""
    delay_sigma_m: MarginM = 2.0 * DELAY_SIGMA_M
    """Expected error of a recorded delay, on the two-way path [m]; a turntable axis that is 1 mm
    nearer to the radar has the same effect."""
    always_delay: bool = False
    """Apply the estimate of the delay even if held-out echoes do not confirm it."""
    translation_sigma_m: MarginM = 0.01
    """Expected error of the prior's position [m]."""
    rotation_sigma_rad: MarginRad = 0.05
    """Expected error of the prior's orientation [rad]."""
    wall_sigma_m: MarginM = float(MODE_SIGMAS_M[0])
    """Expected error of each wall's distance from the centre of the prior [m]."""
    min_echoes: Few = MIN_WALL_ECHOES
    """Least number of near walls' echoes that agree."""

    @classmethod
    def after(cls, delay_change_m: float) -> "AlignmentConfig":
        """Prior for a capture whose delay the search for the box changed: it is known to a cell."""
        if not delay_change_m:
            return cls()
        return cls(delay_sigma_m=2.0 * MAX_SHIFT_M, always_delay=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay_search_m is not None and not self.delay_search_m[0] < self.delay_search_m[1]:
            msg = f"delay_search_m must be two ascending numbers, got {self.delay_search_m}"
            raise ValueError(msg)

    def search_m(self, capture: Capture) -> tuple[float, float]:
        """Return the changes of the delay that are searched, on the two-way path [m]."""
        if self.delay_search_m is not None:
            return self.delay_search_m
        near_m, recorded_m = 2.0 * MAX_SHIFT_M, capture.waveform.path_bias_m
        if self.is_recorded(capture):
            return -near_m, near_m
        return -near_m - recorded_m, MAX_PATH_M - recorded_m

    def is_recorded(self, capture: Capture) -> bool:
        """Whether the capture has a measured delay."""
        return is_delay_given(capture) and self.delay_search_m is None


@dataclass(frozen=True, kw_only=True, eq=False)
class WallAlignment:
    """Estimate from the walls; all corrections are added to the recorded values."""

    delay_m: float
    """Change of the instrument delay, two-way path [m]."""
    delay_sigma_m: float
    center_m: Floats
    """Centre of the prior and of its rotation, (3,) [m]."""
    rotation_rad: Floats
    """Rotation vector from the prior to the capture frame, (3,) [rad]."""
    rotation_sigma_rad: Floats
    translation_m: Floats
    """Shift of the prior, (3,) [m]."""
    translation_sigma_m: Floats
    shapes_m: Floats
    """Displacement of each wall from the prior, by mode of `wall_faces`, (n_walls, n_modes) [m]."""
    offsets_before_m: Floats
    """Distance of each echo from its wall, minus the median, before calibration [m]."""
    offsets_after_m: Floats
    """Distance of each echo from its wall after calibration, (n_echoes,) [m]."""

    @property
    def rms_m(self) -> tuple[float, float]:
        """RMS of the inner 95 % of the echoes' distances from the walls, before and after [m]."""
        offsets = np.sort(np.abs([self.offsets_before_m, self.offsets_after_m]), axis=1)
        kept = offsets[:, : int(0.95 * offsets.shape[1])]
        before, after = np.linalg.norm(kept, axis=1) / np.sqrt(max(kept.shape[1], 1))
        return float(before), float(after)

    @property
    def bulge_m(self) -> float:
        """Largest bulge at the middle of a wall [m]; outward is positive."""
        bulges = self.shapes_m @ MIDDLE_BULGE
        return float(bulges[np.abs(bulges).argmax()]) if len(bulges) else 0.0

    @property
    def prior_to_capture(self) -> Floats:
        """Rigid transform of homogeneous coordinates, (4, 4)."""
        turn = Rotation.from_rotvec(self.rotation_rad).as_matrix()
        return rigid(turn, self.center_m + self.translation_m - turn @ self.center_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class WallFit:
    """Values of all unknowns, with their covariance."""

    values: Floats
    covariance: Floats


class WallProblem:
    """Unknowns at which the specular returns of near and far walls lie on the prior.

    They are one vector: half the delay [m], rotation [rad] and translation [m] of the prior,
    optical middles and shapes of the walls [m]. Each has a Gaussian prior of mean 0, the delay a
    Student-t. A standard deviation of 0 fixes an unknown.
    """

    def __init__(
        self,
        capture: Capture,
        prior: LosPrior,
        config: AlignmentConfig,
        peaks: KeptPeaks | PeakSet,
    ) -> None:
        """Find the walls' echoes.

        peaks: of the capture; a set whose peaks of walls were moved to the walls' middles is used
        as it is.
        """
        walls, waveform = prior.walls or capture.walls, capture.waveform
        self.middles = WallMiddles.of(walls, waveform)
        low, high = (0.5 * edge for edge in config.search_m(capture))
        if config.keep_delay:
            low, high = -2.0 * MAX_OFFSET_M, 2.0 * MAX_OFFSET_M
        is_moved = not walls and isinstance(peaks, KeptPeaks)
        low -= max_shift_m(waveform) if is_moved else 0.0
        self.echoes: PeakSet = wall_peaks(capture, prior, (low, high), peaks)
        self.size_m = (COARSE if isinstance(peaks, PeakSet) else peaks.subaperture).size_m
        self.faces = WallFaces.of(prior)
        self.center = prior.bounds.mean(axis=0)
        self.axes = np.stack([pose.axes for pose in capture.poses])
        maybe = wall_echoes(self.echoes, self.faces, 2.0 * MAX_ANGLE_RAD)
        offset = maybe.offsets_m - np.array(self.middles.depths_m)[maybe.far]
        size = self.echoes.magnitudes[maybe.index]
        kinds = [(offset[maybe.far == far], size[maybe.far == far]) for far in (0, 1)]
        self.offset_m = find_wall_offset(kinds[0], kinds[1], (low, high), config.min_echoes)
        # Twice the limit, since the box may be rotated or shifted.
        self.maybe = maybe.select(np.abs(offset - self.offset_m) < 4.0 * MAX_OFFSET_M)
        # Without a recorded delay, all searched delays are equally likely.
        is_known = config.keep_delay or config.is_recorded(capture)
        delay = 0.5 * config.delay_sigma_m if is_known else high - low
        if is_moved:
            self.middles = self.middles.at(self.offset_m, delay, waveform)
            self.offset_m -= self.middles.loss_shift_m
        parts = self._priors(config, delay)
        self.sigmas = np.concatenate(list(parts.values()))
        ends = np.cumsum([len(part) for part in parts.values()])[:-1]
        self.parts = dict(zip(parts, np.split(np.arange(len(self.sigmas)), ends), strict=True))

    def _priors(self, config: AlignmentConfig, delay_m: float) -> dict[str, Floats]:
        """Return the standard deviation of each unknown, by group."""
        return {
            "delay": np.array([0.0 if config.keep_delay else delay_m]),
            "rotation": np.full(3, config.rotation_sigma_rad),
            "translation": np.full(3, config.translation_sigma_m),
            "middles": np.array(self.middles.sigmas_m),
            "shapes": np.tile([config.wall_sigma_m, *MODE_SIGMAS_M[1:]], len(self.faces.centers)),
        }

    def fit(self, groups: Collection[Group], use: Bools | None = None) -> WallFit:
        """Maximum a posteriori of the unknowns; covariance from the last normal equations.

        groups: free groups; middles and shapes of the walls are always free.
        use: mask of the peaks to use, (n_peaks,); all when None.
        """
        free = self.sigmas > 0.0
        for group in GROUPS:
            if group not in groups:
                free[np.concatenate([self.parts[name] for name in _PARTS[group]])] = False
        values = np.zeros(len(self.sigmas))
        values[0] = self.offset_m if free[0] else 0.0
        for number in range(_N_ROUNDS):
            walls = self.walls_of(values, number / (_N_ROUNDS - 1), use)
            matrix, vector = self.normal_equations(values, walls, free)
            values[free] -= np.linalg.solve(matrix, vector)
        covariance = np.zeros((len(values), len(values)))
        covariance[np.ix_(free, free)] = np.linalg.inv(matrix)
        return WallFit(values=values, covariance=covariance)

    def normal_equations(
        self, values: Floats, walls: WallEchoes, free: Bools
    ) -> tuple[Floats, Floats]:
        """Gauss-Newton matrix and gradient of the negative log-posterior, (n, n) and (n,)."""
        residual, design = self.linearised(values, walls)
        design = design[:, :, free]
        q = (residual**2).sum(axis=1)
        weight = (DEGREES_OF_FREEDOM + 3.0) / (DEGREES_OF_FREEDOM + q) / OVERLAP
        weighted = (weight[:, None, None] * design).reshape(-1, design.shape[2])
        scaled = values[free] / self.sigmas[free]
        precision = self._prior_weights(scaled, free) * self.sigmas[free] ** -2.0
        matrix = weighted.T @ design.reshape(weighted.shape) + np.diag(precision)
        return matrix, weighted.T @ residual.ravel() + precision * values[free]

    def _prior_weights(self, scaled: Floats, free: Bools) -> Floats:
        """Weights of the priors: Student-t for the delay, which may be recorded wrongly."""
        student = (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + scaled**2)
        return np.where(np.flatnonzero(free) == 0, student, 1.0)

    def log_prior(self, values: Floats) -> float:
        """Log-density of the unknowns' prior up to a constant [nats]."""
        free = self.sigmas > 0.0
        square = (values[free] / self.sigmas[free]) ** 2
        if free[0]:
            square[0] = (DEGREES_OF_FREEDOM + 1.0) * np.log1p(square[0] / DEGREES_OF_FREEDOM)
        return -0.5 * float(square.sum())

    def log_likelihood(self, values: Floats, walls: WallEchoes) -> Floats:
        """Student-t log-likelihood of each echo up to a constant, (n,) [nats]."""
        residual, _ = self.linearised(values, walls)
        q = (residual**2).sum(axis=1) / DEGREES_OF_FREEDOM
        return np.asarray(-0.5 * (DEGREES_OF_FREEDOM + 3.0) / OVERLAP * np.log1p(q))

    def gain(self, groups: Collection[Group], more: Group) -> Gain:
        """Gain of one more group: each half of the sub-apertures with the fit of the other.

        The halves share the walls' middles and shapes, whose deviations count by their prior.
        """
        kept, number = np.unique(self.echoes.subapertures, return_inverse=True)
        planes = self.echoes.subaperture_planes[kept]
        odd = (number - np.searchsorted(planes, planes)[number]) % 2 == 1
        start = np.zeros(len(self.sigmas))
        start[0] = self.offset_m
        nats, prior = list[Floats](), 0.0
        for train, test in ((odd, ~odd), (~odd, odd)):
            before, after = (self.fit(subset, train).values for subset in (groups, [*groups, more]))
            walls = self.walls_of(start, 0.0, test)
            nats.append(self.log_likelihood(after, walls) - self.log_likelihood(before, walls))
            prior += 0.5 * (self.log_prior(after) - self.log_prior(before))
        return Gain.of(np.concatenate(nats), is_modelled=True, prior=prior)

    def corrected(self, values: Floats, index: Ints) -> tuple[Floats, Floats]:
        """Corrected centres and directions of echoes, in the prior's frame."""
        rotation, translation = (values[self.parts[name]] for name in ("rotation", "translation"))
        back = Rotation.from_rotvec(rotation).inv()
        moved = back.apply(self.echoes.centers[index] - self.center - translation) + self.center
        return moved, back.apply(self.echoes.directions[index])

    def walls_of(self, values: Floats, share: float, use: Bools | None = None) -> WallEchoes:
        """Select echoes of walls; share: progress from the first limits to the last, 0 to 1."""
        maybe = self.maybe if use is None else self.maybe.select(use[self.maybe.index])
        centers, directions = self.corrected(values, maybe.index)
        normals = self.faces.normals[maybe.walls]
        cosine = -maybe.side * np.einsum("ij,ij->i", directions, normals)
        height = np.einsum("ij,ij->i", centers - self.faces.centers[maybe.walls], normals)
        moved = replace(
            maybe,
            offsets_m=self.echoes.ranges_m[maybe.index] - maybe.side * height / cosine - values[0],
            angles_rad=np.arccos(np.clip(cosine, -1.0, 1.0)),
        )
        # Twice the limit of a flash in the first round, since the box may be turned or moved.
        keep = moved.deviations(self.middles) < (2.0 - share) * N_SIGMAS
        axes = self.axes[self.echoes.planes[maybe.index]]
        # An aperture that extends beyond the rim may shift ranges by less than their error.
        keep &= self.faces.rim_bias(maybe.walls, centers, axes, self.size_m) < _RANGE_SIGMAS_M[0]
        return maybe.select(keep)

    def linearised(self, values: Floats, walls: WallEchoes) -> tuple[Floats, Floats]:
        """Residuals in standard deviations, (n, 3), and derivatives, (n, 3, n_unknowns).

        The first is the range behind the wall, at the foot of the perpendicular. The others are the
        direction relative to the wall's normal, along both axes of the wall.
        """
        centers, directions = self.corrected(values, walls.index)
        normals, side, n = self.faces.normals[walls.walls], walls.side, len(walls.index)
        height = np.einsum("ij,ij->i", centers - self.faces.centers[walls.walls], normals)
        across = self.faces.across[walls.walls]
        along = across / np.linalg.norm(across, axis=2, keepdims=True)
        parts, rows = self.parts, np.arange(n)
        towards, design = side[:, None] * normals, np.zeros((n, 3, len(values)))

        def dot(one: Floats, other: Floats) -> Floats:
            return np.asarray((one * other).sum(axis=-1))

        ranges, bearings = design[:, 0], design[:, 1:]
        ranges[:, 0] = -1.0
        ranges[:, parts["rotation"]] = np.cross(centers - self.center, towards)
        ranges[:, parts["translation"]] = towards
        ranges[rows, parts["middles"][walls.far]] = -1.0
        ranges[:, parts["middles"][2]] = -1.0
        feet = centers - height[:, None] * normals
        modes, slopes = self.faces.modes(walls.walls, feet)
        columns = parts["shapes"].reshape(-1, N_MODES)[walls.walls]
        ranges[rows[:, None], columns] = modes * side[:, None]
        bearings[:, :, parts["rotation"]] = np.cross(along, directions[:, None])
        where = rows[:, None, None], np.arange(2)[:, None], columns[:, None]
        bearings[where] = -side[:, None, None] * slopes
        linear = np.concatenate([parts["middles"], parts["shapes"]])
        middle = np.array(self.middles.depths_m)[walls.far]
        offset = self.echoes.ranges_m[walls.index] - values[0] - side * height - middle
        known = np.concatenate([offset[:, None], dot(along, directions[:, None])], axis=1)
        sigmas = np.full((n, 3), _DIRECTION_SIGMAS_RAD[walls.far][:, None])
        sigmas[:, 0] = _RANGE_SIGMAS_M[walls.far]
        residual = known + design[:, :, linear] @ values[linear]
        return residual / sigmas, design / sigmas[..., None]

    def result(self, fit: WallFit) -> WallAlignment:
        """Convert the unknowns to corrections."""
        walls = self.walls_of(fit.values, 1.0)
        scale = _RANGE_SIGMAS_M[walls.far]
        after = scale * self.linearised(fit.values, walls)[0][:, 0]
        raw = scale * self.linearised(np.zeros(len(fit.values)), walls)[0][:, 0]
        value = {name: fit.values[part] for name, part in self.parts.items()}
        sigmas = np.sqrt(np.diag(fit.covariance))
        sigma = {name: sigmas[part] for name, part in self.parts.items()}
        return WallAlignment(
            delay_m=2.0 * float(value["delay"][0]),
            delay_sigma_m=2.0 * float(sigma["delay"][0]),
            center_m=self.center,
            rotation_rad=value["rotation"],
            rotation_sigma_rad=sigma["rotation"],
            translation_m=value["translation"],
            translation_sigma_m=sigma["translation"],
            shapes_m=value["shapes"].reshape(-1, N_MODES),
            offsets_before_m=raw - (np.median(raw) if len(raw) else 0.0),
            offsets_after_m=after,
        )


def wall_peaks(
    capture: Capture,
    prior: LosPrior,
    range_shift_m: tuple[float, float],
    peaks: KeptPeaks | PeakSet,
) -> PeakSet:
    """Peaks of all planes at the prior's distance, or shifted by an unknown delay.

    range_shift_m: largest shift towards (negative) and away from the antennas, one-way [m].
    peaks: of the capture; planes are imaged again for ranges beyond those that are kept.
    """
    if all(pose.n_antennas == 0 for pose in capture.poses):
        raise UserError(what="no plane has antennas")
    if isinstance(peaks, PeakSet):
        found = peaks
    elif max(-range_shift_m[0], range_shift_m[1]) <= MAX_RANGE_SHIFT_M:
        found = peaks.of(capture)
    else:
        found = collect_peaks(
            capture,
            prior,
            COARSE,
            peaks.noise_margin_db,
            reach_m=(-range_shift_m[0], range_shift_m[1]),
            num_threads=peaks.num_threads,
        )
    found = found.within(box_spans(capture.poses, prior) + np.array(range_shift_m))
    return found.select(found.levels_db > LOWEST_DB).thinned(COARSE.step_m)


def find_wall_offset(
    near: tuple[Floats, Floats],
    far: tuple[Floats, Floats],
    search_m: tuple[float, float],
    least: int = MIN_WALL_ECHOES,
) -> float:
    """Offset at which echoes of near and of far walls are densest together.

    The weight of an echo is the square root of its magnitude. In a count, many weak echoes would
    dominate, and in the power a single strong one. Densities of near and far walls are multiplied,
    so that neither decides alone.

    near: offsets of echoes from near walls, minus the wall's middle [m], and magnitudes, each (n,).
    far: those of far walls.
    search_m: smallest and largest offset [m].
    least: least number of near walls' echoes that agree.

    Raises UserError if fewer agree, or only at the edge of the search.
    """
    n_steps = max(2, round(4.0 * (search_m[1] - search_m[0]) / OFFSET_SIGMA_M) + 1)
    candidates = np.linspace(*search_m, n_steps)

    def density(offsets_m: Floats, magnitudes: Floats) -> Floats:
        scaled = (candidates[:, None] - offsets_m[None]) / OFFSET_SIGMA_M
        return np.asarray(np.exp(-0.5 * scaled**2) @ np.sqrt(magnitudes))

    of_near, of_far = density(*near), density(*far)
    score = np.sqrt(of_near * (of_far + _MISSING_FAR_SHARE * of_near.max(initial=0.0)))

    best = int(score.argmax())
    n_near = int((np.abs(near[0] - candidates[best]) < MAX_OFFSET_M).sum())
    if n_near < least or best in (0, n_steps - 1):  # a maximum at the edge is no peak
        raise walls_not_seen(n_near, search_m, least)
    return float(candidates[best])


def walls_not_seen(
    n_near: int, search_m: tuple[float, float], least: int = MIN_WALL_ECHOES
) -> UserError:
    """Error of a prior whose faces echo too rarely. n_near, least: echoes found and needed."""
    return UserError(
        what="the walls of the box do not stand out",
        expected=f"at least {least} echoes along the prior's faces at one offset between "
        f"{search_m[0]:g} and {search_m[1]:g} m",
        got=n_near,
        hint="check that the prior lies in the scan's frame and in metres; widen --delay-search "
        "LOW HIGH where the delay was not recorded; a scan that faces no wall needs a known delay "
        "and --no-delay",
    )
