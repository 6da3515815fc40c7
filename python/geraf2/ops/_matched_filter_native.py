"""Matched filter on NumPy arrays: checks of the arguments and calls of the native kernels."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Array, Floats, Progress
from geraf2._validation import require_shape
from geraf2.ops._geometry import (
    native_grid,
    native_waveform,
    require_antennas,
    require_metres,
    require_positions,
    require_rtol,
    rows_of,
)
from geraf2.ops._threads import resolve_num_threads
from geraf2.scene.grid import Grid

Method = Literal["auto", "exact", "block", "factorised"]

DEFAULT_MAX_MEMORY = 1_000_000_000
"""Working memory of the factorised method [bytes], five times what a large scan needs."""

_METHODS = {
    "auto": _core.MatchedFilterMethod.automatic,
    "exact": _core.MatchedFilterMethod.exact,
    "block": _core.MatchedFilterMethod.block,
    "factorised": _core.MatchedFilterMethod.factorised,
}


INTERRUPTIBLE_PAIRS = 4e9
"""Pairs of antenna and point, two seconds on a core, above which a call can be interrupted."""


@dataclass(frozen=True)
class Settings:
    """Settings of an image; the arguments of the same names of `matched_filter`, checked."""

    method: Method = "auto"
    rtol: float = 1e-3
    num_threads: int | None = None
    max_memory: float = DEFAULT_MAX_MEMORY

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            names = ", ".join(map(repr, get_args(Method)))
            msg = f"method must be one of {names}, got {self.method!r}"
            raise ValueError(msg)
        require_rtol(self.rtol)
        if not 0.0 < self.max_memory < np.inf:
            msg = f"max_memory must be a positive number of bytes, got {self.max_memory!r}"
            raise ValueError(msg)


@dataclass(frozen=True, eq=False)
class Problem:
    """A checked geometry: everything but the signal."""

    tx: Floats
    rx: Floats
    points: "Floats | _core.VoxelGrid"
    shape: tuple[int, ...]
    """Of an image."""
    waveform: _core.Waveform
    n_samples: int
    options: _core.MatchedFilterOptions
    num_threads: int

    @cached_property
    def _plans(self) -> dict[np.dtype[Any], Any]:
        return {}

    def plan(self, dtype: np.dtype[Any]) -> Any:
        """Plan of the kernels for complex64 or complex128, made when first used."""
        if dtype not in self._plans:
            single = dtype == np.complex64
            make = _core.MatchedFilterPlanFloat if single else _core.MatchedFilterPlanDouble
            self._plans[dtype] = make(*self._geometry, self.options)
        return self._plans[dtype]

    @property
    def n_points(self) -> int:
        """Points of the image."""
        return math.prod(self.shape)

    @property
    def _geometry(self) -> "tuple[Floats, Floats, Floats | _core.VoxelGrid, _core.Waveform]":
        return self.tx, self.rx, self.points, self.waveform

    def image(self, signal: Array, progress: Progress | None = None) -> Array:
        """Image of a signal (n_antennas, n_samples), in the domain's shape."""
        if progress is None and self.tx.shape[0] * self.n_points >= INTERRUPTIBLE_PAIRS:
            progress = _hear_interrupts
        rows = np.ascontiguousarray(signal)
        image: Array = self.plan(rows.dtype).image(rows, progress)
        return image.reshape(self.shape)

    def choice(self, dtype: np.dtype[Any]) -> _core.MatchedFilterChoice:
        """Choice of "auto" for this geometry, for complex64 or complex128."""
        if dtype == np.complex64:
            return _core.choose_matched_filter_float32(*self._geometry, self.options)
        return _core.choose_matched_filter_float64(*self._geometry, self.options)

    def adjoint(self, image: Array) -> Array:
        """Adjoint of :meth:`image`."""
        values = np.ascontiguousarray(image).reshape(-1)
        signal: Array = self.plan(values.dtype).adjoint(values)
        return signal

    def position_gradients(
        self, image_grad: Array, signal: Array, *, antennas: bool, points: bool
    ) -> tuple[Floats, Floats, Floats]:
        """Gradients to tx, rx and points; those that are not asked for are empty."""
        return _core.matched_filter_bwd_positions(
            np.ascontiguousarray(image_grad).reshape(-1),
            np.ascontiguousarray(signal),
            *self._geometry,
            self.num_threads,
            antennas,
            points,
        )


def make_problem(tx: Any, rx: Any, points: Any, waveform: Any, settings: Settings) -> Problem:
    """Check the geometry and hand it to the kernels in double precision."""
    native = native_waveform(waveform)
    positions: Floats | _core.VoxelGrid
    shape: tuple[int, ...]
    if settings.method == "factorised" and not isinstance(points, Grid):
        msg = (
            f"method 'factorised' needs points on a geraf2.scene.Grid, got {type(points).__name__}"
        )
        raise TypeError(msg)
    threads = resolve_num_threads(settings.num_threads)
    tx_rows, rx_rows = require_antennas(tx, rx)
    if isinstance(points, Grid):
        positions, shape = native_grid(points), tuple(points.shape)
        ends = np.array([[axis[0], axis[-1]] for axis in points.axes_m]).T
        require_metres(tx_rows, ends, waveform)
    else:
        rows, shape = rows_of("points", points)
        positions = require_positions("points", rows)
        require_metres(tx_rows, positions, waveform)
    return Problem(
        tx=tx_rows,
        rx=rx_rows,
        points=positions,
        shape=shape,
        waveform=native,
        n_samples=waveform.n_samples,
        options=_core.MatchedFilterOptions(
            _METHODS[settings.method], float(settings.rtol), threads, float(settings.max_memory)
        ),
        num_threads=threads,
    )


def require_signal(signal: Array, problem: Problem) -> None:
    """Raise unless the signal is complex and has one row per antenna."""
    if signal.dtype not in (np.complex64, np.complex128):
        msg = f"signal must be complex64 or complex128, got {signal.dtype}"
        raise TypeError(msg)
    require_shape("signal", signal, (problem.tx.shape[0], problem.n_samples))


def _hear_interrupts(_done: float) -> None:
    """Python handles signals where it enters a function of its own."""
