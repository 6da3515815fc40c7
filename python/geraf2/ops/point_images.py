"""Matched-filter images of several signals of the same antennas at scattered points."""

from typing import Any, NamedTuple

import torch
from torch.autograd.function import once_differentiable

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Floats
from geraf2._validation import require_shape
from geraf2.ops import _device_ops, _tensors
from geraf2.ops._geometry import native_waveform, require_antennas, require_positions
from geraf2.ops._tensors import to_numpy
from geraf2.ops._threads import resolve_num_threads
from geraf2.records import Waveform


class PointImages(NamedTuple):
    """Images, complex (n_signals, n_points) each."""

    of_signals: torch.Tensor
    of_others: torch.Tensor
    """Without a gradient."""


def point_images(
    signals: torch.Tensor,
    others: torch.Tensor,
    tx: Floats,
    rx: Floats,
    points: Floats,
    waveform: Waveform,
    *,
    num_threads: int | None = None,
) -> PointImages:
    """Image signals as `matched_filter` with method "exact" does, all in one call.

    What belongs to antenna and point is computed once for all signals: three quarters of the work
    for one of 32 samples.

    signals: complex64 or complex128, (n_signals, n_antennas, n_samples).
    others: of the same antennas, (n_others, n_antennas, n_samples); no gradient goes there.
    tx, rx: (n_antennas, 3) [m].
    points: (n_points, 3) [m].

    Differentiable once with respect to `signals` alone. The result does not depend on num_threads.
    """
    tx_rows, rx_rows = require_antennas(tx, rx)
    for name, value in (("signals", signals), ("others", others)):
        require_shape(name, value, (None, len(tx_rows), waveform.n_samples))
    positions = require_positions("points", points)
    if not _tensors.has_kernels(signals, others):
        both = torch.cat([signals, others.detach()])
        images = _device_ops.point_images(both, tx_rows, rx_rows, positions, waveform)
        return PointImages(images[: len(signals)], images[len(signals) :].detach())
    setting = (
        *(tx_rows, rx_rows, positions, native_waveform(waveform)),
        resolve_num_threads(num_threads),
    )
    return PointImages(*_PointImages.apply(signals, others, setting))  # type: ignore[no-untyped-call]


class _PointImages(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, signals: torch.Tensor, others: torch.Tensor, setting: tuple[Any, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        ctx.setting = setting
        both = torch.cat([signals, others])
        images = torch.from_numpy(_core.point_images_fwd(to_numpy(both), *setting))
        of_signals, of_others = images[: len(signals)], images[len(signals) :].clone()
        ctx.mark_non_differentiable(of_others)
        return of_signals, of_others

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, images_grad: torch.Tensor, _: Any) -> tuple[torch.Tensor | None, ...]:
        grad = _core.point_images_bwd(to_numpy(images_grad.contiguous()), *ctx.setting)
        return torch.from_numpy(grad), None, None  # others, setting
