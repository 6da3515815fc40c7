"""Conjugate gradients for a grid energy, with a multigrid cycle as preconditioner.

Bending is a fourth-order operator. With only the diagonal as preconditioner, the number of
iterations grows with the square of the grid's side. A V-cycle of Chebyshev-smoothed levels reaches
micrometres in about twelve iterations (docs/math/surface-fit.md#solver). Source: Saad, Iterative
methods for sparse linear systems, 2003, chapters 12 and 13.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from geraf2._types import Floats
from geraf2.ops.grid_energy import GridEnergy

# Grids of at most this many voxels are solved directly: 9^3 take 10 ms.
DIRECT_VOXELS = 729
# Chebyshev steps before and after each coarse correction.
_DEGREE = 4
# Smallest eigenvalue of D^-1 A that is smoothed, relative to the largest. The smoothest waves that
# a coarser grid cannot represent have 1/36 of the largest.
_SMOOTHED_SHARE = 1.0 / 30.0
_POWER_STEPS = 20
_POWER_MARGIN = 1.1  # power iteration stops a little below the largest eigenvalue

Matrix = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """One grid of the hierarchy."""

    energy: GridEnergy
    """Energy in float32."""
    largest: float
    """Upper bound of the eigenvalues of D^-1 A."""
    to_coarser: tuple[Matrix, Matrix, Matrix]
    """Restriction along each axis, (n_coarse, n); the transpose of linear interpolation."""


def coarser_length(n: int) -> int:
    """Voxel count along an axis of the next coarser grid over the same domain."""
    return max(n // 2, 1) + 1


def restriction(n: int) -> Matrix:
    """Transpose of linear interpolation from the coarser axis, (n_coarse, n)."""
    n_coarse = coarser_length(n)
    index = np.linspace(0.0, n_coarse - 1.0, n)
    distance = np.abs(index - np.arange(n_coarse)[:, None])
    return np.maximum(1.0 - distance, 0.0).astype(np.float32)


def restrict(values: NDArray[np.float32], matrices: tuple[Matrix, Matrix, Matrix]) -> Matrix:
    """Restrict a field, (n_x, n_y, n_z), along each axis."""
    for axis in range(3):  # the x axis first: it needs no transposition and shrinks the rest
        values = _restrict_axis(values, matrices[axis], axis)
    return values


def prolong(values: NDArray[np.float32], matrices: tuple[Matrix, Matrix, Matrix]) -> Matrix:
    """Interpolate linearly along each axis: the adjoint of :func:`restrict`."""
    for axis in (2, 1, 0):
        values = _prolong_axis(values, matrices[axis], axis)
    return values


def _restrict_axis(values: Matrix, matrix: Matrix, axis: int) -> Matrix:
    n_coarse, n = matrix.shape
    if n != 2 * n_coarse - 1:
        return _apply_along(values, matrix, axis)
    # Every second voxel coincides with one of the coarser grid.
    fine = np.moveaxis(values, axis, 0)
    out = np.ascontiguousarray(values.take(range(0, n, 2), axis=axis))
    coarse, half = np.moveaxis(out, axis, 0), np.float32(0.5) * fine[1::2]
    coarse[:-1] += half
    coarse[1:] += half
    return out


def _prolong_axis(values: Matrix, matrix: Matrix, axis: int) -> Matrix:
    n_coarse, n = matrix.shape
    if n != 2 * n_coarse - 1:
        return _apply_along(values, matrix.T, axis)
    shape = list(values.shape)
    shape[axis] = n
    out = np.empty(shape, dtype=values.dtype)
    fine, coarse = np.moveaxis(out, axis, 0), np.moveaxis(values, axis, 0)
    fine[::2] = coarse
    np.add(coarse[:-1], coarse[1:], out=fine[1::2])
    fine[1::2] *= np.float32(0.5)
    return out


def _apply_along(values: Matrix, matrix: Matrix, axis: int) -> Matrix:
    if axis == 2:
        return np.asarray(np.matmul(values, matrix.T))
    if axis == 1:
        return np.asarray(np.matmul(matrix, values))
    return np.asarray((matrix @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:]))


def largest_eigenvalue(energy: GridEnergy) -> float:
    """Upper bound of the eigenvalues of D^-1 A, by power iteration."""
    diagonal = energy.diagonal()
    scale = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
    vector = np.random.default_rng(0).standard_normal(energy.n_voxels).astype(energy.dtype)
    size = 1.0
    for _ in range(_POWER_STEPS):
        vector = scale * energy.apply(vector)
        size = float(np.linalg.norm(vector))
        if size == 0.0:
            return _POWER_MARGIN
        vector /= size
    return _POWER_MARGIN * size


class Preconditioner:
    """One V-cycle: an approximate inverse, symmetric and positive definite."""

    def __init__(self, levels: list[Level], coarsest: GridEnergy) -> None:
        """Levels from fine to coarse; `coarsest`, in float64, is solved directly."""
        self._levels, self._coarsest = levels, coarsest
        unit = np.zeros(coarsest.n_voxels)
        columns = []
        for voxel in range(coarsest.n_voxels):
            unit[voxel] = 1.0
            columns.append(coarsest.apply(unit))
            unit[voxel] = 0.0
        matrix = np.stack(columns)
        # Keeps the matrix regular at voxels without any term.
        matrix.flat[:: len(matrix) + 1] += 1e-12 * float(np.trace(matrix)) / len(matrix)
        self._factor = cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)

    def __call__(self, right: Floats) -> Floats:
        """Approximate solution, (n_voxels,)."""
        if not self._levels:
            return self._solve(right)
        return self._cycle(0, right.astype(np.float32)).astype(np.float64)

    def _solve(self, right: Floats) -> Floats:
        return np.asarray(cho_solve(self._factor, right, check_finite=False))

    def _cycle(self, number: int, right: NDArray[np.float32]) -> NDArray[np.float32]:
        if number == len(self._levels):
            return self._solve(right.astype(np.float64)).astype(np.float32)
        level = self._levels[number]
        shape, largest = level.energy.shape, level.largest
        low = _SMOOTHED_SHARE * largest

        def smooth(field: NDArray[np.float32]) -> NDArray[np.float32]:
            return level.energy.smooth(right, field, degree=_DEGREE, low=low, high=largest)

        field = smooth(np.zeros_like(right))
        residual = right - level.energy.apply(field)
        coarse = restrict(residual.reshape(shape), level.to_coarser)
        coarse = self._cycle(number + 1, coarse.ravel()).reshape(coarse.shape)
        return smooth(field + prolong(coarse, level.to_coarser).ravel())


def conjugate_gradients(
    energy: GridEnergy,
    precondition: Callable[[Floats], Floats],
    right: Floats,
    start: Floats,
    *,
    tolerance: float,
    max_iterations: int,
    on_iteration: Callable[[], None] | None = None,
) -> Floats:
    """Solution of A f = right.

    energy: A, in float64.
    precondition: approximate inverse of A.
    right: (n_voxels,).
    start: first guess, (n_voxels,).
    tolerance: residual relative to the right side.
    max_iterations: stop after this many.
    on_iteration: called after each iteration.
    """
    solution = start.copy()
    residual = right - energy.apply(solution)
    goal = tolerance * float(np.linalg.norm(right))
    direction, product = np.zeros_like(right), 1.0
    for _ in range(max_iterations):
        if not float(np.linalg.norm(residual)) > goal:  # also stops on NaN
            break
        scaled = precondition(residual)
        previous, product = product, float(residual @ scaled)
        direction = scaled + (product / previous) * direction
        image = energy.apply(direction)
        step = product / float(direction @ image)
        solution += step * direction
        residual -= step * image
        if on_iteration is not None:
            on_iteration()
    return solution
