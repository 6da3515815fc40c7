"""Positions, grids and waveform as the kernels read them."""

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Array
from geraf2._validation import require_positive, require_shape
from geraf2.constants import MAX_SPACING_WAVELENGTHS
from geraf2.records import Waveform
from geraf2.scene.grid import Grid

MAX_COORDINATE_M = 1e6
"""Positions farther from the origin are refused: at 77 GHz double precision then still leaves
1e-3 of a turn, and anything beyond is a mistake of units."""


def any_tensor(*values: Any) -> bool:
    """Whether a torch tensor is among the values; torch is not imported for that."""
    torch = sys.modules.get("torch")
    return torch is not None and any(isinstance(value, torch.Tensor) for value in values)


def native_waveform(waveform: Any) -> _core.Waveform:
    """Convert a Waveform; TypeError for anything else."""
    if not isinstance(waveform, Waveform):
        msg = f"waveform must be a geraf2.scene.Waveform, got {type(waveform).__name__}"
        raise TypeError(msg)
    return _core.Waveform(
        start_frequency_hz=waveform.start_frequency_hz,
        chirp_slope_hz_per_s=waveform.chirp_slope_hz_per_s,
        sample_rate_hz=waveform.sample_rate_hz,
        n_samples=waveform.n_samples,
        path_bias_m=waveform.path_bias_m,
    )


def require_rtol(rtol: float) -> None:
    """Raise ValueError unless `rtol` lies between 0 and 1."""
    if not 0.0 < rtol < 1.0:
        msg = f"rtol must lie between 0 and 1, got {rtol!r}"
        raise ValueError(msg)


def native_grid(grid: Grid) -> _core.VoxelGrid:
    """Convert a Grid."""
    return _core.VoxelGrid(grid.origin_m, grid.spacing_m, grid.shape)


def require_grid_values(values: NDArray[Any], grid: Grid) -> None:
    """Raise unless there is one real value per voxel."""
    if values.dtype not in (np.float32, np.float64):
        msg = f"values must be float32 or float64, got {values.dtype}"
        raise TypeError(msg)
    require_shape("values", values, tuple(grid.shape))


def require_antennas(
    tx: NDArray[Any], rx: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convert transmitters and receivers (n_antennas, 3) [m], at least one of each."""
    tx_rows = require_positions("tx", tx)
    rx_rows = require_positions("rx", rx)
    if tx_rows.shape[0] == 0:
        msg = "tx must hold at least one antenna, got shape (0, 3)"
        raise ValueError(msg)
    require_shape("rx", rx_rows, (tx_rows.shape[0], 3))
    return tx_rows, rx_rows


def require_positions(name: str, values: NDArray[Any]) -> NDArray[np.float64]:
    """Convert positions (n, 3) [m] to float64; TypeError or ValueError for anything else."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        msg = f"{name} must be real, got {array.dtype}"
        raise TypeError(msg)
    require_shape(name, array, (None, 3))
    rows = np.ascontiguousarray(array, dtype=np.float64)
    is_good = np.abs(rows) <= MAX_COORDINATE_M
    if not is_good.all():  # in one go: row by row it takes as long as a kernel
        first = int(np.argmin(is_good.all(axis=1)))
        msg = (
            f"{name} must be finite and within {MAX_COORDINATE_M:g} m of the origin, "
            f"got {rows[first].tolist()} in row {first}"
        )
        raise ValueError(msg)
    return rows


def rows_of(name: str, points: Any) -> tuple[Any, tuple[int, ...]]:
    """Points (..., 3) as rows (n, 3), and the shape before the coordinates."""
    array = points if any_tensor(points) else np.asarray(points)
    if array.ndim == 0 or array.shape[-1] != 3:
        msg = f"{name} must have shape (..., 3), got {tuple(array.shape)}"
        raise ValueError(msg)
    return array.reshape(-1, 3), tuple(array.shape[:-1])


def require_metres(
    tx: NDArray[np.float64], points: NDArray[np.float64], waveform: Waveform
) -> None:
    """Raise ValueError for positions in millimetres: no scan is as sparse and as far away."""
    if not len(points):
        return
    low, high, limit = tx.min(axis=0), tx.max(axis=0), waveform.unambiguous_range_m
    gaps = np.maximum(low - points.max(axis=0), points.min(axis=0) - high)
    away = float(np.linalg.norm(np.maximum(gaps, 0.0)))
    if len(tx) < 2 or not away > limit > 0.0:
        return
    nearest = KDTree(tx).query(tx[:: len(tx) // 100 + 1], k=2)[0][:, 1]
    spacing = float(np.median(nearest))
    if spacing > MAX_SPACING_WAVELENGTHS * waveform.center_wavelength_m:
        msg = (
            f"tx and points do not look like metres: antennas are {spacing:.3g} m apart and "
            f"{away:.3g} m from the points, but the unambiguous range is {limit:.3g} m; if they "
            "are in millimetres, convert them to metres"
        )
        raise ValueError(msg)


def require_samples(sdf: Array, cos: Array, step: Array, inv_s: float) -> None:
    """Raise unless the arrays agree in type and shape and inv_s is positive."""
    if sdf.dtype not in (np.float32, np.float64):
        msg = f"sdf must be float32 or float64, got {sdf.dtype}"
        raise TypeError(msg)
    require_shape("sdf", sdf, (None, None))
    for name, array in (("cos", cos), ("step", step)):
        if array.dtype != sdf.dtype:
            msg = f"{name} must be {sdf.dtype} as sdf is, got {array.dtype}"
            raise TypeError(msg)
        require_shape(name, array, sdf.shape)
    require_positive("inv_s", float(inv_s))
    if float(inv_s) > np.finfo(sdf.dtype).max:
        msg = f"inv_s must be finite as {sdf.dtype}, got {float(inv_s)!r}"
        raise ValueError(msg)
