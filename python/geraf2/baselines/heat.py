"""Full-aperture heat maps inside a box, the input of all baselines."""

import numpy as np

from geraf2._types import Bools
from geraf2.errors import UserError
from geraf2.geometry.boxes import beyond_sides
from geraf2.scene import Grid, LosPrior
from geraf2.surfaces.extraction import prior_distance


def grid_inside(prior: LosPrior, spacing_m: float) -> Grid:
    """Grid over the bounding box of the prior.

    spacing_m: distance of voxels [m].
    """
    shape = np.ceil(np.asarray(prior.size_m) / spacing_m).astype(int) + 1
    return Grid.centered(prior.center_m, spacing_m, shape)


def counted_voxels(
    prior: LosPrior, grid: Grid, crop_m: float, *, num_threads: int | None = None
) -> Bools:
    """Voxels deeper than `crop_m` [m] in the innermost known box, grid.shape."""
    points, distance = grid.points(), prior_distance(prior, grid, num_threads)
    for wall in prior.walls[1:]:  # the largest distance is negative only inside the innermost
        beside = beyond_sides(points, wall.center_m, wall.size_m).max(axis=1)
        distance = np.maximum(distance, beside.reshape(grid.shape))
    counted = distance < -crop_m
    if not counted.any():
        raise UserError(
            what="cropping the box leaves nothing of it",
            expected="a crop below half of the smallest side",
            got=f"{crop_m:g} m",
        )
    return counted
