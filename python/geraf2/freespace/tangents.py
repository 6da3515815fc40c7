"""Tangent points: where lines of sight along the edge of an outline should touch the surface.

A line of sight at the edge of a shadow is tangent to the content. The outline gives two coordinates
of the tangent point and its normal, which is perpendicular to the line. The third coordinate is
where the line passes nearest to the fitted content (docs/math/free-space.md#tangents). A shadow
larger than the surface therefore moves the surface outwards; a smaller shadow cuts it later.
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.geometry.nearest import nearest_distance


@dataclass(frozen=True, kw_only=True, eq=False)
class Tangents:
    """Oriented points of the surface from outlines."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """Outward unit normals, (n, 3)."""

    def __len__(self) -> int:
        return int(self.positions.shape[0])


def tangent_points(
    sdf: SdfGrid,
    outlines: Silhouettes,
    seen: Floats,
    clearance_m: float,
    *,
    num_threads: int | None = None,
) -> Tangents:
    """Tangent points of lines of sight at outlines' edges that miss the content; possibly none.

    sdf: signed distance of the content so far.
    outlines: silhouettes; a point in the free space of another outline is not used.
    seen: positions of glints, (n_glints, 3) [m].
    clearance_m: least distance of a tangent point to a glint, which is more accurate [m].
    """
    positions, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for number in range(len(outlines)):
        others = outlines.select(np.arange(len(outlines)) != number)
        found = _tangents_along(sdf, others, int(outlines.axes[number]), *outlines.edge(number))
        positions.append(found.positions)
        normals.append(found.normals)
    points = np.concatenate(positions)
    distance = nearest_distance(points, seen, max_distance_m=clearance_m, num_threads=num_threads)
    clear = distance >= clearance_m
    return Tangents(positions=points[clear], normals=np.concatenate(normals)[clear])


def _tangents_along(
    sdf: SdfGrid, others: Silhouettes, axis: int, edge: Floats, outward: Floats
) -> Tangents:
    """Tangent points of lines along an axis that pass outside of the surface.

    edge: positions of the lines across the axis, (n, 2) [m]. outward: normals there, (n, 2).
    """
    grid, across = sdf.grid, [k for k in range(3) if k != axis]
    low, n_samples = np.asarray(grid.origin_m), np.asarray(grid.shape)
    last = (low + grid.spacing_m * (n_samples - 1))[across]
    inside = ((edge > low[across]) & (edge < last)).all(axis=1)
    edge, outward = edge[inside], outward[inside]
    points = np.empty((len(edge), n_samples[axis], 3))
    points[:, :, across] = edge[:, None]
    points[:, :, axis] = low[axis] + grid.spacing_m * np.arange(n_samples[axis])
    field = sdf.sample(points.reshape(-1, 3)).reshape(points.shape[:2])
    free_m = others.free_distance(points.reshape(-1, 3)).reshape(field.shape)
    nearest = np.maximum(field, free_m).argmin(axis=1)
    outside = field[np.arange(len(field)), nearest] > 0.0
    # A minimum at the border of the grid is no tangent point.
    touch = np.nonzero(outside & (nearest > 0) & (nearest < n_samples[axis] - 1))[0]
    normals = np.zeros((len(touch), 3))
    normals[:, across] = outward[touch]
    return Tangents(positions=points[touch, nearest[touch]], normals=normals)
