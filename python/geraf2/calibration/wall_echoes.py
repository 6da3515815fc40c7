"""Echoes of the box's walls, and the instrument delay at which they lie on the prior.

A flat wall answers where it is seen along its normal. Whatever the instrument delay, the
direction of such an echo is right, and its range less the distance to the prior's surface is the
same for all of them, for the wall that the radar faces and for the one behind the content; the
content's echoes have no such common offset (docs/math/calibration.md#delay-box-and-axis).
"""

from dataclasses import dataclass, replace

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.errors import UserError
from geraf2.geometry.triangles import unit_normals
from geraf2.imaging.peaks import MAX_RANGE_SHIFT_M, KeptPeaks, PeakSet, box_spans, collect_peaks
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior, Wall

WALL_MIDDLE_M = 0.0025
"""Optical middle of a wall behind its outer face where nothing is known of it [m]."""
WALL_MIDDLE_SIGMA_M = 0.0015
"""Its uncertainty: board of 2 to 7 mm [m]."""
FAR_MIDDLE_M = -0.0004
"""The same of the far wall, seen through the near one, for index 1.26 [m]."""
FAR_MIDDLE_SIGMA_M = 0.0005
"""Its uncertainty: index 1.2 to 1.4 [m]."""

# The wall's echo is strong, but the figure's may be 20 dB stronger.
_DYNAMIC_RANGE_DB = 26.0
# Half as many sub-apertures as glints need: 4 m of wall give hundreds of echoes.
_STEP_M = 0.04
# The offset of the walls stands out as a peak of this width; it covers a prior that is 5 mm off.
_OFFSET_SIGMA_M = 0.004
_OFFSET_STEP_M = 0.001
# Where the content hides the far walls, this part of the largest density of near ones stands in for
# them: enough to find a delay from near walls alone, too little for a far wall taken for a near
# one, behind which there is nothing.
_MISSING_FAR_SHARE = 0.1
# Near walls alone are the first peak of this share of the highest.
_FIRST_PEAK_SHARE = 0.6
_MIN_ECHOES = 12


def wall_peaks(
    capture: Capture,
    prior: LosPrior,
    range_shift_m: tuple[float, float],
    peaks: KeptPeaks,
) -> PeakSet:
    """Peaks of all planes at the prior's distance, or shifted by an unknown delay.

    range_shift_m: how much nearer (negative) and farther than the prior they may lie, one way [m].
    peaks: of the capture; farther from the prior than these reach, planes are imaged anew.
    """
    if all(pose.n_antennas == 0 for pose in capture.poses):
        raise UserError(what="no plane has antennas")
    if max(-range_shift_m[0], range_shift_m[1]) <= MAX_RANGE_SHIFT_M:
        found = peaks.of(capture)
    else:
        found = collect_peaks(
            capture,
            prior,
            replace(peaks.subaperture, step_m=_STEP_M, direction_oversampling=2.0),
            peaks.noise_margin_db,
            reach_m=(-range_shift_m[0], range_shift_m[1]),
            num_threads=peaks.num_threads,
        )
    found = found.within(box_spans(capture.poses, prior) + np.array(range_shift_m))
    return found.select(found.levels_db >= -_DYNAMIC_RANGE_DB).thinned(_STEP_M)


@dataclass(frozen=True, kw_only=True)
class WallMiddles:
    """How far behind the outer faces walls echo, and the uncertainties [m].

    Both faces of a wall lie in one range cell. With thickness t and index n a near wall echoes
    from n t / 2 behind its outer face, a far one, seen through the near one, from
    3 n t / 2 - 2 t behind its own: within 0.5 mm of it for all cardboard.
    """

    near_m: float
    near_sigma_m: float
    far_m: float
    far_sigma_m: float

    @classmethod
    def of(cls, walls: tuple[Wall, ...]) -> "WallMiddles":
        """Of the outermost wall, and of boxes within it; what is likely where nothing is known."""
        if not walls:
            return cls(
                near_m=WALL_MIDDLE_M,
                near_sigma_m=WALL_MIDDLE_SIGMA_M,
                far_m=FAR_MIDDLE_M,
                far_sigma_m=FAR_MIDDLE_SIGMA_M,
            )
        excess = [(float(np.sqrt(w.permittivity)) - 1.0) * w.thickness_m for w in walls]
        near = 0.5 * (excess[0] + walls[0].thickness_m)
        far = 1.5 * excess[0] - 0.5 * walls[0].thickness_m + 2.0 * sum(excess[1:])
        # Range error of a wall's echo, measured on simulated cartons; and a tenth of the wall.
        sigma = float(np.hypot(2.5e-4, 0.1 * near))
        return cls(near_m=near, near_sigma_m=sigma, far_m=far, far_sigma_m=sigma)


