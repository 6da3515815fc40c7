"""Full-aperture heat maps inside a box, the input of all baselines."""

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.errors import UserError
from geraf2.geometry.boxes import beyond_sides
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid, LosPrior


def grid_inside(prior: LosPrior, spacing_m: float) -> Grid:
    """Grid over the bounding box of the prior.

    spacing_m: distance of voxels [m].
    """
    shape = np.ceil(np.asarray(prior.size_m) / spacing_m).astype(int) + 1
    return Grid.centered(prior.center_m, spacing_m, shape)


def wall_distance(prior: LosPrior, grid: Grid, *, num_threads: int | None = None) -> Floats:
    """Signed distance to the prior's surface and the outsides of known inner boxes, grid.shape [m].

    The largest of all, so that it is negative only inside the innermost.
    """
    points = grid.points()
    outer = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
    distance = outer.signed_distance(points)
    for wall in prior.walls[1:]:
        beside = beyond_sides(points, wall.center_m, wall.size_m)
        distance = np.maximum(distance, beside.max(axis=1))
    return distance.reshape(grid.shape)


def counted_voxels(
    prior: LosPrior, grid: Grid, crop_m: float, *, num_threads: int | None = None
) -> Bools:
    """Voxels deeper than `crop_m` [m] in the innermost known box, grid.shape."""
    counted = wall_distance(prior, grid, num_threads=num_threads) < -crop_m
    if not counted.any():
        raise UserError(
            what="cropping the box leaves nothing of it",
            expected="a crop below half of the smallest side",
            got=f"{crop_m:g} m",
        )
    return counted
