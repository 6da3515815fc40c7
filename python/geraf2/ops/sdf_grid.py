"""Values and gradients of a grid at points."""

from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2.ops._geometry import any_tensor, native_grid, require_grid_values, require_positions
from geraf2.ops._threads import resolve_num_threads
from geraf2.scene.grid import Grid

if TYPE_CHECKING:
    import torch

    from geraf2._types import Array

Interpolation = Literal["linear", "cubic"]


class GridSample(NamedTuple):
    """Value and gradient of a grid at points; tensors if any argument was a tensor, else arrays."""

    value: "Array | torch.Tensor"
    """(n_points,)."""
    gradient: "Array | torch.Tensor"
    """(n_points, 3) [1/m]."""


def sdf_grid(
    values: Any,
    grid: Any,
    points: Any,
    *,
    interpolation: Interpolation = "linear",
    num_threads: int | None = None,
) -> GridSample:
    """Value and gradient of a grid of signed distances at points.

    values: at the voxel centres, grid.shape, float32 or float64.
    grid: a Grid: where the voxels lie.
    points: (n_points, 3) [m]. Beyond the grid the nearest point of its rim counts, and the gradient
        along an axis that is exceeded is zero.
    interpolation: "linear": trilinear, continuous; its gradient jumps from cell to cell. "cubic":
        tricubic Catmull-Rom through the grid's values, with a continuous gradient (C1); taps beyond
        the rim repeat it.
    num_threads: threads; torch's number when torch is loaded, else all cores, when None. No result
        depends on it, not even in its last bit.

    Returns GridSample of value and gradient, in the dtype of `values`.

    Differentiable with respect to values and points. Twice with respect to values, so that a term
    of the gradient's length, as (|gradient| - 1)^2, may enter a loss, whether the gradient is that
    returned here or torch's of the value. The gradient to points of `gradient` (the Hessian) is
    differentiable once. docs/math/grid.md#grid-interpolation.
    """
    if interpolation not in get_args(Interpolation):
        msg = f"interpolation must be 'linear' or 'cubic', got {interpolation!r}"
        raise ValueError(msg)
    if not isinstance(grid, Grid):
        msg = f"grid must be a geraf2.scene.Grid, got {type(grid).__name__}"
        raise TypeError(msg)
    cubic = interpolation == "cubic"
    threads = resolve_num_threads(num_threads)
    if any_tensor(values, points):
        from geraf2.ops._sdf_grid_torch import sdf_grid_tensor  # noqa: PLC0415 - torch

        return GridSample(*sdf_grid_tensor(values, grid, points, cubic, threads))
    array = np.ascontiguousarray(values)
    require_grid_values(array, grid)
    value, gradient, _ = _core.sdf_grid_fwd(
        array, native_grid(grid), require_positions("points", points), cubic, False, threads
    )
    return GridSample(value, gradient)
