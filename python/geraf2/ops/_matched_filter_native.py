"""Matched filter on NumPy arrays: checks of the arguments and calls of the native kernels."""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from geraf2 import _core  # noqa: TID251 - ops is the room that wraps the native module
from geraf2._validation import require_shape
from geraf2.ops._threads import resolve_num_threads
from geraf2.scene.grid import Grid
from geraf2.scene.waveform import Waveform

Method = Literal["auto", "exact", "block"]

MAX_COORDINATE_M = 1e6
"""Positions farther from the origin are refused: at 77 GHz double precision then still leaves
1e-3 of a turn, and anything beyond is a mistake of units."""

_METHODS = {
    "auto": _core.MatchedFilterMethod.automatic,
    "exact": _core.MatchedFilterMethod.exact,
    "block": _core.MatchedFilterMethod.block,
}


@dataclass(frozen=True, eq=False)
class Domain:
    """Where the image is taken, as the kernels read it."""

    native: "NDArray[np.float64] | _core.VoxelGrid"
    shape: tuple[int, ...]
    n_points: int


@dataclass(frozen=True, eq=False)
class Problem:
    """A checked geometry: everything but the signal."""

    tx: NDArray[np.float64]
    rx: NDArray[np.float64]
    domain: Domain
    waveform: _core.Waveform
    n_samples: int
    options: _core.MatchedFilterOptions
    num_threads: int

    def image(self, signal: NDArray[Any]) -> NDArray[Any]:
        """Image of a signal (n_antennas, n_samples), in the domain's shape."""
        image = _core.matched_filter_fwd(
            np.ascontiguousarray(signal),
            self.tx,
            self.rx,
            self.domain.native,
            self.waveform,
            self.options,
        )
        return image.reshape(self.domain.shape)

    def adjoint(self, image: NDArray[Any]) -> NDArray[Any]:
        """Adjoint of :meth:`image`."""
        return _core.matched_filter_bwd_signal(
            np.ascontiguousarray(image).reshape(-1),
            self.tx,
            self.rx,
            self.domain.native,
            self.waveform,
            self.options,
        )

    def position_gradients(
        self, image_grad: NDArray[Any], signal: NDArray[Any], *, antennas: bool, points: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Gradients to tx, rx and points; those that are not asked for are empty."""
        return _core.matched_filter_bwd_positions(
            np.ascontiguousarray(image_grad).reshape(-1),
            np.ascontiguousarray(signal),
            self.tx,
            self.rx,
            self.domain.native,
            self.waveform,
            self.num_threads,
            antennas,
            points,
        )


def make_problem(
    tx: NDArray[Any],
    rx: NDArray[Any],
    points: NDArray[Any] | Grid,
    waveform: Any,
    *,
    method: Method,
    rtol: float,
    num_threads: int | None,
) -> Problem:
    """Check the geometry and hand it to the kernels in double precision."""
    if not isinstance(waveform, Waveform):
        msg = f"waveform must be a geraf2.scene.Waveform, got {type(waveform).__name__}"
        raise TypeError(msg)
    if method not in get_args(Method):
        msg = f"method must be one of {', '.join(map(repr, get_args(Method)))}, got {method!r}"
        raise ValueError(msg)
    if not 0.0 < rtol < 1.0:
        msg = f"rtol must lie between 0 and 1, got {rtol!r}"
        raise ValueError(msg)
    threads = resolve_num_threads(num_threads)
    tx_rows = _positions("tx", tx)
    rx_rows = _positions("rx", rx)
    if tx_rows.shape[0] == 0:
        msg = "tx must hold at least one antenna, got shape (0, 3)"
        raise ValueError(msg)
    require_shape("rx", rx_rows, (tx_rows.shape[0], 3))
    return Problem(
        tx=tx_rows,
        rx=rx_rows,
        domain=_domain(points),
        waveform=_core.Waveform(
            start_frequency_hz=waveform.start_frequency_hz,
            chirp_slope_hz_per_s=waveform.chirp_slope_hz_per_s,
            sample_rate_hz=waveform.sample_rate_hz,
            n_samples=waveform.n_samples,
            path_bias_m=waveform.path_bias_m,
        ),
        n_samples=waveform.n_samples,
        options=_core.MatchedFilterOptions(_METHODS[method], float(rtol), threads),
        num_threads=threads,
    )


def require_signal(signal: NDArray[Any], problem: Problem) -> None:
    """Raise unless the signal is complex and has one row per antenna."""
    if signal.dtype not in (np.complex64, np.complex128):
        msg = f"signal must be complex64 or complex128, got {signal.dtype}"
        raise TypeError(msg)
    require_shape("signal", signal, (problem.tx.shape[0], problem.n_samples))


def _domain(points: NDArray[Any] | Grid) -> Domain:
    if isinstance(points, Grid):
        grid = _core.VoxelGrid(points.origin_m, points.spacing_m, points.shape)
        return Domain(grid, tuple(points.shape), points.n_voxels)
    rows = _positions("points", points)
    return Domain(rows, (rows.shape[0],), rows.shape[0])


def _positions(name: str, values: NDArray[Any]) -> NDArray[np.float64]:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        msg = f"{name} must be real, got {array.dtype}"
        raise TypeError(msg)
    require_shape(name, array, (None, 3))
    rows = np.ascontiguousarray(array, dtype=np.float64)
    bad = ~(np.abs(rows) <= MAX_COORDINATE_M).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        msg = (
            f"{name} must be finite and within {MAX_COORDINATE_M:g} m of the origin, "
            f"got {rows[first].tolist()} in row {first}"
        )
        raise ValueError(msg)
    return rows
