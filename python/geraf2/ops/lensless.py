"""Echoes of volume samples towards groups of antennas: amplitudes, and their signals."""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Floats, Ints
from geraf2._validation import require_shape
from geraf2.ops import _device_ops, _tensors
from geraf2.ops._forms import EchoForm, SamplePairs
from geraf2.ops._geometry import native_waveform, require_antennas, require_positions, require_rtol
from geraf2.ops._tensors import to_numpy
from geraf2.ops._threads import resolve_num_threads
from geraf2.records import Waveform

_MAX_LOOKS = 10_000


class RaySamples(NamedTuple):
    """Contiguous intervals of parallel rays."""

    starts: torch.Tensor
    """Where each ray enters the scene, (n_rays, 3) [m]."""
    points: torch.Tensor
    """Mid-intervals, (n_rays, n_samples, 3) [m]."""
    step: torch.Tensor
    """Lengths, (n_rays, n_samples) [m]."""
    offset: torch.Tensor
    """From `starts` to the first interval, (n_rays,) [m]."""


def sample_rays(
    origins: Floats,
    direction: Floats,
    near: Floats,
    far: Floats,
    jitter: Floats,
    *,
    dtype: torch.dtype = torch.float32,
    num_threads: int | None = None,
) -> RaySamples:
    """Cut parallel rays into intervals whose ends are jittered within their share of the ray.

    origins: (n_rays, 3) [m]. direction: of all rays, (3,).
    near, far: where each ray enters and leaves the scene, (n_rays,) [m].
    jitter: of the n_samples + 1 ends, in [0, 1), (n_rays, n_samples + 1).
    """
    is_double = dtype == torch.float64
    cut = _core.ray_intervals_float64 if is_double else _core.ray_intervals_float32
    rows: list[Any] = [origins, direction, near, far, jitter]
    call: list[Any] = [
        *(np.ascontiguousarray(a, np.float64) for a in rows),
        resolve_num_threads(num_threads),
    ]
    out = cut(*call)
    return RaySamples(*(torch.from_numpy(a) for a in out))


def facing_samples(
    alpha: torch.Tensor,
    gradient: torch.Tensor,
    points: Floats,
    form: EchoForm,
    *,
    n_looks: int = 1,
    num_threads: int | None = None,
) -> SamplePairs:
    """Find samples that may echo to groups of antennas: all others have an amplitude of zero.

    alpha: opacities, (n_rays, n_samples); zero gives no echo.
    gradient: of the signed distance, (n_rays n_samples, 3). Where the exponent of the lobe is not
        1, a sample turned by more than 45 degrees from the group's direction gives none.
    points: the samples, (n_rays n_samples, 3) [m].
    n_looks: independent draws (signals) among which the samples are divided; neighbours differ.
    """
    positions = require_positions("points", points)
    if not 1 <= n_looks <= _MAX_LOOKS:
        msg = f"n_looks must be 1 to {_MAX_LOOKS}, got {n_looks}"
        raise ValueError(msg)
    if not _tensors.has_kernels(alpha, gradient):
        found = _device_ops.facing_samples(alpha, gradient, positions, form, n_looks)
        return SamplePairs(*found, n_looks)
    sample, offsets = _core.facing_samples(
        to_numpy(alpha.reshape(-1).contiguous()),
        to_numpy(gradient.contiguous()),
        positions,
        form.centers,
        form.lobe_power != 1.0,
        alpha.shape[1],
        n_looks,
        resolve_num_threads(num_threads),
    )
    return SamplePairs(sample, offsets, n_looks)


