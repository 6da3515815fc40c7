"""Arguments that do not go together are named, as arrays and as tensors."""

import numpy as np
import pytest
import torch

from geraf2.ops import matched_filter, ray_march, sdf_grid, signal_tracer
from geraf2.scene import Grid
from helpers.synthetic import waveform_of

GRID = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=1.0, shape=(5, 4, 6))
GEOMETRY = {"tx": np.zeros((4, 3)), "rx": np.zeros((4, 3)), "points": np.zeros((2, 3))}
GEOMETRY["waveform"] = waveform_of()
GOOD = {
    matched_filter: {"signal": np.zeros((4, 32), complex), **GEOMETRY},
    signal_tracer: {"amplitude": np.zeros(2), **GEOMETRY},
    ray_march: {
        "sdf": np.zeros((2, 3)),
        "cos": np.zeros((2, 3)),
        "step": np.ones((2, 3)),
        "inv_s": 9.0,
    },
    sdf_grid: {"values": np.zeros(GRID.shape), "grid": GRID, "points": np.zeros((2, 3))},
}
OF_GEOMETRY = (
    ({"tx": np.zeros((4, 2))}, ValueError, r"tx must have shape \(\*, 3\)"),
    ({"tx": np.zeros((4, 3), complex)}, TypeError, "tx must be real"),
    ({"rx": np.zeros((1, 3))}, ValueError, r"rx must have shape \(4, 3\)"),
    ({"tx": np.zeros((0, 3)), "rx": np.zeros((0, 3))}, ValueError, "one antenna"),
    ({"points": np.full((2, 3), np.nan)}, ValueError, "finite.*row 0"),
    ({"points": np.full((2, 3), 1e7)}, ValueError, "within 1e"),
    ({"points": np.zeros(3)}, ValueError, "points must have shape"),
    ({"waveform": 77e9}, TypeError, "waveform must be a geraf2.scene.Waveform"),
    ({"rtol": 0.0}, ValueError, "rtol must lie between 0 and 1"),
    ({"rtol": np.nan}, ValueError, "rtol must lie between 0 and 1"),
    ({"rtol": 1.5}, ValueError, "rtol must lie between 0 and 1"),
    ({"num_threads": 0}, ValueError, "num_threads must be at least 1"),
    ({"num_threads": 1.5}, TypeError, "num_threads must be an int"),
)
OWN = {
    matched_filter: (
        ({"signal": np.zeros(32, complex)}, ValueError, r"signal must have shape"),
        ({"signal": np.zeros((4, 31), complex)}, ValueError, r"\(4, 32\)"),
        ({"signal": np.zeros((5, 32), complex)}, ValueError, r"got \(5, 32\)"),
        ({"signal": np.zeros((4, 32))}, TypeError, "complex64 or complex128"),
        ({"method": "fast"}, ValueError, "'block', 'factorised', got 'fast'"),
    ),
    signal_tracer: (
        ({"amplitude": np.zeros((1, 4, 2))}, ValueError, r"\(2,\) or \(4, 2\), got"),
        ({"amplitude": np.zeros(3)}, ValueError, r"got \(3,\)"),
        ({"amplitude": np.zeros((1, 2))}, ValueError, r"got \(1, 2\)"),
        ({"amplitude": np.zeros(2, int)}, TypeError, "amplitude must be float32"),
        ({"normals": np.zeros((3, 3))}, ValueError, r"normals must have shape"),
        ({"normals": np.zeros((2, 3), int)}, TypeError, "normals must be float32"),
    ),
    ray_march: (
        ({"sdf": np.zeros(4)}, ValueError, "sdf must have shape"),
        ({"sdf": np.zeros((2, 3), int)}, TypeError, "sdf must be float32"),
        ({"cos": np.zeros((2, 4))}, ValueError, r"cos must have shape \(2, 3\)"),
        ({"step": np.zeros((2, 3), np.float32)}, TypeError, "step must be float64 as sdf is"),
        ({"inv_s": 0.0}, ValueError, "inv_s must be finite and positive, got 0.0"),
        ({"two_way": "both"}, ValueError, "'unbiased', 'squared', 'none', got 'both'"),
    ),
    sdf_grid: (
        ({"values": np.zeros((5, 4, 5))}, ValueError, r"values must have shape \(5, 4, 6\)"),
        ({"values": np.zeros(GRID.shape, int)}, TypeError, "values must be float32"),
        ({"points": np.zeros(3)}, ValueError, "points must have shape"),
        ({"points": np.full((1, 3), np.nan)}, ValueError, "finite.*row 0"),
        ({"grid": None}, TypeError, "grid must be a geraf2.scene.Grid, got NoneType"),
        ({"interpolation": "spline"}, ValueError, "'linear' or 'cubic', got 'spline'"),
    ),
}
ROWS = [(f, *row) for f in (matched_filter, signal_tracer) for row in OF_GEOMETRY]
ROWS += [(f, *row) for f, rows in OWN.items() for row in rows]


@pytest.mark.parametrize("kind", ["numpy", "torch"])
@pytest.mark.parametrize(("function", "change", "error", "message"), ROWS)
def test_bad_input_is_named(function, change, error, message, kind):
    arguments = GOOD[function] | change
    if kind == "torch":
        arguments = {
            key: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
            for key, value in arguments.items()
        }
    with pytest.raises(error, match=message):
        function(**arguments)
