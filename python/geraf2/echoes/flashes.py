"""Which peaks are flashes of the box's walls, for every step that asks.

A flat wall returns a flash along its normal, from the front or, through the box, from behind. A
peak is a flash if its direction is that of the normal and its range that of the wall's optical
middle, within three standard deviations of both together.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.wall_delay import (
    DELAY_SIGMA_M,
    LOSSES_DB,
    MIN_WALL_ECHOES,
    UNKNOWN_MIDDLES_M,
    loss_shifts,
    unknown_shift,
)
from geraf2.echoes.wall_faces import WallFaces
from geraf2.imaging.peaks import PeakSet
from geraf2.scene import Wall, Waveform

OFFSET_SIGMA_M, ANGLE_SIGMA_RAD = 0.004, 0.03
"""Standard deviations of a flash about a wall: of its range, since walls bulge by 1 to 3 mm and a
prior is off by 5 mm at most, and of its angle to the normal, by the slope of the bulge."""
N_SIGMAS = 3.0
"""Largest deviation of a flash from its wall, in standard deviations."""
MAX_OFFSET_M, MAX_ANGLE_RAD = N_SIGMAS * OFFSET_SIGMA_M, N_SIGMAS * ANGLE_SIGMA_RAD
"""The same as a distance and as an angle: what is nearer to a wall lies on it."""
OVERLAP = 4.0
"""Echoes that count as one: neighbouring sub-apertures overlap by halves in both directions."""
MIDDLE_SIGMA_M = 2e-4
"""Standard deviation of the middle of a known wall, in addition to that of its loss [m]: defocused
mirror images shift it."""


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
    angles_rad: Floats
    """Between the line of sight and the wall's normal, (n,) [rad]."""

    @property
    def side(self) -> Floats:
        """1 for a near wall, -1 for a far one, (n,)."""
        return np.where(self.far > 0, -1.0, 1.0)

    def deviations(self, middles: WallMiddles) -> Floats:
        """Distance of each from a flash of its wall, in standard deviations, (n,)."""
        off_m = self.offsets_m - np.array(middles.depths_m)[self.far]
        return np.asarray(np.hypot(off_m / OFFSET_SIGMA_M, self.angles_rad / ANGLE_SIGMA_RAD))

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
        angles_rad=np.arccos(np.minimum(cosines[index, walls], 1.0)),
    )
    return found.select(np.asarray(inside))


def find_flashes(peaks: PeakSet, faces: WallFaces, middles: WallMiddles) -> WallEchoes:
    """Peaks that are flashes of walls, each with its wall.

    peaks: with corrected delay. middles: of the walls; typical ones do where they are unknown.
    """
    maybe = wall_echoes(peaks, faces, MAX_ANGLE_RAD)
    return maybe.select(maybe.deviations(middles) < N_SIGMAS)


def learn_wall_delay(peaks: PeakSet, faces: WallFaces, waveform: Waveform) -> float:
    """Range correction for echoes from inside unknown walls, from the walls' own flashes [m].

    Walls have the thickness t and the index n = sqrt(eps), ranges a constant error b. The merged
    echo of the near wall's two faces lies n t / 2 + b behind its outer face. The far wall, seen
    through the near one, lies 3 n t / 2 - 2 t + b behind its outer face. Their mean is
    (n - 1) t + b, the delay of an echo from inside (docs/math/echoes.md#wall-delay). Without far
    wall, half of the near wall's offset is used, which is exact for n = 4/3. Walls whose faces
    cancel shift both, which is corrected. Without flashes the result is 0.
    """
    middles = WallMiddles.of((), waveform)
    found = find_flashes(peaks, faces, middles)
    near, far = (
        _weighted_median(found.offsets_m[own], peaks.magnitudes[found.index[own]])
        for own in (found.far == 0, found.far == 1)
    )
    if near is None:
        return 0.0
    learned = 0.5 * (near + (far or 0.0))
    shift, _ = unknown_shift(learned - 0.5 * sum(middles.depths_m), DELAY_SIGMA_M, waveform)
    return learned - shift


def _weighted_median(values: Floats, weights: Floats) -> float | None:
    """Median of the offsets of flashes; None where they are too few."""
    if len(values) < MIN_WALL_ECHOES:
        return None
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(share, 0.5 * share[-1])])
