"""Echoes of the box's walls, and the instrument delay at which they lie on the prior.

A flat wall returns a flash along its normal, in a direction that does not depend on the delay. The
range minus the distance to the prior's wall is common to all near and far walls. Echoes of the
content have no such common offset (docs/math/calibration.md#delay-box-and-axis).
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.calibration.wall_faces import WallFaces
from geraf2.echoes.wall_delay import (
    LOSSES_DB,
    MIN_WALL_ECHOES,
    UNKNOWN_MIDDLES_M,
    loss_shifts,
    unknown_shift,
)
from geraf2.errors import UserError
from geraf2.imaging.peaks import MAX_RANGE_SHIFT_M, KeptPeaks, PeakSet, box_spans, collect_peaks
from geraf2.scene import Capture, LosPrior, Wall, Waveform

MIDDLE_SIGMA_M = 2e-4
"""Standard deviation of the middle of a known wall, in addition to that of its loss [m]: defocused
mirror images shift it."""

# Level of a wall's echo relative to the strongest peak; content may be 20 dB stronger.
_DYNAMIC_RANGE_DB = 26.0
# Half as many sub-apertures as for glints: walls have hundreds of echoes.
_STEP_M = 0.04
# Width of the walls' offset peak, which allows for a prior that is 5 mm off.
_OFFSET_SIGMA_M = 0.004
# Share of the near walls' largest density that replaces hidden far walls. It is enough to find a
# delay from near walls alone, and too small to interpret a far wall as a near one.
_MISSING_FAR_SHARE = 0.1
# Near walls alone are the first peak with this share of the highest.
_FIRST_PEAK_SHARE = 0.6
OVERLAP = 4.0
"""Echoes that count as one: neighbouring sub-apertures overlap by halves in both directions."""


def wall_peaks(
    capture: Capture,
    prior: LosPrior,
    range_shift_m: tuple[float, float],
    peaks: KeptPeaks,
) -> PeakSet:
    """Peaks of all planes at the prior's distance, or shifted by an unknown delay.

    range_shift_m: largest shift towards (negative) and away from the antennas, one-way [m].
    peaks: of the capture; planes are imaged again for ranges beyond these.
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
    """Positions of the walls' echoes behind their outer faces [m].

    Both faces of a wall lie in one range cell. With thickness t and index n, a near wall echoes
    from n t / 2 behind its outer face. A far wall, seen through the near one, echoes from
    3 n t / 2 - 2 t behind its own, within 0.5 mm of it for all cardboard. A loss weakens the second
    face; if both nearly cancel, the peak moves by millimetres (`loss_shift`).
    """

    depths_m: tuple[float, float]
    """Optical middles of near and of far walls."""
    sigmas_m: tuple[float, float, float]
    """Standard deviations of both, and of their common part."""
    loss_shift_m: float = 0.0
    """Part of both depths by which a loss moves the peak."""

    @classmethod
    def of(cls, walls: tuple[Wall, ...], waveform: Waveform) -> "WallMiddles":
        """Middles of the outermost wall, with inner boxes; typical values if unknown."""
        if not walls:
            near, far = UNKNOWN_MIDDLES_M
            return cls(depths_m=(near[0], far[0]), sigmas_m=(near[1], far[1], 0.0))
        excess = [(float(np.sqrt(w.permittivity)) - 1.0) * w.thickness_m for w in walls]
        near_m = 0.5 * (excess[0] + walls[0].thickness_m)
        far_m = 1.5 * excess[0] - 0.5 * walls[0].thickness_m + 2.0 * sum(excess[1:])
        shifts = [loss_shift(walls[0], waveform, loss_db) for loss_db in LOSSES_DB]
        shift, spread = float(np.mean(shifts)), float(np.std(shifts))
        return cls(
            depths_m=(near_m + shift, far_m + shift),
            sigmas_m=(MIDDLE_SIGMA_M, MIDDLE_SIGMA_M, spread),
            loss_shift_m=shift,
        )

    def at(self, offset_m: float, sigma_m: float, waveform: Waveform) -> "WallMiddles":
        """Middles of unknown walls whose peaks have this offset from the typical middles.

        sigma_m: expected error of the delay, one-way [m].
        """
        shift, spread = unknown_shift(offset_m, sigma_m, waveform)
        near, far = self.depths_m
        return WallMiddles(
            depths_m=(near + shift, far + shift),
            sigmas_m=(*self.sigmas_m[:2], spread),
            loss_shift_m=shift,
        )


