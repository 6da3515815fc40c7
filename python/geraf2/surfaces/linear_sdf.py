"""Signed distance from glints by linear least squares.

The energy is quadratic in the grid values. Its minimum is found by conjugate gradients with a
multigrid cycle (docs/math/surface-fit.md#linear-signed-distance).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.sparse as sp

from geraf2._types import Floats, Ints
from geraf2._validation import require_positive
from geraf2.fields import SdfGrid
from geraf2.ops.grid_energy import GridEnergy
from geraf2.scene import Grid
from geraf2.surfaces.multigrid import (
    DIRECT_VOXELS,
    Level,
    Preconditioner,
    coarser_length,
    conjugate_gradients,
    largest_eigenvalue,
    restriction,
)

# Lengths in this file are centimetres: values, gradients and second derivatives then have order
# one, and so have the weights.
CM = 100.0
_MAX_ITERATIONS = 100  # of the conjugate gradients; about twelve are usual


@dataclass(frozen=True, kw_only=True)
class SdfTerms:
    """Weights of the terms of the energy, with lengths in centimetres."""

    position: float
    """Weight of the weighted mean of f(p)^2."""
    normal: float
    """Weight of the weighted mean of |grad f(p) - n|^2."""
    bending: float
    """Weight of the mean of the squared Frobenius norm of the Hessian."""
    outside: float
    """Weight of the mean over the domain's faces of (f - outside_distance)^2."""
    outside_distance_m: float
    """Assumed distance at the domain's faces [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedPoints:
    """Positions and normals of the fit, with weights."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """(n, 3)."""
    position_weights: Floats
    """Relative to each other, (n,)."""
    normal_weights: Floats
    """Relative to each other, (n,)."""

    def normalised(self) -> "OrientedPoints":
        """Return the same points with weights of sum 1."""
        position, normal = self.position_weights, self.normal_weights
        return replace(
            self, position_weights=position / position.sum(), normal_weights=normal / normal.sum()
        )


class LinearSdf:
    """Quadratic energy of a signed distance on one grid."""

    def __init__(
        self,
        sdf: SdfGrid,
        points: OrientedPoints,
        terms: SdfTerms,
        *,
        num_threads: int | None = None,
    ) -> None:
        """Prepare the normal equations on `sdf.grid`; its values start the solver."""
        points = points.normalised()
        self._grid, self._terms, self._num_threads = sdf.grid, terms, num_threads
        self._start = sdf.values.astype(np.float64).ravel() * CM
        spacing = sdf.grid.spacing_m * CM
        position = (points.positions - np.asarray(sdf.grid.origin_m)) * CM
        self._right = np.zeros(sdf.grid.n_voxels)
        for axis, rows in enumerate(_gradient_rows(position / spacing, sdf.grid.shape, spacing)):
            weighted = points.normal_weights * points.normals[:, axis]
            self._right += terms.normal * (rows.T @ weighted)
        self._right += _face_pull(sdf.grid.shape, terms) * (terms.outside_distance_m * CM)

        self._sizes = [_Size(shape=sdf.grid.shape, spacing=(spacing, spacing, spacing))]
        while np.prod(self._sizes[-1].shape) > DIRECT_VOXELS:
            self._sizes.append(self._sizes[-1].coarser())
        self._data = [_data_matrix(size, position, points, terms) for size in self._sizes]

    def solve(
        self,
        *,
        tolerance: float = 1e-5,
        max_iterations: int = _MAX_ITERATIONS,
        on_iteration: Callable[[], None] | None = None,
    ) -> SdfGrid:
        """Minimise the energy -> signed distance.

        tolerance: residual relative to the right side; 1e-5 leaves 0.02 mm of error.
        max_iterations: of the conjugate gradients.
        on_iteration: called after each iteration.
        """
        solution = conjugate_gradients(
            self._energy(0, np.float64),
            self._preconditioner(),
            self._right,
            self._start,
            tolerance=tolerance,
            max_iterations=max_iterations,
            on_iteration=on_iteration,
        )
        values = (solution / CM).reshape(self._grid.shape).astype(np.float32)
        return SdfGrid(grid=self._grid, values=values)

    def _energy(self, level: int, dtype: type[np.float32] | type[np.float64]) -> GridEnergy:
        size = self._sizes[level]
        return GridEnergy(
            size.shape,
            size.spacing,
            bending=self._terms.bending,
            sparse=self._data[level],
            diagonal=_face_pull(size.shape, self._terms),
            dtype=dtype,
            num_threads=self._num_threads,
        )

    def _preconditioner(self) -> Preconditioner:
        """Levels with the energy discretised on each grid."""
        levels = []
        for number, size in enumerate(self._sizes[:-1]):
            energy = self._energy(number, np.float32)
            x, y, z = (restriction(n) for n in size.shape)
            largest = largest_eigenvalue(energy)
            levels.append(Level(energy=energy, largest=largest, to_coarser=(x, y, z)))
        return Preconditioner(levels, self._energy(len(levels), np.float64))


@dataclass(frozen=True, kw_only=True)
class _Size:
    """Grid of one level over the domain of the finest; lengths in centimetres."""

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]

    def coarser(self) -> "_Size":
        shape = [coarser_length(n) for n in self.shape]
        spacing = [
            length * (fine - 1) / (coarse - 1)
            for length, fine, coarse in zip(self.spacing, self.shape, shape, strict=True)
        ]
        return _Size(
            shape=(shape[0], shape[1], shape[2]), spacing=(spacing[0], spacing[1], spacing[2])
        )


def resample(sdf: SdfGrid, spacing_m: float) -> SdfGrid:
    """Resample a field on a grid of another spacing [m] over the same domain, trilinearly."""
    require_positive("spacing_m", spacing_m)
    extent = np.asarray(sdf.grid.shape) - 1
    shape = np.maximum(np.rint(extent * sdf.grid.spacing_m / spacing_m).astype(int), 1) + 1
    grid = Grid(
        origin_m=sdf.grid.origin_m,
        spacing_m=spacing_m,
        shape=(int(shape[0]), int(shape[1]), int(shape[2])),
    )
    index = np.indices(grid.shape).reshape(3, -1) * (spacing_m / sdf.grid.spacing_m)
    from scipy.ndimage import map_coordinates  # noqa: PLC0415 - 0.2 s that other commands save

    values = map_coordinates(sdf.values, index, order=1, mode="nearest", output=np.float32)
    return SdfGrid(grid=grid, values=values.reshape(grid.shape))


def trilinear_rows(index: Floats, shape: tuple[int, int, int]) -> sp.csr_matrix:
    """Sparse rows for a trilinear field's value at points; index: in voxels, (n, 3)."""
    columns, along = _corners(index, shape)
    return _rows(along.prod(axis=0), columns, shape)


