"""Matched-filter images of raw FMCW samples."""

import sys
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from geraf2.ops._matched_filter_native import Method, make_problem, require_signal
from geraf2.scene.grid import Grid
from geraf2.scene.waveform import Waveform

if TYPE_CHECKING:
    import torch


@overload
def matched_filter(
    signal: NDArray[Any],
    tx: NDArray[Any],
    rx: NDArray[Any],
    points: NDArray[Any] | Grid,
    waveform: Waveform,
    *,
    method: Method = ...,
    rtol: float = ...,
    num_threads: int | None = ...,
) -> NDArray[Any]: ...
@overload
def matched_filter(
    signal: "torch.Tensor",
    tx: "torch.Tensor | NDArray[Any]",
    rx: "torch.Tensor | NDArray[Any]",
    points: "torch.Tensor | NDArray[Any] | Grid",
    waveform: Waveform,
    *,
    method: Method = ...,
    rtol: float = ...,
    num_threads: int | None = ...,
) -> "torch.Tensor": ...
def matched_filter(
    signal: Any,
    tx: Any,
    rx: Any,
    points: Any,
    waveform: Waveform,
    *,
    method: Method = "auto",
    rtol: float = 1e-3,
    num_threads: int | None = None,
) -> Any:
    r"""Complex matched-filter image at points or on a grid.

    .. math:: P(x) = \frac{1}{N} \sum_{i=1}^{N} \sum_t s_i(t)
              \exp\left(+j 2 \pi f(t) \, d_i(x) / c\right), \quad
              d_i(x) = |x - tx_i| + |x - rx_i| + d_{bias}

    The signal of one ideal point scatterer, s_i(t) = exp(-j 2 pi f(t) d_i / c), gives
    P = n_samples there.

    Parameters
    ----------
    signal
        Raw ADC samples, complex64 or complex128, (n_antennas, n_samples). Its precision is that
        of the image; positions are read in double precision always.
    tx
        Transmitter of each antenna, (n_antennas, 3) [m].
    rx
        Receiver of each antenna, (n_antennas, 3) [m].
    points
        (n_points, 3) [m], or a Grid.
    waveform
        The chirp; `path_bias_m` is part of every path.
    method
        "exact" sums every sample to rounding; "block" approximates by polynomials in blocks of
        points a few millimetres wide; "auto" takes, block by block, what is faster.
    rtol
        Largest error that the block method makes in any single phasor exp(j 2 pi f d / c). The
        error of an image of white noise, relative to its norm, is about a tenth of it; below
        about 5e-6 complex64 rounds.
    num_threads
        Threads; torch's number when torch is loaded, else all cores, when None. The result does
        not depend on it.

    Returns
    -------
    Complex (n_points,), or the grid's shape; a tensor if any argument is a tensor, else an array.

    Notes
    -----
    Differentiable once with respect to signal, tx, rx and points, not with respect to a Grid or
    the waveform. Gradients to positions use the exact method; where a point lies on an antenna
    their distance has no gradient, and adds none. A NaN or infinity in the signal spreads over
    the whole image; positions must be finite.

    Derivation and error bounds: docs/math.md, "Matched filter".
    """
    torch = sys.modules.get("torch")
    if torch is not None and any(
        isinstance(value, torch.Tensor) for value in (signal, tx, rx, points)
    ):
        from geraf2.ops._matched_filter_torch import matched_filter_tensor  # noqa: PLC0415 - torch

        return matched_filter_tensor(
            signal, tx, rx, points, waveform, method=method, rtol=rtol, num_threads=num_threads
        )
    problem = make_problem(
        tx, rx, points, waveform, method=method, rtol=rtol, num_threads=num_threads
    )
    array = np.asarray(signal)
    require_signal(array, problem)
    return problem.image(array)
