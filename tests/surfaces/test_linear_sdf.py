import numpy as np
import pytest

from geraf2.fields import SdfGrid
from geraf2.scene import Grid
from geraf2.surfaces.linear_sdf import (
    LinearSdf,
    OrientedPoints,
    SdfTerms,
    resample,
)
from reference import quadratic_sdf as twin

TERMS = SdfTerms(position=30.0, normal=1.0, bending=0.3, outside=0.1, outside_distance_m=0.03)


def random_points(n, shape, seed=0):
    """Fractional indices inside the grid, on its faces too."""
    rng = np.random.default_rng(seed)
    index = rng.uniform(0.05, 0.95, (n, 3)) * (np.array(shape) - 1)
    index[0] = 0.0
    index[1] = np.array(shape) - 1
    return index


def test_the_solution_is_that_of_the_dense_twin():
    shape, spacing_m = (5, 5, 5), 0.008
    rng = np.random.default_rng(4)
    index = random_points(12, shape, seed=5)
    normals = rng.standard_normal((12, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = rng.uniform(0.2, 1.0, (2, 12))
    weights /= weights.sum(axis=1, keepdims=True)
    origin = np.array([0.1, -0.2, 0.05])
    grid = Grid(origin_m=tuple(origin), spacing_m=spacing_m, shape=shape)
    points = OrientedPoints(
        positions=origin + spacing_m * index,
        normals=normals,
        position_weights=weights[0],
        normal_weights=weights[1],
    )
    system = LinearSdf(SdfGrid(grid=grid, values=np.zeros(shape, np.float32)), points, TERMS)
    found = system.solve(tolerance=1e-12, max_iterations=4000)
    expected = twin.minimise(shape, 100.0 * spacing_m, index, normals, weights, TERMS)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(100.0 * found.values, expected, atol=1e-5 * np.ptp(expected))


@pytest.mark.parametrize(("spacing_m", "n"), [(0.005, 17), (0.02, 5), (0.01, 9)])
def test_resampling_keeps_a_linear_field(spacing_m, n):
    grid = Grid(origin_m=(0.1, -0.2, 0.3), spacing_m=0.01, shape=(9, 9, 9))
    slope = np.array([0.4, -0.7, 0.2])

    def plane(g):
        return (g.points() @ slope - 0.05).reshape(g.shape).astype(np.float32)

    fine = resample(SdfGrid(grid=grid, values=plane(grid)), spacing_m)
    assert fine.grid.shape == (n, n, n)
    assert fine.grid.origin_m == grid.origin_m
    np.testing.assert_allclose(fine.values, plane(fine.grid), atol=1e-7)
