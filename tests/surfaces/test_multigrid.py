import itertools

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

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


def data_term(grid, points):
    """Matrix and right side of the points' terms: weights of the eight corners, one by one."""
    matrix, right = np.zeros((grid.n_voxels,) * 2), np.zeros(grid.n_voxels)
    rows = zip(
        points.positions,
        points.normals,
        points.position_weights,
        points.normal_weights,
        strict=True,
    )
    for position, normal, position_weight, normal_weight in rows:
        at = position / grid.spacing_m
        low = np.floor(at).astype(int)
        corners = low + np.array(list(itertools.product((0, 1), repeat=3)))
        index = np.ravel_multi_index(corners.T, grid.shape)
        factor = 1.0 - np.abs(at - corners)
        slope = np.where(corners > low, 1.0, -1.0) / (100.0 * grid.spacing_m)
        block = TERMS.position * position_weight * np.outer(*[factor.prod(axis=1)] * 2)
        for axis in range(3):
            other = np.delete(factor, axis, axis=1).prod(axis=1)
            gradient = slope[:, axis] * other
            block += TERMS.normal * normal_weight * np.outer(gradient, gradient)
            right[index] += TERMS.normal * normal_weight * normal[axis] * gradient
        matrix[np.ix_(index, index)] += block
    return matrix, right


@pytest.mark.parametrize("with_target", [False, True])
def test_a_dozen_iterations_reach_the_direct_solution(with_target):
    start, points = sphere()
    grid, n = start.grid, start.grid.n_voxels
    target, pull, values = None, np.zeros(n), np.zeros(n)
    if with_target:
        voxels = np.arange(200, 900, 3)
        target = DistanceTarget(
            values=np.full(len(voxels), 0.01),
            voxels=voxels,
            weights=np.full(len(voxels), 0.1 / len(voxels)),
        )
        pull[voxels], values[voxels] = target.weights, 1.0
    faces = np.ones(grid.shape, dtype=bool)
    faces[1:-1, 1:-1, 1:-1] = False
    outside = TERMS.outside / faces.sum() * faces.ravel()
    data, right = data_term(grid, points)
    matrix = twin.matrix(grid.shape, (0.8,) * 3, TERMS.bending, data, pull + outside)
    right += 100.0 * TERMS.outside_distance_m * outside + pull * values
    expected = spsolve(sp.csc_matrix(matrix), right)
    count = [0]

    def counting():
        count[0] += 1

    found = LinearSdf(start, points, TERMS).solve(target, on_iteration=counting)
    assert 3 < count[0] < 15
    # 0.02 mm, the error that the default tolerance may leave
    np.testing.assert_allclose(1e3 * found.values.ravel(), 10.0 * expected, atol=0.02)
    assert np.ptp(10.0 * expected) > 20.0


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


def test_threads_change_no_bit():
    start, points = sphere((33, 32, 31))
    fields = [LinearSdf(start, points, TERMS, num_threads=n).solve().values for n in (1, 3)]
    assert np.array_equal(*fields)
