"""Poisson surface from oriented points, and a potential from a field of normals.

Kazhdan, Bolitho, Hoppe: Poisson surface reconstruction, 2006: the gradient of the solid's indicator
is its surface's normal field, so that the indicator solves a Poisson equation. On a regular grid
with free boundaries the Laplacian is diagonal under the cosine transform, and no tree is needed.
"""

from collections.abc import Sequence

import numpy as np
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter

from geraf2._types import Floats
from geraf2._validation import require_shape
from geraf2.fields import SdfGrid
from geraf2.scene import Grid
from geraf2.surfaces.linear_sdf import trilinear_rows

# Of the splatted normals [voxels]: a point's normal must reach its neighbours on the same surface.
_SPLAT_SIGMA = 1.0
# Over which points are counted, so that a patch seen twice does not weigh twice [voxels].
_DENSITY_SIGMA = 2.0

_MAX_ITERATIONS = 300

Field = Floats


def poisson_surface(positions: Floats, normals: Floats, grid: Grid) -> SdfGrid:
    """Field whose zero level passes through oriented points; negative inside.

    positions: (n_points, 3) inside the grid [m].
    normals: outward unit normals, (n_points, 3).

    Returns minus the indicator, shifted by its mean at the points and scaled to a slope of about
    one across the surface: no distance farther away.
    """
    require_shape("positions", positions, (None, 3))
    require_shape("normals", normals, positions.shape)
    if positions.shape[0] == 0:
        msg = "positions must hold at least one point, got none"
        raise ValueError(msg)
    index = (positions - np.asarray(grid.origin_m)) / grid.spacing_m
    rows = trilinear_rows(index, grid.shape)

    def splat(values: Floats, sigma: float) -> Field:
        return np.asarray(gaussian_filter((rows.T @ values).reshape(grid.shape), sigma))

    density = rows @ splat(np.ones(positions.shape[0]), _DENSITY_SIGMA).ravel()
    weights = 1.0 / density  # at least its own splat, never zero
    vectors = [splat(weights * normals[:, axis], _SPLAT_SIGMA) for axis in range(3)]
    field = solve_gradient(vectors)
    at_points = rows @ field.ravel()
    field -= np.average(at_points, weights=weights)
    steepest = max(float(np.abs(np.diff(field, axis=axis)).max(initial=0.0)) for axis in range(3))
    scale = grid.spacing_m / steepest if steepest > 0.0 else 1.0
    return SdfGrid(grid=grid, values=(scale * field).astype(np.float32))


def solve_gradient(
    vectors: Sequence[Field], weights: Field | None = None, *, tolerance: float = 1e-4
) -> Field:
    """Field f whose gradient is nearest to a vector field, of mean zero.

    minimise sum over grid edges of w (f_j - f_i - v_ij)^2, v_ij and w the means of both ends.

    vectors: three components, each (n_x, n_y, n_z), per voxel step.
    weights: weight of each voxel, not negative; 1 when None.
    tolerance: of the residual relative to the right side, with weights; without, the solution is
        direct.
    """
    shape = vectors[0].shape
    eigenvalues = np.zeros(shape)
    for axis, n in enumerate(shape):
        line = 2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n)
        eigenvalues += line.reshape([-1 if k == axis else 1 for k in range(3)])
    eigenvalues[0, 0, 0] = 1.0

    def invert(right: Field) -> Field:
        spectrum = dctn(right, norm="ortho") / eigenvalues
        spectrum[0, 0, 0] = 0.0
        return np.asarray(idctn(spectrum, norm="ortho"))

    edge_weights = None if weights is None else [_edge_means(weights, axis) for axis in range(3)]
    flow = [_edge_means(component, axis) for axis, component in enumerate(vectors)]
    if edge_weights is None:
        return invert(_divergence(flow, shape))
    right = _divergence([w * v for w, v in zip(edge_weights, flow, strict=True)], shape)

    def apply(field: Field) -> Field:
        return _divergence(
            [w * np.diff(field, axis=axis) for axis, w in enumerate(edge_weights)], shape
        )

    solution, residual = np.zeros(shape), right
    direction, product = np.zeros(shape), 1.0
    goal = tolerance * float(np.linalg.norm(right))
    for _ in range(_MAX_ITERATIONS):
        if not float(np.linalg.norm(residual)) > goal:
            break
        scaled = invert(residual)
        previous, product = product, float(np.vdot(residual, scaled))
        direction = scaled + (product / previous) * direction
        image = apply(direction)
        step = product / float(np.vdot(direction, image))
        solution += step * direction
        residual = residual - step * image
    return solution


def _edge_means(values: Field, axis: int) -> Field:
    low, high = [slice(None)] * 3, [slice(None)] * 3
    low[axis], high[axis] = slice(None, -1), slice(1, None)
    return np.asarray(0.5 * (values[tuple(low)] + values[tuple(high)]))


def _divergence(flow: Sequence[Field], shape: tuple[int, ...]) -> Field:
    """Transpose of the differences along all axes."""
    total = np.zeros(shape)
    for axis, part in enumerate(flow):
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        total[tuple(high)] += part
        total[tuple(low)] -= part
    return total