def _gradient_rows(
    index: Floats, shape: tuple[int, int, int], spacing: float
) -> list[sp.csr_matrix]:
    """Sparse rows for the three derivatives of a trilinear field at points."""
    columns, along = _corners(index, shape)
    return [_rows(of, columns, shape) for of in _slopes(along, np.full(3, spacing))]


def _rows(entries: Floats, columns: Ints, shape: tuple[int, int, int]) -> sp.csr_matrix:
    offsets = np.arange(0, columns.size + 1, 8)
    size = (len(columns), int(np.prod(shape)))
    return sp.csr_matrix((entries.ravel(), columns.ravel(), offsets), shape=size)


def _corners(index: Floats, shape: tuple[int, int, int]) -> tuple[Ints, Floats]:
    """Voxels around each point, (n, 8), and their weights along each axis, (3, n, 8)."""
    cell = np.clip(np.floor(index).astype(np.int64), 0, np.asarray(shape) - 2)
    t = index - cell
    columns, along = np.empty((len(index), 8), dtype=np.int64), np.empty((3, len(index), 8))
    for corner, sides in enumerate(product((0, 1), repeat=3)):
        node = cell + np.asarray(sides)
        columns[:, corner] = (node[:, 0] * shape[1] + node[:, 1]) * shape[2] + node[:, 2]
        for axis, side in enumerate(sides):
            along[axis, :, corner] = t[:, axis] if side else 1.0 - t[:, axis]
    return columns, along


def _slopes(along: Floats, spacing: Floats) -> Floats:
    """Differentiate the weights along each axis, (3, n, 8)."""
    sides = np.array(list(product((-1.0, 1.0), repeat=3))).T[:, None] / spacing[:, None, None]
    slopes = np.stack([along, along, along])  # in each, the factor of its own axis is replaced
    for axis in range(3):
        slopes[axis, axis] = sides[axis]
    return np.asarray(slopes[:, 0] * slopes[:, 1] * slopes[:, 2])


def _data_matrix(
    size: _Size, position: Floats, points: OrientedPoints, terms: SdfTerms
) -> sp.csr_matrix:
    """Matrix of the position and normal terms: each point couples the eight voxels around it."""
    spacing = np.asarray(size.spacing)
    columns, along = _corners(position / spacing, size.shape)
    forms = np.concatenate(
        [
            np.sqrt(terms.position * points.position_weights)[:, None] * along.prod(axis=0)[None],
            np.sqrt(terms.normal * points.normal_weights)[:, None] * _slopes(along, spacing),
        ]
    ).transpose(1, 0, 2)
    # Points in one cell couple the same voxels, so one block per cell is enough.
    order = np.argsort(columns[:, 0], kind="stable")
    starts = np.nonzero(np.diff(columns[order, 0], prepend=-1))[0]
    blocks = np.add.reduceat(np.matmul(forms.transpose(0, 2, 1), forms)[order], starts)
    corners = columns[order[starts]]
    rows = np.broadcast_to(corners[:, :, None], blocks.shape)
    others = np.broadcast_to(corners[:, None, :], blocks.shape)
    n_voxels = int(np.prod(size.shape))
    entries = (blocks.ravel(), (rows.ravel(), others.ravel()))
    return sp.coo_matrix(entries, shape=(n_voxels, n_voxels)).tocsr()


def _face_pull(shape: tuple[int, int, int], terms: SdfTerms) -> Floats:
    """Weight of the outside term at each voxel."""
    faces = np.ones(shape, dtype=bool)
    faces[1:-1, 1:-1, 1:-1] = False
    return np.asarray((terms.outside / faces.sum()) * faces.ravel())
