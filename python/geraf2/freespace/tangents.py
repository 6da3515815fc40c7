"""Places where lines of sight along the edge of an outline should touch the surface and miss it.

A line of sight at the edge of a shadow touches the content somewhere, with the content's normal
across the line: the outline tells two coordinates and the normal of a point of the surface, and the
fitted field where along the line it is, namely where the line comes nearest to the inside
(docs/math/free-space.md#tangents). So a shadow that reaches farther than the surface draws it out;
where the surface reaches farther it is cut in the end.
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.geometry.nearest import nearest_distance


@dataclass(frozen=True, kw_only=True, eq=False)
class Tangents:
    """Oriented points of the surface that outlines tell of."""

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
    """Where lines of sight at the edges of outlines miss the content; possibly none.

    sdf: signed distance of the content, as far as it is known.
    outlines: shadows; where one of them is free, no line of another touches anything.
    seen: places of glints, (n_glints, 3) [m].
    clearance_m: nearer to one than this there is no point: a glint is the better witness [m].
    """
    positions, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for number in range(len(outlines)):
        others = outlines.select(np.arange(len(outlines)) != number)
        found = _touching(sdf, others, int(outlines.axes[number]), *outlines.edge(number))
        positions.append(found.positions)
        normals.append(found.normals)
    points = np.concatenate(positions)
    distance = nearest_distance(points, seen, max_distance_m=clearance_m, num_threads=num_threads)
    clear = distance >= clearance_m
    return Tangents(positions=points[clear], normals=np.concatenate(normals)[clear])


def _touching(
    sdf: SdfGrid, others: Silhouettes, axis: int, edge: Floats, outward: Floats
) -> Tangents:
    """Points of lines along an axis, through (n, 2) [m], with normals across it, (n, 2).

    Only of those that pass outside of the surface.
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
    # A least value at the border of the grid is no touch.
    touch = np.nonzero(outside & (nearest > 0) & (nearest < n_samples[axis] - 1))[0]
    normals = np.zeros((len(touch), 3))
    normals[:, across] = outward[touch]
    return Tangents(positions=points[touch, nearest[touch]], normals=normals)
