"""Walls of a prior, and the smooth shapes that cardboard takes.

A bulged wall is nearer to the planes that it faces, and farther from those that see it from
behind, through the box: opposite changes of range, where a delay changes both alike
(docs/math/calibration.md#delay-box-and-axis).
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.geometry.triangles import face_areas, unit_normals
from geraf2.scene import LosPrior

# Expected size of each mode [m]: place, two tilts, three bends, and the bulge that is held at the
# wall's rim. Cardboard of 0.2 m bulges by 1 to 3 mm; a carton is skewed by up to 0.5 degrees.
MODE_SIGMAS_M = np.array([0.0007, 0.001, 0.001, 0.0007, 0.0007, 0.0007, 0.003])
N_MODES = len(MODE_SIGMAS_M)
# Triangles are of one wall when their normals and planes differ by less than this.
_MAX_TURN_COSINE = np.cos(0.25)
_MAX_STEP_M = 0.02
# Smaller parts of the surface are no walls.
_MIN_AREA_SHARE = 0.03
# A rough surface has no more walls than it shows in so many triangles, the largest of what is left.
_MAX_SEEDS = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class WallFaces:
    """Nearly flat parts of a prior, each with two coordinates from -1 to 1 across it."""

    of_face: Ints
    """Wall of each triangle, -1 where it is none's, (n_faces,)."""
    centers: Floats
    """(n_walls, 3) [m]."""
    across: Floats
    """Directions along the wall, over half its extent, (n_walls, 2, 3) [1/m]."""

    @classmethod
    def of(cls, prior: LosPrior) -> "WallFaces":
        """Group triangles by normal and plane, the largest first."""
        corners = prior.vertices[prior.faces]
        normals, areas = unit_normals(corners), face_areas(corners)
        middles = corners.mean(axis=1)
        of_face = np.full(len(areas), -1, dtype=np.int64)
        centers, across = list[Floats](), list[Floats]()
        left = areas > 0.0
        for _ in range(_MAX_SEEDS):
            if not left.any():
                break
            seed = int(np.argmax(np.where(left, areas, 0.0)))
            step = np.abs((middles - middles[seed]) @ normals[seed])
            own = left & (normals @ normals[seed] > _MAX_TURN_COSINE) & (step < _MAX_STEP_M)
            own[seed] = True
            left &= ~own
            if areas[own].sum() < _MIN_AREA_SHARE * areas.sum():
                continue
            of_face[own] = len(centers)
            # The edge of the coordinate system nearest to the wall makes one of its directions.
            flat = np.eye(3)[int(np.argmin(np.abs(normals[seed])))]
            second = np.cross(normals[seed], flat)
            second /= np.linalg.norm(second)
            axes = np.stack([np.cross(second, normals[seed]), second])
            places = corners[own].reshape(-1, 3) @ axes.T
            low, high = places.min(axis=0), places.max(axis=0)
            height = float(np.average(middles[own] @ normals[seed], weights=areas[own]))
            centers.append(0.5 * (low + high) @ axes + height * normals[seed])
            across.append(axes / np.maximum(0.5 * (high - low), 1e-6)[:, None])
        return cls(
            of_face=of_face,
            centers=np.asarray(centers).reshape(-1, 3),
            across=np.asarray(across).reshape(-1, 2, 3),
        )

    def places(self, walls: Ints, points: Floats) -> Floats:
        """Coordinates across walls of points before or behind them, (n,), (n, 3) [m] -> (n, 2)."""
        return np.asarray(np.einsum("nki,ni->nk", self.across[walls], points - self.centers[walls]))

    def rim_bias(self, walls: Ints, points: Floats, axes: Floats, size_m: float) -> Floats:
        """How far off ranges of apertures are that look past a wall's rim in part, (n,) [m].

        What looks past it sends nothing back, so that the rest's middle lies nearer to the rim's
        middle, by up to half of what looks past; a range changes by the sine of the looking axis'
        angle to the wall's normal times that.

        points: middles of the apertures, (n, 3) [m]. axes: looking, horizontal and vertical axis
        of each, (n, 3, 3). size_m: side of each.
        """
        half_m = 1.0 / np.linalg.norm(self.across[walls], axis=2)
        along = np.abs(np.einsum("nki,nai->nka", self.across[walls] * half_m[..., None], axes))
        reach = half_m * np.abs(self.places(walls, points)) + 0.5 * size_m * along[..., 1:].sum(2)
        return np.asarray((0.5 * np.maximum(reach - half_m, 0.0) * along[..., 0]).sum(axis=1))

    def modes(self, walls: Ints, points: Floats) -> Floats:
        """Shapes of the walls at points before or behind them, (n,), (n, 3) [m] -> (n, n_modes)."""
        x, y = np.clip(self.places(walls, points), -1.0, 1.0).T
        bulge = (1.0 - x * x) * (1.0 - y * y)
        return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, bulge], axis=1)
