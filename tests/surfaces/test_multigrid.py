import numpy as np
import pytest
import scipy.sparse as sp

from geraf2.fields import SdfGrid
from geraf2.ops.grid_energy import GridEnergy
from geraf2.scene import Grid
from geraf2.surfaces.linear_sdf import DistanceTarget, LinearSdf, OrientedPoints, SdfTerms
from geraf2.surfaces.multigrid import (
    coarser_length,
    largest_eigenvalue,
    prolong,
    restrict,
    restriction,
)
from reference import grid_energy as twin

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


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8, 9, 57])
def test_restriction_is_the_transpose_of_linear_interpolation(n):
    matrix = restriction(n)
    assert matrix.shape == (coarser_length(n), n)
    coarse = np.random.default_rng(n).standard_normal(coarser_length(n))
    expected = np.interp(np.linspace(0, 1, n), np.linspace(0, 1, len(coarse)), coarse)
    np.testing.assert_allclose(matrix.T @ coarse, expected, atol=1e-5)


@pytest.mark.parametrize("shape", [(9, 8, 5), (4, 17, 6), (3, 2, 7)])
def test_restriction_of_a_field_is_that_along_each_axis_and_prolongation_its_adjoint(shape):
    rng, matrices = np.random.default_rng(0), tuple(restriction(n) for n in shape)
    fine = rng.standard_normal(shape).astype(np.float32)
    coarse = rng.standard_normal([len(m) for m in matrices]).astype(np.float32)
    x, y, z = matrices
    expected = np.einsum("ai,bj,ck,ijk->abc", x, y, z, fine)
    np.testing.assert_allclose(restrict(fine, matrices), expected, atol=2e-6)
    expected = np.einsum("ai,bj,ck,abc->ijk", x, y, z, coarse)
    np.testing.assert_allclose(prolong(coarse, matrices), expected, atol=2e-6)


@pytest.mark.parametrize("with_target", [False, True])
def test_a_dozen_iterations_reach_the_converged_solution(with_target):
    start, points = sphere()
    target = None
    if with_target:
        voxels = np.arange(200, 900, 3)
        target = DistanceTarget(
            values=np.full(len(voxels), 0.01),
            voxels=voxels,
            weights=np.full(len(voxels), 0.1 / len(voxels)),
        )
    system, count = LinearSdf(start, points, TERMS), []
    found = system.solve(target, on_iteration=lambda: count.append(1))
    converged = system.solve(target, tolerance=1e-10, max_iterations=4000)
    assert 3 < len(count) < 15
    # 0.02 mm, the error that the default tolerance may leave
    np.testing.assert_allclose(found.values, converged.values, atol=2e-5)
    assert np.ptp(converged.values) > 0.02


def test_the_largest_eigenvalue_is_bounded():
    shape, n = (6, 7, 5), 210
    diagonal = np.random.default_rng(1).uniform(0.0, 0.5, n)
    made = GridEnergy(
        shape, (0.5, 0.5, 0.5), bending=0.4, sparse=sp.csr_matrix((n, n)), diagonal=diagonal
    )
    matrix = twin.matrix(shape, (0.5,) * 3, 0.4, np.zeros((n, n)), diagonal)
    true = np.linalg.eigvals(matrix / np.diag(matrix)[:, None]).real.max()
    assert true <= largest_eigenvalue(made) < 1.25 * true


def test_a_nan_in_the_right_side_ends_the_iterations():
    start, points = sphere((10, 10, 10))
    points.normals[5] = np.nan
    count = [0]
    LinearSdf(start, points, TERMS).solve(on_iteration=lambda: count.__setitem__(0, count[0] + 1))
    assert count[0] <= 1
