"""Matched-filter images of raw FMCW samples."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import numpy as np

from geraf2._types import Array, Progress
from geraf2._validation import require_shape
from geraf2.ops._geometry import any_tensor
from geraf2.ops._matched_filter_native import (
    DEFAULT_MAX_MEMORY,
    Method,
    Settings,
    make_problem,
    require_signal,
)
from geraf2.records import Waveform
from geraf2.scene.grid import Grid

if TYPE_CHECKING:
    import torch


_Array = TypeVar("_Array", Array, "torch.Tensor")


def matched_filter(
    signal: _Array,
    tx: "_Array | Array",
    rx: "_Array | Array",
    points: "_Array | Array | Grid",
    waveform: Waveform,
    *,
    method: Method = "auto",
    rtol: float = 1e-3,
    num_threads: int | None = None,
    max_memory: float = DEFAULT_MAX_MEMORY,
    progress: Progress | None = None,
) -> _Array:
    r"""Complex matched-filter image at points or on a grid.

    .. math:: P(x) = \frac{1}{N} \sum_{i=1}^{N} \sum_t s_i(t)
              \exp\left(+j 2 \pi f(t) \, d_i(x) / c\right), \quad
              d_i(x) = |x - tx_i| + |x - rx_i| + d_{bias}

    The signal of one ideal point scatterer, s_i(t) = exp(-j 2 pi f(t) d_i / c), gives
    P = n_samples there.

    Parameters
    ----------
    signal
        Raw ADC samples, complex64 or complex128, (n_antennas, n_samples). Its precision is that of
        the image; positions are read in double precision always.
    tx
        Transmitter of each antenna, (n_antennas, 3) [m].
    rx
        Receiver of each antenna, (n_antennas, 3) [m].
    points
        Positions in an array of any shape (..., 3) [m], or a Grid.
    waveform
        The chirp; `path_bias_m` is part of every path.
    method
        "exact" sums every sample to rounding; "block" approximates by polynomials in blocks of
        points a few millimetres wide; "factorised" images clusters of neighbouring antennas at few
        nodes and interpolates over boxes of a Grid, tens of times as fast as "block" where antennas
        and voxels are many and dense; "auto" takes what costs least, see :func:`explain_method`.
    rtol
        Largest error that "block" or "factorised" makes in any single phasor exp(j 2 pi f d / c).
        The error of an image of white noise, relative to its norm, is about a tenth of it; below
        about 1e-5 complex64 rounds.
    num_threads
        Threads; all cores, or torch's number where it is loaded, when None.
    max_memory
        Working memory of the factorised method [bytes], beside signal and image; antennas and
        voxels are taken in portions that fit. What cannot be done with it is a ValueError that
        states how much is needed.
    progress
        Called with the fraction done while the image is made; not for gradients. An exception that
        it raises ends the call. Without it, an interrupt (Ctrl-C) ends a call of more than 4e9
        pairs of antenna and voxel.

    Returns
    -------
    complex array or tensor
        (...), or the grid's shape; a tensor if any argument is a tensor, else an array.

    Raises
    ------
    TypeError
        For another dtype.
    ValueError
        If shapes do not go together, positions are in millimetres, or the work cannot be done
        within `max_memory`.

    Notes
    -----
    Differentiable once with respect to signal, tx, rx and points, not with respect to a Grid or
    the waveform. Gradients to positions use the exact method; where a point lies on an antenna
    their distance has no gradient, and adds none. A NaN or infinity in the signal spreads over
    the whole image; positions must be finite.

    Derivation and error bounds: docs/math/matched-filter.md and docs/math/block-and-factorised.md.

    Examples
    --------
    >>> pose, waveform = (capture := geraf2.examples.small_capture()[0]).poses[0], capture.waveform
    >>> points = np.zeros((1, 3))  # [m]
    >>> image = geraf2.matched_filter(pose.signal, pose.tx_positions, pose.rx_positions, points,
    ...                               waveform)
    >>> image.shape, image.dtype
    ((1,), dtype('complex64'))
    """
    settings = Settings(method, rtol, num_threads, max_memory)
    if any_tensor(signal, tx, rx, points):
        from geraf2.ops._matched_filter_torch import matched_filter_tensor  # noqa: PLC0415 - torch

        image: Any = matched_filter_tensor(signal, tx, rx, points, waveform, settings, progress)
    else:
        problem = make_problem(tx, rx, points, waveform, settings)
        array = np.asarray(signal)
        require_signal(array, problem)
        image = problem.image(array, progress)
    return cast("_Array", image)


class MatchedFilterPlan:
    """Matched filter of one geometry, prepared once for many signals.

    What :func:`matched_filter` computes again in each call, the choice of the method, the blocks
    of points and the clusters of antennas, is kept: for a Grid 4 to 16 % of a call. A plan may be
    used by several threads at once.

    Parameters
    ----------
    tx, rx, points, waveform, method, rtol, num_threads
        As for :func:`matched_filter`; positions (n_antennas, 3) and (..., 3) [m] are copied.
    dtype
        Of signals and images, complex64 or complex128.

    Raises
    ------
    TypeError
        For another dtype.
    ValueError
        If shapes do not go together.

    Examples
    --------
    >>> pose, waveform = (capture := geraf2.examples.small_capture()[0]).poses[0], capture.waveform
    >>> grid = geraf2.Grid.cube((0.0, 0.0, 0.0), 0.05, 11)  # [m]
    >>> plan = geraf2.MatchedFilterPlan(pose.tx_positions, pose.rx_positions, grid, waveform)
    >>> image = plan.execute(pose.signal)
    >>> image.shape, plan.adjoint(image).shape == pose.signal.shape
    ((11, 11, 11), True)
    """

    def __init__(
        self,
        tx: Array,
        rx: Array,
        points: Array | Grid,
        waveform: Waveform,
        *,
        method: Method = "auto",
        rtol: float = 1e-3,
        num_threads: int | None = None,
        dtype: Any = np.complex64,
    ) -> None:
        self.dtype = _precision(dtype)
        """Of signals and images."""
        settings = Settings(method, rtol, num_threads)
        self._problem = make_problem(tx, rx, points, waveform, settings)
        # Made now, so that the first execution takes no longer than the others.
        _ = self._problem.plan(self.dtype)

    @property
    def signal_shape(self) -> tuple[int, int]:
        """Antennas and samples of a signal."""
        return self._problem.tx.shape[0], self._problem.n_samples

    @property
    def image_shape(self) -> tuple[int, ...]:
        """Shape of an image, (...) or the grid's."""
        return self._problem.shape

    def execute(self, signal: Array, *, progress: Progress | None = None) -> Array:
        """Image of a signal (n_antennas, n_samples), in `image_shape`.

        progress: called with the fraction done; an exception that it raises ends the call.
        """
        return self._problem.image(self._check("signal", signal, self.signal_shape), progress)

    def adjoint(self, image: Array) -> Array:
        """Adjoint of :meth:`execute`, the signal (n_antennas, n_samples) of an image."""
        return self._problem.adjoint(self._check("image", image, self.image_shape))

    def _check(self, name: str, values: Array, shape: tuple[int, ...]) -> Array:
        array = np.asarray(values)
        if array.dtype != self.dtype:
            msg = f"{name} must be {self.dtype}, as the plan was made for, got {array.dtype}"
            raise TypeError(msg)
        require_shape(name, array, shape)
        return array


