"""Signal tracer on torch tensors: one autograd function around the native kernels."""

from typing import Any

import torch
from torch.autograd.function import once_differentiable

from geraf2.ops._signal_tracer_native import TracerProblem, make_tracer_problem, require_reflectors
from geraf2.ops._tensors import to_numpy, to_tensor
from geraf2.records import Waveform


def signal_tracer_tensor(
    amplitude: Any,
    points: Any,
    tx: Any,
    rx: Any,
    waveform: Waveform,
    *,
    normals: Any,
    rtol: float,
    num_threads: int | None,
) -> torch.Tensor:
    """Signal of tensors; arrays among the arguments become tensors without a gradient."""
    amplitude, points = to_tensor("amplitude", amplitude), to_tensor("points", points)
    tx, rx = to_tensor("tx", tx), to_tensor("rx", rx)
    normals = None if normals is None else to_tensor("normals", normals)
    problem = make_tracer_problem(
        to_numpy(points), to_numpy(tx), to_numpy(rx), waveform, rtol=rtol, num_threads=num_threads
    )
    require_reflectors(to_numpy(amplitude), None if normals is None else to_numpy(normals), problem)
    signal: torch.Tensor = _SignalTracer.apply(  # type: ignore[no-untyped-call]
        amplitude, points, tx, rx, normals, problem
    )
    return signal


class _SignalTracer(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        amplitude: torch.Tensor,
        points: torch.Tensor,
        tx: torch.Tensor,
        rx: torch.Tensor,
        normals: torch.Tensor | None,
        problem: TracerProblem,
    ) -> torch.Tensor:
        ctx.problem = problem
        ctx.dtypes = tuple(t.dtype for t in (points, tx, rx))
        ctx.save_for_backward(amplitude, normals)
        return torch.from_numpy(
            problem.signal(to_numpy(amplitude), None if normals is None else to_numpy(normals))
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, signal_grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        amplitude, normals = ctx.saved_tensors
        problem: TracerProblem = ctx.problem
        wants = ctx.needs_input_grad
        amplitude_grad, normals_grad, *others = problem.gradients(
            to_numpy(signal_grad),
            to_numpy(amplitude),
            None if normals is None else to_numpy(normals),
            (wants[0], wants[4], wants[1], wants[2] or wants[3]),
        )
        positions = [
            torch.from_numpy(grad).to(dtype) if want else None
            for grad, dtype, want in zip(others, ctx.dtypes, wants[1:4], strict=True)
        ]
        return (
            torch.from_numpy(amplitude_grad) if wants[0] else None,
            *positions,
            torch.from_numpy(normals_grad).to(normals.dtype) if wants[4] else None,
            None,  # problem
        )
