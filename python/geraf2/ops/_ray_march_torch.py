"""Ray march on torch tensors: one autograd function around the native kernels."""

from typing import Any

import torch
from torch.autograd.function import once_differentiable

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2.ops import _device_ops, _tensors
from geraf2.ops._geometry import require_samples
from geraf2.ops._tensors import to_numpy, to_tensor


def ray_march_tensor(
    sdf: Any, cos: Any, step: Any, inv_s: Any, power: int, num_threads: int
) -> tuple[torch.Tensor, ...]:
    """Alpha, transmittance, weight, depth; arrays become tensors without a gradient."""
    if not _tensors.has_kernels(sdf, cos, step):
        return _device_ops.ray_march(sdf, cos, step, inv_s, power)
    sdf, cos, step = to_tensor("sdf", sdf), to_tensor("cos", cos), to_tensor("step", step)
    if isinstance(inv_s, torch.Tensor):
        if inv_s.numel() != 1:
            msg = f"inv_s must be a number or a tensor of one element, got {tuple(inv_s.shape)}"
            raise ValueError(msg)
    else:
        inv_s = torch.tensor(float(inv_s), dtype=torch.float64)
    require_samples(to_numpy(sdf), to_numpy(cos), to_numpy(step), inv_s.item())
    out: tuple[torch.Tensor, ...] = _RayMarch.apply(  # type: ignore[no-untyped-call]
        sdf, cos, step, inv_s, power, num_threads
    )
    return out


class _RayMarch(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        sdf: torch.Tensor,
        cos: torch.Tensor,
        step: torch.Tensor,
        inv_s: torch.Tensor,
        power: int,
        num_threads: int,
    ) -> tuple[torch.Tensor, ...]:
        f, c, delta = (to_numpy(t.contiguous()) for t in (sdf, cos, step))
        out = [
            torch.from_numpy(a)
            for a in _core.ray_march_fwd(f, c, delta, inv_s.item(), power, num_threads)
        ]
        ctx.save_for_backward(sdf, cos, step, inv_s, out[0], out[1])
        ctx.power, ctx.num_threads = power, num_threads
        return tuple(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        sdf, cos, step, inv_s, *outputs = ctx.saved_tensors
        f, c, delta = (to_numpy(t.contiguous()) for t in (sdf, cos, step))
        alpha, transmittance = (to_numpy(t) for t in outputs)
        alpha_grad, transmittance_grad, weight_grad, depth_grad = (
            to_numpy(t.contiguous()) for t in grads
        )
        sdf_grad, cos_grad, inv_s_grad = _core.ray_march_bwd(
            f,
            c,
            delta,
            inv_s.item(),
            ctx.power,
            alpha,
            transmittance,
            alpha_grad,
            transmittance_grad,
            weight_grad,
            depth_grad,
            ctx.num_threads,
        )
        return (
            torch.from_numpy(sdf_grad),
            torch.from_numpy(cos_grad),
            None,  # step
            torch.full_like(inv_s, inv_s_grad),
            None,  # power
            None,  # num_threads
        )
