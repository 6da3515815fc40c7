"""Signals that antennas receive from reflecting points."""

from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from geraf2._types import Array
from geraf2.ops._geometry import any_tensor, rows_of
from geraf2.ops._signal_tracer_native import make_tracer_problem, require_reflectors
from geraf2.records import Waveform

if TYPE_CHECKING:
    import torch


_Array = TypeVar("_Array", Array, "torch.Tensor")


def signal_tracer(
    amplitude: _Array,
    points: "_Array | Array",
    tx: "_Array | Array",
    rx: "_Array | Array",
    waveform: Waveform,
    *,
    normals: "_Array | Array | None" = None,
    rtol: float = 1e-3,
    num_threads: int | None = None,
) -> _Array:
    r"""Raw samples that antennas receive from reflecting points.

    .. math:: s_i(t) = \sum_x A_i(x) \, q_i(x)
              \exp\left(-j 2 \pi f(t) \, d_i(x) / c\right), \quad
              d_i(x) = |x - tx_i| + |x - rx_i| + d_{bias}

    With normals n the specular factor is :math:`q = (\omega_o \cdot \omega_r)_+`, where
    :math:`\omega_o = \omega_i - 2 (n \cdot \omega_i) n` is the mirrored direction of incidence and
    :math:`\omega_r` the direction to the receiver; without, q = 1. Up to the factor 1/n_antennas
    and q, it is the adjoint of :func:`geraf2.ops.matched_filter`.

    Parameters
    ----------
    amplitude
        float32, float64, complex64 or complex128; (...), or (n_antennas, ...) where it depends on
        the antenna. Its precision is that of the signal; positions are read in double
        precision always.
    points
        Positions in an array of any shape (..., 3) [m].
    tx
        Transmitter of each antenna, (n_antennas, 3) [m].
    rx
        Receiver of each antenna, (n_antennas, 3) [m].
    waveform
        The chirp; `path_bias_m` is part of every path.
    normals
        (..., 3), or None. Used as they are: of unit length for the formula to mean a mirror. n
        and -n give the same.
    rtol
        Largest error of any single phasor exp(-j 2 pi f d / c) where points are dense enough to be
        summed in blocks. The error of a signal of white noise, relative to its norm, is about a
        tenth of it; below about 1e-5 complex64 rounds.
    num_threads
        Threads; torch's number when torch is loaded, else all cores, when None. The signal does not
        depend on it; gradients do within rounding.

    Returns
    -------
    complex array or tensor
        (n_antennas, n_samples); a tensor if any argument is a tensor, else an array.

    Raises
    ------
    TypeError
        For another dtype.
    ValueError
        If shapes do not go together, or positions are in millimetres.

    Notes
    -----
    Differentiable once with respect to amplitude, points, tx, rx and normals, not with respect to
    the waveform. The gradient to the amplitude is the adjoint of the approximation; those to
    positions and normals are derivatives to about `rtol`. A point on an antenna has no direction:
    its specular factor is zero, and their distance has no gradient and adds none. Where the
    specular factor is cut off at zero it has no gradient. A NaN spreads over the signals that its
    point reaches; positions must be finite.

    Equations 2 to 4 of the paper (reflector interaction, signal tracing), without its constants;
    derivation and error bounds: docs/math/signal-tracer.md#signal-tracer.

    Examples
    --------
    >>> pose, waveform = (capture := geraf2.examples.small_capture()[0]).poses[0], capture.waveform
    >>> point = np.array([[0.01, 0.0, 0.02]])  # [m]
    >>> geraf2.signal_tracer(np.ones(1, np.float32), point, pose.tx_positions, pose.rx_positions,
    ...                      waveform).shape
    (441, 32)
    """
    rows: Any
    directions: Any = None
    rows, shape = rows_of("points", points)
    if normals is not None:
        directions, own = rows_of("normals", normals)
        _require_same(own, shape)
    strengths: Any = _as_rows(amplitude, shape)
    if any_tensor(strengths, rows, tx, rx, directions):
        from geraf2.ops._signal_tracer_torch import signal_tracer_tensor  # noqa: PLC0415 - torch

        signal: Any = signal_tracer_tensor(
            strengths,
            rows,
            tx,
            rx,
            waveform,
            normals=directions,
            rtol=rtol,
            num_threads=num_threads,
        )
    else:
        problem = make_tracer_problem(rows, tx, rx, waveform, rtol=rtol, num_threads=num_threads)
        require_reflectors(strengths, directions, problem)
        signal = problem.signal(strengths, directions)
    return cast("_Array", signal)


def _require_same(own: tuple[int, ...], shape: tuple[int, ...]) -> None:
    if own != shape:
        msg = f"normals must have shape {(*shape, 3)}, got {(*own, 3)}"
        raise ValueError(msg)


def _as_rows(amplitude: Any, shape: tuple[int, ...]) -> Any:
    """Amplitudes of points of this shape as (n_points,) or (n_antennas, n_points)."""
    array = amplitude if any_tensor(amplitude) else np.asarray(amplitude)
    n_before = array.ndim - len(shape)
    if n_before not in (0, 1) or tuple(array.shape[n_before:]) != shape:
        return array  # which is refused where antennas are known
    return array.reshape(*array.shape[:n_before], -1)
