"""Matched filter on torch tensors: one autograd function around the native kernels."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.autograd.function import once_differentiable

from geraf2.ops._matched_filter_native import Method, Problem, make_problem, require_signal
from geraf2.scene.grid import Grid
from geraf2.scene.waveform import Waveform


def matched_filter_tensor(
    signal: Any,
    tx: Any,
    rx: Any,
    points: Any,
    waveform: Waveform,
    *,
    method: Method,
    rtol: float,
    num_threads: int | None,
) -> torch.Tensor:
    """Image of tensors; arrays among the arguments become tensors without a gradient."""
    signal, tx, rx = _tensor("signal", signal), _tensor("tx", tx), _tensor("rx", rx)
    if not isinstance(points, Grid):
        points = _tensor("points", points)
    problem = make_problem(
        _numpy(tx),
        _numpy(rx),
        points if isinstance(points, Grid) else _numpy(points),
        waveform,
        method=method,
        rtol=rtol,
        num_threads=num_threads,
    )
    require_signal(_numpy(signal), problem)
    points_tensor = None if isinstance(points, Grid) else points
    image: torch.Tensor = _MatchedFilter.apply(  # type: ignore[no-untyped-call]
        signal, tx, rx, points_tensor, problem
    )
    return image


class _MatchedFilter(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        signal: torch.Tensor,
        tx: torch.Tensor,
        rx: torch.Tensor,
        points: torch.Tensor | None,
        problem: Problem,
    ) -> torch.Tensor:
        ctx.problem = problem
        ctx.dtypes = tuple(None if t is None else t.dtype for t in (tx, rx, points))
        # The signal is needed only for gradients to positions.
        ctx.save_for_backward(signal if any(ctx.needs_input_grad[1:4]) else None)
        return torch.from_numpy(problem.image(_numpy(signal)))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, image_grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (signal,) = ctx.saved_tensors
        problem: Problem = ctx.problem
        grad = _numpy(image_grad)
        # torch wants dL/dRe + j dL/dIm, which the adjoint of a linear map carries back.
        signal_grad = torch.from_numpy(problem.adjoint(grad)) if ctx.needs_input_grad[0] else None
        wanted = ctx.needs_input_grad[1:4]
        positions: list[torch.Tensor | None] = [None, None, None]
        if any(wanted):
            gradients = problem.position_gradients(
                grad, _numpy(signal), antennas=wanted[0] or wanted[1], points=wanted[2]
            )
            positions = [
                torch.from_numpy(g).to(dtype) if want else None
                for g, dtype, want in zip(gradients, ctx.dtypes, wanted, strict=True)
            ]
        tx_grad, rx_grad, points_grad = positions
        return signal_grad, tx_grad, rx_grad, points_grad, None  # problem


def _tensor(name: str, values: Any) -> torch.Tensor:
    tensor = values if isinstance(values, torch.Tensor) else torch.from_numpy(np.asarray(values))
    if tensor.device.type != "cpu":
        msg = f"{name} must be on the CPU, got device {tensor.device}"
        raise ValueError(msg)
    return tensor


def _numpy(tensor: torch.Tensor) -> NDArray[Any]:
    """Memory of a tensor as an array; a conjugate or negative view is resolved first."""
    array: NDArray[Any] = tensor.detach().resolve_conj().resolve_neg().numpy()
    return array
