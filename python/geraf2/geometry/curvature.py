"""Curvature of a triangle mesh: the shape operator at each vertex."""

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints

_ALIKE = 0.5
"""Vertices whose normals have a smaller cosine are on another side of the body."""
_MIN_NEIGHBOURS = 6


def shape_operators(vertices: Floats, normals: Floats, at: Ints, reach_m: float) -> Floats:
    """Return the derivative of the normal along the surface at some vertices, (n, 3, 3) [1/m].

    Least squares of n_j - n = S (x_j - x) over the vertices within reach, both less their means; S
    is symmetric, without a component along the normal, and positive where the surface is convex.
    NaN where fewer than six vertices are in reach.

    vertices, normals: of the mesh, (n_vertices, 3). at: vertices (n,). reach_m: distance [m].
    """
    near = KDTree(vertices[at]).sparse_distance_matrix(
        KDTree(vertices), reach_m, output_type="ndarray"
    )
    i, j = near["i"], near["j"]
    alike = np.einsum("ij,ij->i", normals[at[i]], normals[j]) > _ALIKE
    i, j, n = i[alike], j[alike], len(at)
    tangents = _tangents(normals[at])
    step, turn = (
        np.einsum("pab,pb->pa", tangents[i], values[j] - values[at[i]])
        for values in (vertices, normals)
    )
    count = np.maximum(np.bincount(i, minlength=n), 1)
    step, turn = (x - _sums(i, x, n)[i] / count[i, None] for x in (step, turn))
    xx, yy, xy = (
        _sums(i, x[:, None], n)[:, 0]
        for x in (step[:, 0] ** 2, step[:, 1] ** 2, step[:, 0] * step[:, 1])
    )
    right = _sums(
        i,
        np.stack(
            [
                step[:, 0] * turn[:, 0],
                step[:, 1] * turn[:, 0] + step[:, 0] * turn[:, 1],
                step[:, 1] * turn[:, 1],
            ],
            axis=1,
        ),
        n,
    )
    zero = np.zeros(n)
    matrix = np.stack(
        [np.stack([xx, xy, zero], 1), np.stack([xy, xx + yy, xy], 1), np.stack([zero, xy, yy], 1)],
        axis=1,
    )
    good = (count >= _MIN_NEIGHBOURS) & (np.linalg.det(matrix) > 1e-9 * (xx + yy) ** 3)
    matrix[~good] = np.eye(3)
    a, b, c = np.linalg.solve(matrix, right[:, :, None])[:, :, 0].T
    flat = np.stack([np.stack([a, b], 1), np.stack([b, c], 1)], axis=1)
    found = tangents.transpose(0, 2, 1) @ flat @ tangents
    found[~good] = np.nan
    return np.asarray(found)


def _sums(group: Ints, values: Floats, n: int) -> Floats:
    return np.stack([np.bincount(group, column, minlength=n) for column in values.T], axis=1)


def _tangents(normals: Floats) -> Floats:
    """Two unit vectors across each normal, (n, 2, 3)."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, axis)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-30)
    return np.stack([first, np.cross(normals, first)], axis=1)
