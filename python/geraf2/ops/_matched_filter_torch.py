"""Matched filter on torch tensors: one autograd function around the native kernels."""

from typing import Any

import torch
from torch.autograd.function import once_differentiable

from geraf2._types import Progress
from geraf2.ops._matched_filter_native import Problem, Settings, make_problem, require_signal
from geraf2.ops._tensors import to_numpy, to_tensor
from geraf2.records import Waveform
from geraf2.scene.grid import Grid


def matched_filter_tensor(
    signal: Any,
    tx: Any,
    rx: Any,
    points: Any,
    waveform: Waveform,
    settings: Settings,
    progress: Progress | None,
) -> Any:
    """Image of tensors; arrays among the arguments become tensors without a gradient."""
    signal, tx, rx = to_tensor("signal", signal), to_tensor("tx", tx), to_tensor("rx", rx)
    if not isinstance(points, Grid):
        points = to_tensor("points", points)
    problem = make_problem(
        to_numpy(tx),
        to_numpy(rx),
        points if isinstance(points, Grid) else to_numpy(points),
        waveform,
        settings,
    )
    require_signal(to_numpy(signal), problem)
    points_tensor = None if isinstance(points, Grid) else points
    return _MatchedFilter.apply(  # type: ignore[no-untyped-call]
        signal, tx, rx, points_tensor, problem, progress
    )


class _MatchedFilter(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        signal: torch.Tensor,
        tx: torch.Tensor,
        rx: torch.Tensor,
        points: torch.Tensor | None,
        problem: Problem,
        progress: Progress | None,
    ) -> torch.Tensor:
        ctx.problem = problem
        ctx.likes = tuple(None if t is None else (t.dtype, t.shape) for t in (tx, rx, points))
        # The signal is needed only for gradients to positions.
        ctx.save_for_backward(signal if any(ctx.needs_input_grad[1:4]) else None)
        return torch.from_numpy(problem.image(to_numpy(signal), progress))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, image_grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (signal,) = ctx.saved_tensors
        problem: Problem = ctx.problem
        grad = to_numpy(image_grad)
        # torch wants dL/dRe + j dL/dIm, which the adjoint of a linear map carries back.
        signal_grad = torch.from_numpy(problem.adjoint(grad)) if ctx.needs_input_grad[0] else None
        wanted = ctx.needs_input_grad[1:4]
        positions: list[torch.Tensor | None] = [None, None, None]
        if any(wanted):
            gradients = problem.position_gradients(
                grad, to_numpy(signal), antennas=wanted[0] or wanted[1], points=wanted[2]
            )
            positions = [
                torch.from_numpy(g).to(like[0]).reshape(like[1]) if want else None
                for g, like, want in zip(gradients, ctx.likes, wanted, strict=True)
            ]
        tx_grad, rx_grad, points_grad = positions
        return signal_grad, tx_grad, rx_grad, points_grad, None, None  # problem, progress
