"""Matrix of a quadratic energy of a field on a grid: bending, sparse rows, diagonal."""

from typing import Any

import numpy as np
import scipy.sparse as sp

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Array, Floats
from geraf2._validation import require_finite, require_shape
from geraf2.ops._threads import resolve_num_threads

_NATIVE: dict[Any, Any] = {
    np.dtype(np.float32): _core.GridEnergyFloat,
    np.dtype(np.float64): _core.GridEnergyDouble,
}


class GridEnergy:
    """Matrix A of the energy f^T A f of a field f on a regular grid.

    f^T A f = bending * mean |Hessian f|_F^2 + f^T sparse f + sum_v diagonal_v f_v^2; the Hessian
    by second differences, mixed ones counted twice
    (docs/math/surface-fit.md#linear-signed-distance). A is applied from its stencils and never
    formed. Results do not depend on the number of threads.

    shape: voxels along each axis, at least 2.
    spacing: distance of voxels along each axis, in the unit that derivatives are taken in, (3,).
    bending: weight of the mean squared Hessian.
    sparse: symmetric, (n_voxels, n_voxels).
    diagonal: (n_voxels,).
    dtype: of the fields: float32 or float64.
    num_threads: threads of each call; torch's number when torch is loaded, else all cores, when
        None.
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        spacing: tuple[float, float, float],
        *,
        bending: float,
        sparse: sp.csr_matrix,
        diagonal: Floats,
        dtype: type[np.float32] | type[np.float64] = np.float64,
        num_threads: int | None = None,
    ) -> None:
        n_voxels = int(np.prod(shape))
        if np.shape(shape) != (3,) or min(shape) < 2 or n_voxels >= 2**31:
            msg = f"shape must be 3 axes of at least 2 and below 2^31 voxels, got {shape}"
            raise ValueError(msg)
        if np.shape(spacing) != (3,) or not min(spacing) > 0.0:
            msg = f"spacing must be 3 positive lengths, got {spacing}"
            raise ValueError(msg)
        if np.dtype(dtype) not in _NATIVE:
            msg = f"dtype must be float32 or float64, got {dtype}"
            raise TypeError(msg)
        require_finite("bending", bending)
        if sparse.shape != (n_voxels, n_voxels):
            msg = f"sparse must have shape {(n_voxels, n_voxels)}, got {sparse.shape}"
            raise ValueError(msg)
        require_shape("diagonal", diagonal, (n_voxels,))
        sparse.check_format()  # ValueError for rows and columns outside
        self.shape, self.n_voxels, self.dtype = shape, n_voxels, np.dtype(dtype)
        self._num_threads = resolve_num_threads(num_threads)
        rows = np.nonzero(np.diff(sparse.indptr))[0]
        starts = np.append(sparse.indptr[rows], sparse.indptr[-1])
        self._native = _NATIVE[self.dtype](
            shape=shape,
            spacing=spacing,
            bending=float(bending),
            rows=rows.astype(np.int64),
            starts=starts.astype(np.int64),
            columns=np.ascontiguousarray(sparse.indices, dtype=np.int32),
            values=np.ascontiguousarray(sparse.data, dtype=np.float64),
            diagonal=np.ascontiguousarray(diagonal, dtype=np.float64),
        )

    def apply(self, field: Array) -> Array:
        """Product A f, (n_voxels,) -> (n_voxels,)."""
        product: Array = self._native.apply(self._field("field", field), self._num_threads)
        return product

    def diagonal(self) -> Array:
        """Diagonal of A, (n_voxels,)."""
        values: Array = self._native.diagonal(self.n_voxels)
        return values

    def smooth(self, right: Array, field: Array, *, degree: int, low: float, high: float) -> Array:
        """Field nearer to the solution of A f = right, by Chebyshev-weighted Jacobi steps.

        right: (n_voxels,).
        field: where to start, (n_voxels,); not changed.
        degree: number of steps.
        low, high: errors along eigenvectors of D^-1 A (D the diagonal) with eigenvalues in between
            shrink at least by T_degree((high + low) / (high - low)); none above high may exist.

        Returns (n_voxels,).
        """
        if degree < 1 or not 0.0 < low < high:
            msg = f"degree must be at least 1 and 0 < low < high, got {degree}, {low}, {high}"
            raise ValueError(msg)
        moved: Array = self._native.smooth(
            self._field("right", right),
            self._field("field", field),
            int(degree),
            float(low),
            float(high),
            self._num_threads,
        )
        return moved

    def _field(self, name: str, values: Array) -> Array:
        if values.dtype != self.dtype:
            msg = f"{name} must be {self.dtype}, got {values.dtype}"
            raise TypeError(msg)
        require_shape(name, values, (self.n_voxels,))
        return np.ascontiguousarray(values)
