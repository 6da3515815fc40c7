"""Grid interpolation on torch tensors; sampling and its adjoint are each other's backward."""

from typing import Any, NamedTuple

import torch
from torch.autograd.function import once_differentiable

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Floats
from geraf2.ops import _device_ops, _tensors
from geraf2.ops._geometry import native_grid, require_grid_values, require_positions
from geraf2.ops._tensors import to_numpy, to_tensor
from geraf2.scene.grid import Grid


class _Setting(NamedTuple):
    grid: _core.VoxelGrid
    positions: Floats
    cubic: bool
    num_threads: int


def sdf_grid_tensor(
    values: Any, grid: Grid, points: Any, cubic: bool, num_threads: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Value and gradient; arrays among the arguments become tensors without a gradient."""
    if not _tensors.has_kernels(values, points):
        return _device_ops.sdf_grid(values, grid, points, cubic)
    values, points = to_tensor("values", values), to_tensor("points", points)
    require_grid_values(to_numpy(values), grid)
    positions = require_positions("points", to_numpy(points))
    setting = _Setting(native_grid(grid), positions, cubic, num_threads)
    out: tuple[torch.Tensor, torch.Tensor] = _Sample.apply(  # type: ignore[no-untyped-call]
        values, points, setting
    )
    return out


def _sample(values: torch.Tensor, setting: _Setting, hessian: bool) -> list[torch.Tensor]:
    array = to_numpy(values.contiguous())
    grid, positions, cubic, num_threads = setting
    out = _core.sdf_grid_fwd(array, grid, positions, cubic, hessian, num_threads)
    return [torch.from_numpy(a) for a in out]


def _points_grad(
    values: torch.Tensor,
    points: torch.Tensor,
    value_grad: torch.Tensor | None,
    gradient_grad: torch.Tensor | None,
    setting: _Setting,
) -> torch.Tensor:
    """Gradient to points of <value_grad, value> + <gradient_grad, gradient>."""
    total = torch.zeros_like(points)
    if value_grad is not None:
        _, gradient = _Sample.apply(values, points, setting)  # type: ignore[no-untyped-call]
        total = total + (value_grad[:, None] * gradient).to(points.dtype)
    if gradient_grad is not None:
        product = _HessianProduct.apply(  # type: ignore[no-untyped-call]
            values, points, gradient_grad, setting
        )
        total = total + product.to(points.dtype)
    return total


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, values: torch.Tensor, points: torch.Tensor, setting: _Setting
    ) -> tuple[torch.Tensor, torch.Tensor]:
        ctx.set_materialize_grads(False)
        ctx.setting = setting
        ctx.save_for_backward(values, points)
        value, gradient, _ = _sample(values, setting, False)
        return value, gradient

    @staticmethod
    def backward(
        ctx: Any, value_grad: torch.Tensor | None, gradient_grad: torch.Tensor | None
    ) -> tuple[torch.Tensor | None, ...]:
        values, points = ctx.saved_tensors
        values_grad = points_grad = None
        if ctx.needs_input_grad[0]:
            n = points.shape[0]
            values_grad = _Spread.apply(  # type: ignore[no-untyped-call]
                points,
                values.new_zeros(n) if value_grad is None else value_grad,
                values.new_zeros((n, 3)) if gradient_grad is None else gradient_grad,
                ctx.setting,
            )
        if ctx.needs_input_grad[1]:
            points_grad = _points_grad(values, points, value_grad, gradient_grad, ctx.setting)
        return values_grad, points_grad, None  # setting


class _Spread(torch.autograd.Function):
    """The adjoint of _Sample in the values."""

    @staticmethod
    def forward(
        ctx: Any,
        points: torch.Tensor,
        value_grad: torch.Tensor,
        gradient_grad: torch.Tensor,
        setting: _Setting,
    ) -> torch.Tensor:
        ctx.setting = setting
        ctx.save_for_backward(points, value_grad, gradient_grad)
        grid, positions, cubic, num_threads = setting
        return torch.from_numpy(
            _core.sdf_grid_bwd(
                to_numpy(value_grad.contiguous()),
                to_numpy(gradient_grad.contiguous()),
                grid,
                positions,
                cubic,
                num_threads,
            )
        )

    @staticmethod
    def backward(ctx: Any, weights: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        points, value_grad, gradient_grad = ctx.saved_tensors
        value, gradient = _Sample.apply(  # type: ignore[no-untyped-call]
            weights, points, ctx.setting
        )
        points_grad = None
        if ctx.needs_input_grad[0]:
            points_grad = _points_grad(weights, points, value_grad, gradient_grad, ctx.setting)
        return points_grad, value, gradient, None  # setting


class _HessianProduct(torch.autograd.Function):
    """Hessian at the points times a vector at each."""

    @staticmethod
    def forward(
        ctx: Any,
        values: torch.Tensor,
        points: torch.Tensor,
        vectors: torch.Tensor,
        setting: _Setting,
    ) -> torch.Tensor:
        _, _, packed = _sample(values, setting, True)
        hessian = packed[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        ctx.save_for_backward(hessian)
        del points
        return (hessian @ vectors[..., None])[..., 0]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        if ctx.needs_input_grad[0] or ctx.needs_input_grad[1]:
            msg = "sdf_grid: the Hessian has no gradient to values or points"
            raise NotImplementedError(msg)
        (hessian,) = ctx.saved_tensors
        return None, None, (hessian @ grad[..., None])[..., 0], None