def echo_amplitudes(
    alpha: torch.Tensor,
    transmittance: torch.Tensor,
    gradient: torch.Tensor,
    points: Floats,
    pairs: SamplePairs,
    shift: torch.Tensor,
    form: EchoForm,
    *,
    num_threads: int | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    r"""Amplitudes of pairs of sample and group, and the samples' normals.

    .. math:: A = \alpha \, (T + \Delta)_+^m \, (2 (n \cdot w)^2 - 1)_+^{p - 1} \, (R / u)^2, \quad
              n = \nabla f / |\nabla f|

    with w the direction and u the distance from the group's middle to the sample.

    alpha, transmittance: of the samples, float32 or float64, any shape.
    gradient: of the signed distance at them, (n_samples, 3).
    points: (n_samples, 3) [m]. Not differentiable.
    shift: Delta of each pair, (n_pairs,). Not differentiable.

    Returns amplitude (n_pairs,) and unit normals (n_pairs, 3).

    Differentiable once with respect to alpha, transmittance and gradient. Equations 4 and 5 of the
    paper without reflectivity, power and the tracer's own w_o . w_r;
    docs/math/ray-march-and-lensless.md#lensless-amplitude.
    """
    require_shape("shift", shift, (len(pairs.sample),))
    if not _tensors.has_kernels(alpha, gradient):
        return _device_ops.echo_amplitudes(
            alpha, transmittance, gradient, points, pairs, shift, form
        )
    threads = resolve_num_threads(num_threads)
    positions = np.ascontiguousarray(points, dtype=np.float64)
    out: tuple[torch.Tensor, torch.Tensor] = _EchoAmplitudes.apply(  # type: ignore[no-untyped-call]
        alpha,
        transmittance,
        gradient,
        _Amplitudes(positions, pairs, to_numpy(shift), form, threads),
    )
    return out


class _Amplitudes(NamedTuple):
    points: Floats
    pairs: SamplePairs
    shift: Any
    form: EchoForm
    num_threads: int

    @property
    def native(self) -> tuple[Any, ...]:
        return (self.points, *self.pairs, self.shift, *self.form.native)


class _EchoAmplitudes(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        alpha: torch.Tensor,
        transmittance: torch.Tensor,
        gradient: torch.Tensor,
        call: _Amplitudes,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        arrays = [*_flat(alpha, transmittance, gradient), *call.native, call.num_threads]
        out = _core.echo_amplitudes_fwd(*arrays)
        amplitude, factor, normals = (torch.from_numpy(a) for a in out)
        ctx.call = call
        ctx.save_for_backward(alpha, transmittance, gradient, factor)
        return amplitude, normals

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, amplitude_grad: torch.Tensor, normals_grad: torch.Tensor
    ) -> tuple[torch.Tensor | None, ...]:
        alpha, transmittance, gradient, factor = ctx.saved_tensors
        grads = (to_numpy(t.contiguous()) for t in (factor, amplitude_grad, normals_grad))
        arrays = [*_flat(alpha, transmittance, gradient), *ctx.call.native, *grads]
        arrays.append(ctx.needs_input_grad[2])
        alpha_grad, transmittance_grad, gradient_grad = _core.echo_amplitudes_bwd(*arrays)
        return (
            torch.from_numpy(alpha_grad).reshape(alpha.shape),
            torch.from_numpy(transmittance_grad).reshape(alpha.shape),
            torch.from_numpy(gradient_grad) if ctx.needs_input_grad[2] else None,
            None,  # call
        )


def _flat(*tensors: torch.Tensor) -> list[Any]:
    alpha, transmittance, gradient = (t.contiguous() for t in tensors)
    return [to_numpy(t) for t in (alpha.reshape(-1), transmittance.reshape(-1), gradient)]


def trace_pairs(
    amplitude: torch.Tensor,
    points: Floats,
    normals: torch.Tensor,
    pairs: SamplePairs,
    tx: Floats,
    rx: Floats,
    groups: list[Ints],
    waveform: Waveform,
    *,
    rtol: float = 1e-3,
    num_threads: int | None = None,
) -> torch.Tensor:
    """Signals of pairs of sample and group, each part's traced to the antennas of its group.

    amplitude: (n_pairs,), float32 or float64.
    points: of all samples, (n_samples, 3) [m]. Not differentiable.
    normals: (n_pairs, 3).
    tx, rx: (n_antennas, 3) [m]. Not differentiable.
    groups: antennas of each group, each antenna once.
    waveform, rtol, num_threads: as for :func:`geraf2.ops.signal_tracer`, which this is part by
        part, in one call. The result does not depend on num_threads.

    Returns complex (n_looks, n_antennas, n_samples). Differentiable once with respect to amplitude
    and normals.
    """
    require_rtol(rtol)
    tx_rows, rx_rows = require_antennas(tx, rx)
    if not _tensors.has_kernels(amplitude, normals):
        return _device_ops.trace_pairs(
            *(amplitude, points, normals, pairs, tx_rows, rx_rows, groups), waveform
        )
    setting = (
        *(tx_rows, rx_rows, pairs.offsets),
        np.concatenate(groups),
        np.concatenate([[0], np.cumsum([len(g) for g in groups])]),
        native_waveform(waveform),
        float(rtol),
        resolve_num_threads(num_threads),
    )
    positions = require_positions("points", np.take(points, pairs.sample, axis=0))
    signal: torch.Tensor = _TracePairs.apply(  # type: ignore[no-untyped-call]
        amplitude, normals, positions, setting
    )
    return signal


class _TracePairs(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        amplitude: torch.Tensor,
        normals: torch.Tensor,
        points: Floats,
        setting: tuple[Any, ...],
    ) -> torch.Tensor:
        ctx.points, ctx.setting = points, setting
        ctx.save_for_backward(amplitude, normals)
        strengths, turned = (to_numpy(t.contiguous()) for t in (amplitude, normals))
        return torch.from_numpy(_core.trace_parts_fwd(strengths, points, turned, *setting))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, signal_grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        amplitude, normals = ctx.saved_tensors
        wants = ctx.needs_input_grad
        grad, strengths, turned = (
            to_numpy(t.contiguous()) for t in (signal_grad, amplitude, normals)
        )
        arrays = [grad, strengths, ctx.points, turned, *ctx.setting, wants[0], wants[1]]
        amplitude_grad, normals_grad = _core.trace_parts_bwd(*arrays)
        return (
            torch.from_numpy(amplitude_grad) if wants[0] else None,
            torch.from_numpy(normals_grad).to(normals.dtype) if wants[1] else None,
            None,  # points
            None,  # setting
        )


def length_defect(gradients: torch.Tensor, *, num_threads: int | None = None) -> torch.Tensor:
    """Mean of (|g| - 1)^2 over gradients g (n, 3), a tensor without dimensions.

    Differentiable once. |g| is the root of |g|^2 + 1e-12, which has a derivative at zero.
    """
    require_shape("gradients", gradients, (None, 3))
    if not _tensors.has_kernels(gradients):
        return _device_ops.length_defect(gradients)
    defect: torch.Tensor = _LengthDefect.apply(  # type: ignore[no-untyped-call]
        gradients, resolve_num_threads(num_threads)
    )
    return defect


class _LengthDefect(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, gradients: torch.Tensor, num_threads: int) -> torch.Tensor:
        mean, slope = _core.length_defect(to_numpy(gradients.contiguous()), num_threads)
        ctx.save_for_backward(torch.from_numpy(slope))
        return gradients.new_tensor(mean)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (slope,) = ctx.saved_tensors
        return slope * grad, None  # num_threads
