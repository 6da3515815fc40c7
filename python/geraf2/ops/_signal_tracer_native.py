"""Signal tracer on NumPy arrays: checks of the arguments and calls of the native kernels."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Array, Floats
from geraf2._validation import require_shape
from geraf2.ops._geometry import (
    native_waveform,
    require_antennas,
    require_metres,
    require_positions,
    require_rtol,
)
from geraf2.ops._threads import resolve_num_threads

AMPLITUDE_DTYPES = (np.float32, np.float64, np.complex64, np.complex128)


@dataclass(frozen=True, eq=False)
class TracerProblem:
    """A checked geometry: everything but amplitude and normals."""

    points: Floats
    tx: Floats
    rx: Floats
    waveform: _core.Waveform
    n_samples: int
    rtol: float
    num_threads: int

    def signal(self, amplitude: Array, normals: Array | None) -> Array:
        """Signal (n_antennas, n_samples) of checked amplitudes."""
        return _core.signal_tracer_fwd(*self._native(amplitude, normals))

    def gradients(
        self,
        signal_grad: Array,
        amplitude: Array,
        normals: Array | None,
        wants: tuple[bool, bool, bool, bool],
    ) -> tuple[Array, ...]:
        """Backward of :meth:`signal`: to amplitude, normals, points, tx and rx, in their shapes.

        wants: whether to amplitude, normals, points, antennas; the others are empty.
        """
        amplitude_grad, *others = _core.signal_tracer_bwd(
            np.ascontiguousarray(signal_grad), *self._native(amplitude, normals), *wants
        )
        if wants[0]:
            amplitude_grad = amplitude_grad.view(amplitude.dtype).reshape(amplitude.shape)
        return amplitude_grad, *others

    def _native(
        self, amplitude: Array, normals: Array | None
    ) -> tuple[Array, Floats, Array, Floats, Floats, _core.Waveform, float, int]:
        """Arguments that both kernels take."""
        parts = _parts(amplitude)
        directions = np.zeros((0, 3)) if normals is None else normals
        directions = np.ascontiguousarray(directions, dtype=parts.dtype)
        geometry = self.points, directions, self.tx, self.rx
        return parts, *geometry, self.waveform, self.rtol, self.num_threads


def make_tracer_problem(
    points: Any, tx: Any, rx: Any, waveform: Any, *, rtol: float, num_threads: int | None
) -> TracerProblem:
    """Check the geometry and hand it to the kernels in double precision."""
    native = native_waveform(waveform)
    require_rtol(rtol)
    tx_rows, rx_rows = require_antennas(tx, rx)
    positions = require_positions("points", points)
    require_metres(tx_rows, positions, waveform)
    return TracerProblem(
        points=positions,
        tx=tx_rows,
        rx=rx_rows,
        waveform=native,
        n_samples=waveform.n_samples,
        rtol=float(rtol),
        num_threads=resolve_num_threads(num_threads),
    )


def require_reflectors(amplitude: Array, normals: Array | None, problem: TracerProblem) -> None:
    """Raise unless amplitude and normals fit the points and antennas."""
    if amplitude.dtype not in AMPLITUDE_DTYPES:
        msg = f"amplitude must be float32, float64, complex64 or complex128, got {amplitude.dtype}"
        raise TypeError(msg)
    n_points = problem.points.shape[0]
    n_antennas = problem.tx.shape[0]
    if amplitude.shape not in ((n_points,), (n_antennas, n_points)):
        msg = (
            f"amplitude must have shape ({n_points},) or ({n_antennas}, {n_points}), "
            f"got {amplitude.shape}"
        )
        raise ValueError(msg)
    if normals is not None:
        if normals.dtype not in (np.float32, np.float64):
            msg = f"normals must be float32 or float64, got {normals.dtype}"
            raise TypeError(msg)
        require_shape("normals", normals, (n_points, 3))


def _parts(amplitude: Array) -> Array:
    """Amplitude as (rows, n_points, real and imaginary part or one of them)."""
    n_rows = 1 if amplitude.ndim == 1 else amplitude.shape[0]
    rows = np.ascontiguousarray(amplitude).reshape(n_rows, amplitude.shape[-1], 1)
    return rows.view(rows.real.dtype) if np.iscomplexobj(rows) else rows
