"""Distance of meshes on grids: boxes, holes, cuts."""

import numpy as np
import pytest

from geraf2.fields.mesh_distance import cut_by_box, grid_about, mesh_distance
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import LosPrior

BOUNDS = np.array([[-0.1, -0.05, 0.0], [0.1, 0.05, 0.08]])


def box_mesh():
    prior = LosPrior.from_box((0.2, 0.1, 0.08), (0.0, 0.0, 0.04))
    return TriangleMesh(vertices=prior.vertices, faces=prior.faces)


def box_distance(points):
    outside = np.maximum(BOUNDS[0] - points, points - BOUNDS[1])
    return np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)


def test_the_grid_contains_the_bounds():
    grid = grid_about(BOUNDS, 40)
    assert max(grid.shape) == 40
    for axis, coordinates in enumerate(grid.axes_m):
        assert coordinates[0] < BOUNDS[0, axis] - 2.9 * grid.spacing_m
        assert coordinates[-1] > BOUNDS[1, axis] + 2.9 * grid.spacing_m
    with pytest.raises(ValueError, match="n_longest"):
        grid_about(BOUNDS, 8)


@pytest.mark.parametrize("closed", [True, False])
def test_distance_of_a_box(closed):
    grid = grid_about(BOUNDS, 40)
    sdf = mesh_distance(box_mesh(), grid, closed=closed)
    np.testing.assert_allclose(sdf.values.ravel(), box_distance(grid.points()), atol=1e-6)


def test_a_hole_keeps_the_inside():
    mesh = box_mesh()
    open_mesh = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[1:])
    grid = grid_about(BOUNDS, 32)
    got = mesh_distance(open_mesh, grid, closed=False).values.ravel() < 0
    expected = box_distance(grid.points()) < 0
    # half of one end is missing: only points beside it may change sides
    differing = grid.points()[got != expected]
    assert (got & expected).sum() > 0.95 * expected.sum()
    assert (np.abs(np.abs(differing[:, 0]) - 0.1) < 0.04).all()


def test_a_cut_is_an_intersection():
    grid = grid_about(BOUNDS, 40)
    sdf = mesh_distance(box_mesh(), grid)
    cut = cut_by_box(sdf, np.array([[-np.inf, -np.inf, 0.03], [np.inf, 0.01, np.inf]]))
    points = grid.points()
    inside = (sdf.values.ravel() < 0) & (points[:, 2] > 0.03) & (points[:, 1] < 0.01)
    np.testing.assert_array_equal(cut.values.ravel() < 0, inside)
    assert (cut.values >= sdf.values).all()
