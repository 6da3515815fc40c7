"""Walls of a prior: flat groups of its triangles, and the smooth shapes of cardboard.

A bulged wall is nearer to the planes that face it, and farther from those that see it from behind,
through the box. Ranges change in opposite directions, but a delay changes both equally
(docs/math/calibration.md#delay-and-box).
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.geometry.triangles import face_areas, unit_normals
from geraf2.scene import LosPrior

_WAVES = np.array([(m, n) for m in (1, 2, 3) for n in (1, 2, 3)])
MODE_SIGMAS_M: Floats = np.array([0.0007, 0.001, 0.001, *(0.003 / (_WAVES**2).sum(axis=1))])
"""Standard deviation of each shape of a carton's wall [m]: position, two tilts, and the nine
longest standing waves of a plate with a fixed rim."""
N_MODES = len(MODE_SIGMAS_M)
MIDDLE_BULGE = np.array([0.0, 0.0, 0.0, *np.sin(0.5 * np.pi * _WAVES).prod(axis=1)])
"""Displacement of a wall's middle relative to its rim, for each shape."""
# Least cosine between normals, and largest distance from the plane [m], of one wall's triangles.
_MAX_TURN_COSINE, _MAX_STEP_M = np.cos(0.25), 0.02
# Least share of the surface's area of a wall.
_MIN_AREA_SHARE = 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class WallFaces:
    """Nearly flat parts of a prior, each with two coordinates from -1 to 1 along it."""

    centers: Floats
    """(n_walls, 3) [m]."""
    normals: Floats
    """Outward unit normals, (n_walls, 3)."""
    across: Floats
    """Directions along the wall, divided by half its extent, (n_walls, 2, 3) [1/m]."""

    @classmethod
    def of(cls, prior: LosPrior) -> "WallFaces":
        """Group triangles by normal and plane, the largest first."""
        corners = prior.vertices[prior.faces]
        normals, areas = unit_normals(corners), face_areas(corners)
        middles = corners.mean(axis=1)
        walls = list[tuple[Floats, Floats, Floats]]()
        remaining = areas > 0.0
        # The areas limit the number of walls; a rough surface also has parts that are too small.
        for _ in range(2 * int(1.0 / _MIN_AREA_SHARE)):
            if not remaining.any():
                break
            seed = int(np.argmax(np.where(remaining, areas, 0.0)))
            step = np.abs((middles - middles[seed]) @ normals[seed])
            own = remaining & (normals @ normals[seed] > _MAX_TURN_COSINE) & (step < _MAX_STEP_M)
            own[seed] = True
            remaining &= ~own
            if areas[own].sum() >= _MIN_AREA_SHARE * areas.sum():
                mean = (areas[own, None] * normals[own]).sum(axis=0)
                height = np.average(middles[own], axis=0, weights=areas[own])
                walls.append(_wall(mean / np.linalg.norm(mean), height, corners[own]))
        centers, directions, across = zip(*walls, strict=True) if walls else ([], [], [])
        return cls(
            centers=np.asarray(centers).reshape(-1, 3),
            normals=np.asarray(directions).reshape(-1, 3),
            across=np.asarray(across).reshape(-1, 2, 3),
        )

    @classmethod
    def of_planes(cls, normals: Floats, offsets_m: Floats) -> "WallFaces":
        """Planes without a rim. normals: outward, (n, 3). offsets_m: from the origin, (n,) [m]."""
        none = np.zeros((len(normals), 2, 3))
        return cls(centers=offsets_m[:, None] * normals, normals=normals, across=none)

    def coordinates(self, walls: Ints, points: Floats) -> Floats:
        """Coordinates along walls of points in front or behind, (n,), (n, 3) [m] -> (n, 2)."""
        return np.asarray(np.einsum("nki,ni->nk", self.across[walls], points - self.centers[walls]))

    def rim_bias(self, walls: Ints, points: Floats, axes: Floats, size_m: float) -> Floats:
        """Range error of apertures that extend beyond a wall's rim, (n,) [m].

        The part beyond receives no echo, which shifts the effective centre by up to half of that
        part. The range changes by this shift times the sine between looking axis and normal.

        points: centres of the apertures, (n, 3) [m]. axes: looking, horizontal and vertical axis
        of each, (n, 3, 3). size_m: side of each.
        """
        half_m = 1.0 / np.linalg.norm(self.across[walls], axis=2)
        along = np.abs(np.einsum("nki,nai->nka", self.across[walls] * half_m[..., None], axes))
        outer = half_m * np.abs(self.coordinates(walls, points))
        reach = outer + 0.5 * size_m * along[..., 1:].sum(2)
        return np.asarray((0.5 * np.maximum(reach - half_m, 0.0) * along[..., 0]).sum(axis=1))

    def modes(self, walls: Ints, points: Floats) -> tuple[Floats, Floats]:
        """Shapes at points in front of or behind walls, and their slopes along the wall.

        walls, points: (n,), (n, 3) [m]. Returns values, (n, n_modes), and derivatives along the
        unit vectors of `across`, (n, 2, n_modes) [1/m].
        """
        position = np.clip(self.coordinates(walls, points), -1.0, 1.0)
        rates = 0.5 * np.pi * _WAVES
        angles = (position[:, None] + 1.0) * rates
        sines, cosines = np.sin(angles), rates * np.cos(angles)
        one, none = np.ones(len(position)), np.zeros(len(position))
        values = np.column_stack([one, position, sines.prod(axis=2)])
        slopes = np.stack(
            [
                np.column_stack([none, one, none, cosines[..., 0] * sines[..., 1]]),
                np.column_stack([none, none, one, sines[..., 0] * cosines[..., 1]]),
            ],
            axis=1,
        )
        return values, slopes * np.linalg.norm(self.across[walls], axis=2)[..., None]


def _wall(normal: Floats, middle: Floats, corners: Floats) -> tuple[Floats, Floats, Floats]:
    """Centre, normal and directions of one wall; middle: a point of its plane, (3,) [m]."""
    # The frame's axis most nearly parallel to the wall defines one of its directions.
    flat = np.eye(3)[int(np.argmin(np.abs(normal)))]
    second = np.cross(normal, flat)
    second /= np.linalg.norm(second)
    axes = np.stack([np.cross(second, normal), second])
    projected = corners.reshape(-1, 3) @ axes.T
    low, high = projected.min(axis=0), projected.max(axis=0)
    center = 0.5 * (low + high) @ axes + float(middle @ normal) * normal
    return center, normal, axes / np.maximum(0.5 * (high - low), 1e-6)[:, None]
