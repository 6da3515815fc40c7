"""Analytic unified signed distance of nested sets: cartons, walls, content."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geraf2._types import Floats
from geraf2._validation import require_positive, require_shape
from geraf2.geometry.boxes import beyond_sides, box_corners
from geraf2.records import Wall

Points = Floats


class Solid(Protocol):
    """A closed, compact set."""

    def signed_distance(self, points: Points) -> Floats:
        """Distance to the boundary, negative inside, (n, 3) [m] -> (n,) [m]."""
        ...

    def corners(self) -> Points:
        """Points of the closure whose convex hull contains the set, (n, 3) [m]."""
        ...


@dataclass(frozen=True, kw_only=True)
class BoxSolid:
    """A box with axes along the frame's."""

    size_m: tuple[float, float, float]
    """Side lengths [m]."""
    center_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre [m]."""

    def __post_init__(self) -> None:
        for side in self.size_m:
            require_positive("size_m", side)

    def signed_distance(self, points: Points) -> Floats:
        """Exact distance to the boundary, negative inside, (n, 3) [m] -> (n,) [m]."""
        q = beyond_sides(points, self.center_m, self.size_m)
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
        return np.asarray(outside + np.minimum(q.max(axis=1), 0.0))

    def corners(self) -> Points:
        """Its eight corners, (8, 3) [m]."""
        return box_corners(self.center_m, self.size_m)


@dataclass(frozen=True, kw_only=True)
class SphereSolid:
    """A ball."""

    radius_m: float
    """Radius [m]."""
    center_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre [m]."""

    def __post_init__(self) -> None:
        require_positive("radius_m", self.radius_m)

    def signed_distance(self, points: Points) -> Floats:
        """Exact distance to the boundary, negative inside, (n, 3) [m] -> (n,) [m]."""
        distance = np.linalg.norm(points - np.asarray(self.center_m), axis=1)
        return np.asarray(distance - self.radius_m)

    def corners(self) -> Points:
        """Points on the sphere along the axes, (6, 3) [m]."""
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        return np.asarray(np.asarray(self.center_m) + self.radius_m * axes)


class NestedSets:
    r"""Nested sets M_1, M_2, ... and the unified signed distance f of their regions.

    .. math:: f(x) = \pm \min\left(d(x, \partial M_i), d(x, \partial M_{i+1})\right),
              \quad x \in R_{i,i+1}

    Region R_{i,i+1} lies in M_i and not in M_{i+1}. f is negative where the region interacts
    strongly with radio waves (carton, metal), and positive elsewhere (air, also inside the box).

    solids: M_1, M_2, ..., each in the interior of the one before; any number.
    strong: whether R_{i,i+1}, just inside M_i, interacts strongly, one entry per solid. R_{0,1},
        outside all, is air.

    Raises ValueError if a corner of a solid is not inside the one before it.

    Equations 5 to 11 of the paper (nested sets, regions, sign, distance). A path from a point to
    another boundary crosses one of the two of its region, so the minimum may include all.
    """

    def __init__(self, solids: Sequence[Solid], strong: Sequence[bool]) -> None:
        if not solids or len(solids) != len(strong):
            msg = (
                "solids and strong must hold one entry per set and at least one, "
                f"got {len(solids)} and {len(strong)}"
            )
            raise ValueError(msg)
        for number in range(1, len(solids)):
            depth = float(solids[number - 1].signed_distance(solids[number].corners()).max())
            if depth >= 0.0:
                msg = (
                    f"solids[{number}] must lie inside solids[{number - 1}], "
                    f"got a corner {1e3 * depth:.3g} mm outside it"
                )
                raise ValueError(msg)
        self.solids = tuple(solids)
        self.strong = tuple(bool(value) for value in strong)

    @classmethod
    def from_walls(cls, walls: Sequence[Wall], content: Solid | None = None) -> "NestedSets":
        """Make sets of walls, outermost first, as strong shells around air, and of a content."""
        solids: list[Solid] = []
        strong: list[bool] = []
        for wall in walls:
            solids.append(BoxSolid(size_m=wall.size_m, center_m=wall.center_m))
            solids.append(BoxSolid(size_m=wall.inner_size_m, center_m=wall.center_m))
            strong += [True, False]
        if content is not None:
            solids.append(content)
            strong.append(True)
        return cls(solids, strong)

    def signed_distance(self, points: Points) -> Floats:
        """Unified signed distance at points (n, 3) [m] -> (n,) [m]. Not differentiable."""
        require_shape("points", points, (None, 3))
        distances = np.stack([solid.signed_distance(points) for solid in self.solids])
        # The region of a point is the number of sets that contain it.
        depth = (distances <= 0.0).sum(axis=0)
        sign = np.where(np.array([False, *self.strong])[depth], -1.0, 1.0)
        return np.asarray(sign * np.abs(distances).min(axis=0))
