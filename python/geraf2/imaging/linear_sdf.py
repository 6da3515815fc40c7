"""Signed distance from glints: a linear least-squares fit, made a true distance in a few rounds.

The energy is quadratic in the grid values, so each round is one sparse linear solve by conjugate
gradients (docs/math.md, linear signed distance).
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from geraf2._validation import require_positive
from geraf2.fields import SdfGrid
from geraf2.scene import Grid

# All lengths inside this file are centimetres: values, gradients and second derivatives are then
# of order one, and so are the weights.
_CM = 100.0


@dataclass(frozen=True, kw_only=True)
class SdfTerms:
    """Weights of the energy; lengths in centimetres inside."""

    position: float
    """Of the weighted mean of f(p)^2."""
    normal: float
    """Of the weighted mean of |grad f(p) - n|^2."""
    bending: float
    """Of the mean of the squared Frobenius norm of the Hessian."""
    outside: float
    """Of the mean over the domain's faces of (f - outside_distance)^2."""
    outside_distance_m: float
    """Distance that the faces are pulled to [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedPoints:
    """What the fit reads of the glints."""

    positions: NDArray[np.float64]
    """(n, 3) [m]."""
    normals: NDArray[np.float64]
    """(n, 3)."""
    position_weights: NDArray[np.float64]
    """Sum 1, (n,)."""
    normal_weights: NDArray[np.float64]
    """Sum 1, (n,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceTarget:
    """Distances that the field is drawn to, voxel by voxel."""

    values: NDArray[np.float64]
    """(n_used,) [m]."""
    voxels: NDArray[np.int64]
    """Flat index of the voxels where they hold, (n_used,)."""
    weights: NDArray[np.float64]
    """Of (f - target)^2 at each, (n_used,)."""


class LinearSdf:
    """Quadratic energy of a signed distance on one grid."""

    def __init__(self, sdf: SdfGrid, points: OrientedPoints, terms: SdfTerms) -> None:
        """Assemble the normal equations on `sdf.grid`; its values are the starting point."""
        self._grid = sdf.grid
        self._start = sdf.values.astype(np.float64).ravel() * _CM
        spacing = sdf.grid.spacing_m * _CM
        value_rows, gradient_rows = _trilinear_rows(
            (points.positions - np.asarray(sdf.grid.origin_m)) / sdf.grid.spacing_m,
            sdf.grid.shape,
            spacing,
        )
        matrix = terms.bending * _bending_matrix(sdf.grid.shape, spacing)
        matrix = matrix + terms.position * _weighted_gram(value_rows, points.position_weights)
        right = np.zeros(sdf.grid.n_voxels)
        for axis, rows in enumerate(gradient_rows):
            matrix = matrix + terms.normal * _weighted_gram(rows, points.normal_weights)
            right += terms.normal * (rows.T @ (points.normal_weights * points.normals[:, axis]))
        faces = _face_mask(sdf.grid.shape)
        diagonal = (terms.outside / faces.sum()) * faces
        right += diagonal * (terms.outside_distance_m * _CM)
        self._matrix = (matrix + sp.diags(diagonal)).tocsr()
        self._right = right

    def solve(
        self,
        target: DistanceTarget | None = None,
        *,
        start: SdfGrid | None = None,
        tolerance: float = 1e-4,
        max_iterations: int = 400,
        on_iteration: Callable[[], None] | None = None,
    ) -> SdfGrid:
        """Minimise the energy, with the pull to `target` if given -> signed distance.

        Parameters
        ----------
        target
            Distances to be drawn to.
        start
            First guess on the same grid; that of the constructor when None.
        tolerance
            Of the residual relative to the right side.
        max_iterations
            Of the conjugate gradients; the field is smooth long before they converge fully.
        on_iteration
            Called after each iteration.
        """
        matrix, right = self._matrix, self._right
        if target is not None:
            pull = np.zeros(self._grid.n_voxels)
            pull[target.voxels] = target.weights
            matrix = matrix + sp.diags(pull)
            right = right.copy()
            right[target.voxels] += target.weights * target.values * _CM
        first = self._start if start is None else start.values.astype(np.float64).ravel() * _CM
        scale = sp.diags(1.0 / np.maximum(matrix.diagonal(), 1e-12))  # guards empty voxels
        callback = None if on_iteration is None else (lambda _: on_iteration())
        solution, _ = sp.linalg.cg(
            matrix,
            right,
            x0=first,
            rtol=tolerance,
            maxiter=max_iterations,
            M=scale,
            callback=callback,
        )
        values = (solution / _CM).reshape(self._grid.shape).astype(np.float32)
        return SdfGrid(grid=self._grid, values=values)


def resample(sdf: SdfGrid, spacing_m: float) -> SdfGrid:
    """Trilinear copy on a grid of another spacing over the same domain [m]."""
    require_positive("spacing_m", spacing_m)
    extent = np.asarray(sdf.grid.shape) - 1
    shape = np.maximum(np.rint(extent * sdf.grid.spacing_m / spacing_m).astype(int), 1) + 1
    grid = Grid(
        origin_m=sdf.grid.origin_m,
        spacing_m=spacing_m,
        shape=(int(shape[0]), int(shape[1]), int(shape[2])),
    )
    index = np.indices(grid.shape).reshape(3, -1) * (spacing_m / sdf.grid.spacing_m)
    values = map_coordinates(sdf.values, index, order=1, mode="nearest", output=np.float32)
    return SdfGrid(grid=grid, values=values.reshape(grid.shape))


def _trilinear_rows(
    index: NDArray[np.float64], shape: tuple[int, int, int], spacing: float
) -> tuple[sp.csr_matrix, list[sp.csr_matrix]]:
    """Rows that give a trilinear field's value and its three derivatives at points."""
    n_points = len(index)
    cell = np.clip(np.floor(index).astype(np.int64), 0, np.asarray(shape) - 2)
    t = index - cell
    columns, values = [], []
    gradients: list[list[NDArray[np.float64]]] = [[], [], []]
    for corner in product((0, 1), repeat=3):
        node = cell + np.asarray(corner)
        columns.append((node[:, 0] * shape[1] + node[:, 1]) * shape[2] + node[:, 2])
        weight = [t[:, k] if side else 1.0 - t[:, k] for k, side in enumerate(corner)]
        slope = [(1.0 if side else -1.0) / spacing for side in corner]
        values.append(weight[0] * weight[1] * weight[2])
        gradients[0].append(slope[0] * weight[1] * weight[2])
        gradients[1].append(weight[0] * slope[1] * weight[2])
        gradients[2].append(weight[0] * weight[1] * slope[2])
    column_index = np.stack(columns, axis=1).ravel()
    offsets = np.arange(0, 8 * n_points + 1, 8)
    size = (n_points, shape[0] * shape[1] * shape[2])

    def rows(entries: list[NDArray[np.float64]]) -> sp.csr_matrix:
        return sp.csr_matrix((np.stack(entries, axis=1).ravel(), column_index, offsets), shape=size)

    return rows(values), [rows(entries) for entries in gradients]


def _weighted_gram(rows: sp.csr_matrix, weights: NDArray[np.float64]) -> sp.csr_matrix:
    return rows.T @ sp.diags(weights) @ rows


def _bending_matrix(shape: tuple[int, int, int], spacing: float) -> sp.csr_matrix:
    """Assemble the normal matrix of the mean squared Frobenius norm of the Hessian.

    Second differences on lines, and mixed ones (counted twice) on cell faces.
    """
    second = [_second_difference(n, spacing) for n in shape]
    first = [_first_difference(n, spacing) for n in shape]
    same = [sp.identity(n, format="csr") for n in shape]
    total = sp.csr_matrix((np.prod(shape), np.prod(shape)))
    for axes in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        factors = list(same)
        if axes[0] == axes[1]:
            factors[axes[0]] = second[axes[0]]
            count = 1.0
        else:
            factors[axes[0]], factors[axes[1]] = first[axes[0]], first[axes[1]]
            count = 2.0
        n_rows = float(np.prod([factor.shape[0] for factor in factors]))
        # The Gram matrix of a Kronecker product is the product of the Gram matrices.
        grams = [factor.T @ factor for factor in factors]
        total = total + (count / n_rows) * sp.kron(sp.kron(grams[0], grams[1]), grams[2], "csr")
    return total


def _second_difference(n: int, spacing: float) -> sp.csr_matrix:
    ones = np.ones(n - 2)
    return sp.diags([ones, -2.0 * ones, ones], [0, 1, 2], shape=(n - 2, n), format="csr") / (
        spacing**2
    )


def _first_difference(n: int, spacing: float) -> sp.csr_matrix:
    ones = np.ones(n - 1)
    return sp.diags([-ones, ones], [0, 1], shape=(n - 1, n), format="csr") / spacing


def _face_mask(shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    mask = np.zeros(shape, dtype=bool)
    for axis in range(3):
        view = np.moveaxis(mask, axis, 0)
        view[0] = view[-1] = True
    return mask.ravel()