@dataclass(frozen=True, kw_only=True, eq=False)
class WallOffsets:
    """Echoes along a face's normal, and how far behind the face they seem to lie."""

    index: Ints
    """Which echoes, (n,)."""
    offsets_m: Floats
    """Range less distance of the prior's surface, (n,) [m]."""
    faces: Ints
    """Triangle of the prior that the line of sight meets, (n,)."""
    normals: Floats
    """Outward normal there, (n, 3)."""

    def select(self, keep: Bools) -> "WallOffsets":
        """Subset by mask."""
        return WallOffsets(
            **{name: getattr(self, name)[keep] for name in self.__dataclass_fields__}
        )


def wall_offsets(
    echoes: PeakSet, scene: MeshScene, max_angle_rad: float, *, far: bool
) -> WallOffsets:
    """Keep echoes that come from along the normal of the face their line of sight meets.

    far: of the face through which the line leaves the prior, instead of the first it meets.
    """
    origins, directions = echoes.centers, echoes.directions
    if far:  # looked at from behind
        beyond = 2.0 * float(np.abs(origins).max(initial=0.0) + np.abs(scene.vertices).max())
        back, face = scene.closest_hit(origins + beyond * directions, -directions)
        distance = beyond - back
    else:
        distance, face = scene.closest_hit(origins, directions)
    met = unit_normals(scene.vertices[scene.faces])[np.maximum(face, 0)]
    cosine = (1.0 if far else -1.0) * np.einsum("ij,ij->i", directions, met)
    keep = (face >= 0) & (cosine > np.cos(max_angle_rad))
    return WallOffsets(
        index=np.flatnonzero(keep),
        offsets_m=(echoes.ranges_m - np.where(np.isfinite(distance), distance, 0.0))[keep],
        faces=face[keep],
        normals=met[keep],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class OffsetPeak:
    """Where the walls stand out among the offsets."""

    offset_m: float
    n_near: int
    """Echoes of near walls within 1 cm of it."""
    n_far: int
    """Of far walls."""
    candidates_m: Floats
    """Offsets looked at, (n,) [m]."""
    density: Floats
    """How much speaks for each, near and far walls together, 1 at the best, (n,)."""


def find_wall_peak(
    near: tuple[Floats, Floats], far: tuple[Floats, Floats], search_m: tuple[float, float]
) -> OffsetPeak:
    """Offset at which the most speaks for near and far walls at once.

    The square root of a magnitude is an echo's weight: between a count, in which many weak ones
    win, and the power, of which one strong one has most. Densities of near and far walls are
    multiplied, so that neither wins alone.

    near: offsets of echoes from near walls, less the wall's middle [m], and magnitudes, each (n,).
    far: those of far walls.
    search_m: smallest and largest offset to look at [m].

    Raises UserError: fewer than twelve echoes of near walls agree.
    """
    n_steps = max(2, round((search_m[1] - search_m[0]) / _OFFSET_STEP_M) + 1)
    candidates = np.linspace(*search_m, n_steps)

    def density(offsets_m: Floats, magnitudes: Floats) -> Floats:
        scaled = (candidates[:, None] - offsets_m[None]) / _OFFSET_SIGMA_M
        return np.asarray(np.exp(-0.5 * scaled**2) @ np.sqrt(magnitudes))

    of_near, of_far = density(*near), density(*far)
    score = np.sqrt(of_near * (of_far + _MISSING_FAR_SHARE * of_near.max(initial=0.0)))

    def counts(best: int) -> list[int]:
        return [int((np.abs(kind[0] - candidates[best]) < 0.01).sum()) for kind in (near, far)]

    best = int(score.argmax())
    if counts(best)[1] < _MIN_ECHOES:  # the content may agree as well, but it comes later
        rises, falls = np.diff(score, prepend=0.0) >= 0.0, np.diff(score, append=0.0) < 0.0
        peaks = np.flatnonzero(rises & falls & (score >= _FIRST_PEAK_SHARE * score[best]))
        best = int(peaks[0]) if len(peaks) else best
    offset, (n_near, n_far) = float(candidates[best]), counts(best)
    if n_near < _MIN_ECHOES:
        raise UserError(
            what="the walls of the box do not stand out",
            expected=f"at least {_MIN_ECHOES} echoes along the prior's faces at one offset between "
            f"{search_m[0]:g} and {search_m[1]:g} m",
            got=n_near,
            hint="check that the prior lies in the scan's frame and in metres; widen "
            "--delay-search LOW HIGH where the delay was not recorded; a scan that faces no wall "
            "needs --delay-from reflector or sharpness",
        )
    return OffsetPeak(
        offset_m=offset,
        n_near=n_near,
        n_far=n_far,
        candidates_m=candidates,
        density=score / max(float(score.max()), 1e-300),
    )
