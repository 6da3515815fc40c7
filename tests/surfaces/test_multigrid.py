import numpy as np

from geraf2.fields import SdfGrid
from geraf2.scene import Grid
from geraf2.surfaces.linear_sdf import LinearSdf, OrientedPoints, SdfTerms

TERMS = SdfTerms(position=30.0, normal=1.0, bending=0.4, outside=0.1, outside_distance_m=0.03)


def sphere(shape=(13, 12, 11), n_points=200):
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((n_points, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    spacing = 0.008
    center = 0.5 * spacing * (np.array(shape) - 1)
    points = OrientedPoints(
        positions=center + 0.03 * normals,
        normals=normals,
        position_weights=np.full(n_points, 1 / n_points),
        normal_weights=np.full(n_points, 1 / n_points),
    )
    grid = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=spacing, shape=shape)
    return SdfGrid(grid=grid, values=np.zeros(shape, np.float32)), points


def test_a_dozen_iterations_reach_the_converged_solution():
    start, points = sphere()
    system, count = LinearSdf(start, points, TERMS), []
    found = system.solve(on_iteration=lambda: count.append(1))
    converged = system.solve(tolerance=1e-10, max_iterations=4000)
    assert 3 < len(count) < 15
    # 0.02 mm, the error that the default tolerance may leave
    np.testing.assert_allclose(found.values, converged.values, atol=2e-5)
    assert np.ptp(converged.values) > 0.02


def test_a_nan_in_the_right_side_ends_the_iterations():
    start, points = sphere((10, 10, 10))
    points.normals[5] = np.nan
    count = [0]
    LinearSdf(start, points, TERMS).solve(on_iteration=lambda: count.__setitem__(0, count[0] + 1))
    assert count[0] <= 1