@lru_cache(maxsize=64)
def loss_shift(wall: Wall, waveform: Waveform, loss_db: float) -> float:
    """Distance of a wall's peak behind the middle of its faces [m], as of `loss_shifts`."""
    index = float(np.sqrt(wall.permittivity))
    return float(loss_shifts(np.array([wall.thickness_m]), index, loss_db, waveform)[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class WallEchoes:
    """Pairs of a peak and a wall whose specular return it may be."""

    index: Ints
    """Index of the peak, (n,)."""
    walls: Ints
    """Index in `WallFaces`, (n,)."""
    far: Ints
    """1 for a far wall, seen from behind through the box, else 0, (n,)."""
    offsets_m: Floats
    """Range minus distance of the wall along the line of sight, (n,) [m]."""

    @property
    def side(self) -> Floats:
        """1 for a near wall, -1 for a far one, (n,)."""
        return np.where(self.far > 0, -1.0, 1.0)

    def select(self, keep: Bools) -> "WallEchoes":
        """Subset by mask."""
        return WallEchoes(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


def wall_echoes(echoes: PeakSet, faces: WallFaces, max_angle_rad: float) -> WallEchoes:
    """Peaks whose line of sight meets a wall along its normal, from the front or from behind."""
    heights = echoes.centers @ faces.normals.T - (faces.centers * faces.normals).sum(axis=1)
    cosines = -np.sign(heights) * (echoes.directions @ faces.normals.T)
    index, walls = np.nonzero(cosines > np.cos(max_angle_rad))
    distance = np.abs(heights)[index, walls] / cosines[index, walls]
    met = echoes.centers[index] + distance[:, None] * echoes.directions[index]
    inside = (np.abs(faces.coordinates(walls, met)) <= 1.0).all(axis=1)
    found = WallEchoes(
        index=index,
        walls=walls,
        far=(heights[index, walls] < 0.0).astype(np.int64),
        offsets_m=echoes.ranges_m[index] - distance,
    )
    return found.select(np.asarray(inside))


@dataclass(frozen=True, kw_only=True, eq=False)
class OffsetPeak:
    """Common offset of the walls' echoes."""

    offset_m: float
    n_near: int
    """Number of near walls' echoes within 1 cm of it."""
    n_far: int
    """Number of far walls' echoes."""
    candidates_m: Floats
    """Offsets of the search, (n,) [m]."""
    density: Floats
    """Combined density of near and far walls at each, 1 at the best, (n,)."""

    def less(self, shift_m: float) -> "OffsetPeak":
        """Return the same with all offsets less by `shift_m` [m]."""
        return replace(
            self, offset_m=self.offset_m - shift_m, candidates_m=self.candidates_m - shift_m
        )


def find_wall_peak(
    near: tuple[Floats, Floats],
    far: tuple[Floats, Floats],
    search_m: tuple[float, float],
    least: int = MIN_WALL_ECHOES,
) -> OffsetPeak:
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
    n_steps = max(2, round(4.0 * (search_m[1] - search_m[0]) / _OFFSET_SIGMA_M) + 1)
    candidates = np.linspace(*search_m, n_steps)

    def density(offsets_m: Floats, magnitudes: Floats) -> Floats:
        scaled = (candidates[:, None] - offsets_m[None]) / _OFFSET_SIGMA_M
        return np.asarray(np.exp(-0.5 * scaled**2) @ np.sqrt(magnitudes))

    of_near, of_far = density(*near), density(*far)
    score = np.sqrt(of_near * (of_far + _MISSING_FAR_SHARE * of_near.max(initial=0.0)))

    def counts(best: int) -> list[int]:
        return [int((np.abs(kind[0] - candidates[best]) < 0.01).sum()) for kind in (near, far)]

    best = int(score.argmax())
    if counts(best)[1] < least:  # content, which may be as dense, is farther away
        rises, falls = np.diff(score, prepend=0.0) >= 0.0, np.diff(score, append=0.0) < 0.0
        peaks = np.flatnonzero(rises & falls & (score >= _FIRST_PEAK_SHARE * score[best]))
        best = int(peaks[0]) if len(peaks) else best
    offset, (n_near, n_far) = float(candidates[best]), counts(best)
    if n_near < least or best in (0, n_steps - 1):  # a maximum at the edge is no peak
        raise walls_not_seen(n_near, search_m, least)
    return OffsetPeak(
        offset_m=offset,
        n_near=n_near,
        n_far=n_far,
        candidates_m=candidates,
        density=score / max(float(score.max()), 1e-300),
    )


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