@dataclass(frozen=True)
class MethodChoice:
    """Method that "auto" takes, and the reason."""

    method: Literal["exact", "block", "factorised"]
    """For a list of points the one that images most of them."""
    reason: str
    """One sentence with the estimated costs."""


def explain_method(
    tx: Any,
    rx: Any,
    points: Any,
    waveform: Waveform,
    *,
    rtol: float = 1e-3,
    dtype: Any = np.complex64,
) -> MethodChoice:
    """Return the method that "auto" of :func:`matched_filter` takes, and the reason.

    tx, rx, points, waveform, rtol: as for :func:`matched_filter`; no signal is needed.
    dtype: of the signal, complex64 or complex128.

    Costs are counted in multiply-adds: docs/math/matched-filter.md#choice-of-the-method. Nothing is
    computed but the plan.
    """
    precision = _precision(dtype)
    problem = make_problem(tx, rx, points, waveform, Settings(rtol=rtol, num_threads=1))
    choice = problem.choice(precision)
    sizes = f"{problem.tx.shape[0]} antennas and {problem.n_points} points"
    block = choice.exact_cost / choice.block_cost if choice.block_cost > 0 else 1.0
    if choice.method.name == "factorised":
        times = choice.block_cost / choice.factorised_cost
        reason = f"factorised costs about {times:.0f} times less than block for {sizes}"
        if choice.block_share > 0:
            reason += (
                f"; {100 * choice.block_share:.2g} % of the voxels are too near the antennas "
                "and left to block"
            )
        return MethodChoice("factorised", reason)
    if choice.method.name == "exact":
        reason = f"exact, as too few of the points lie within a block of each other ({sizes})"
        return MethodChoice("exact", reason)
    reason = f"block costs about {block:.0f} times less than exact for {sizes}"
    if not isinstance(points, Grid):
        reason += "; factorised needs a Grid"
    elif math.isinf(choice.factorised_cost):
        reason += ", too few for factorised to pay"
    else:
        times = choice.factorised_cost / choice.block_cost
        reason += f"; factorised would cost {times:.1f} times as much as block"
    if choice.exact_share > 0:
        reason += f"; {100 * choice.exact_share:.2g} % of the points are isolated and go to exact"
    return MethodChoice("block", reason)


def _precision(dtype: Any) -> np.dtype[Any]:
    precision: np.dtype[Any] = np.dtype(dtype)
    if precision not in (np.complex64, np.complex128):
        msg = f"dtype must be complex64 or complex128, got {precision}"
        raise TypeError(msg)
    return precision
