"""Signed distance of a mesh on a grid, and operations on the inside of a field."""

import numpy as np

from geraf2._types import Floats, Progress
from geraf2._validation import require_shape
from geraf2.fields.sdf_grid import SdfGrid
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid

_MARGIN_VOXELS = 3.0
_PARTS = 50
"""Number of calls for a grid, so that progress is shown for a mesh of millions of triangles."""


def grid_about(bounds: Floats, n_longest: int) -> Grid:
    """Grid around a box (2, 3) [m], three voxels larger, `n_longest` along its longest side."""
    require_shape("bounds", bounds, (2, 3))
    if n_longest < 16:
        msg = f"n_longest must be at least 16, got {n_longest}"
        raise ValueError(msg)
    sides = bounds[1] - bounds[0]
    spacing = float(sides.max()) / (n_longest - 1 - 2.0 * _MARGIN_VOXELS)
    shape = np.ceil(sides / spacing).astype(int) + 1 + int(2 * _MARGIN_VOXELS)
    return Grid.centered(bounds.mean(axis=0), spacing, shape)


def mesh_distance(
    mesh: TriangleMesh,
    grid: Grid,
    *,
    closed: bool = True,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SdfGrid:
    """Signed distance to a mesh at the voxels of a grid, negative inside [m].

    mesh: surface, wound outwards.
    closed: whether the mesh is closed. Else a point is inside if its winding number is above one
        half, which closes holes smoothly but takes a time of voxels times triangles.

    Not differentiable.
    """
    scene = MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads)
    points, values = grid.points(), np.empty(grid.n_voxels, dtype=np.float32)
    step = -(-len(points) // _PARTS)
    for start in range(0, len(points), step):
        part = points[start : start + step]
        if closed:
            distance = scene.signed_distance(part)
        else:
            distance = scene.distance(part)
            distance[scene.winding_number(part) > 0.5] *= -1.0
        values[start : start + step] = distance
        if progress is not None:
            progress((start + len(part)) / len(points))
    return SdfGrid(grid=grid, values=values.reshape(grid.shape))


def cut_by_box(sdf: SdfGrid, bounds: Floats) -> SdfGrid:
    """Intersection of the inside of a field with a box: the larger of both distances.

    sdf: field, negative inside [m].
    bounds: smallest and largest coordinates of the box, (2, 3) [m]; infinite ones do not cut.

    The zero level stays closed. Beside the cut, values are lower bounds of the distance.
    """
    require_shape("bounds", bounds, (2, 3))
    values = sdf.values
    for axis, coordinates in enumerate(sdf.grid.axes_m):
        beyond = np.maximum(bounds[0, axis] - coordinates, coordinates - bounds[1, axis])
        shape = [1, 1, 1]
        shape[axis] = -1
        values = np.maximum(values, beyond.reshape(shape).astype(np.float32))
    return SdfGrid(grid=sdf.grid, values=values)


def largest_body(sdf: SdfGrid) -> SdfGrid:
    """Field with only the largest connected inside, its cavities filled by changes of the sign."""
    from scipy import ndimage  # noqa: PLC0415 - used here only

    labels, n_bodies = ndimage.label(sdf.values < 0.0)
    if not n_bodies:
        return sdf
    volumes = np.bincount(labels.ravel())
    volumes[0] = 0
    body = labels == volumes.argmax()
    filled = ndimage.binary_fill_holes(body)
    values = np.where((labels > 0) & ~filled, np.abs(sdf.values), sdf.values)
    values = np.where(filled & ~body, -np.abs(sdf.values), values)
    return SdfGrid(grid=sdf.grid, values=values.astype(np.float32))
