"""Outlines of bodies whose half extents are known."""

import numpy as np

from geraf2.freespace.silhouettes import Silhouettes

CELL_M = 0.002


def outlines(axes, half_m, known=None):
    """Shadows of a body whose half extents along x, y and z are given, elliptic across."""
    cells = CELL_M * np.arange(-40, 41)
    u, v = np.meshgrid(cells, cells, indexing="ij")
    free = []
    for axis in axes:
        a, b = (half_m[k] for k in range(3) if k != axis)
        off_m = (np.hypot(u / a, v / b) - 1.0) * np.sqrt(a * b)
        free.append(np.clip(0.5 + off_m / (2.0 * CELL_M), 0.0, 1.0))
    shape = (len(axes), len(cells), len(cells))
    return Silhouettes(
        axes=np.array(axes),
        origins_m=np.full((len(axes), 2), cells[0]),
        spacing_m=np.array(CELL_M),
        transmission=np.array(free),
        known=np.ones(shape, dtype=bool) if known is None else np.broadcast_to(known, shape),
        thresholds=np.full(len(axes), 0.5),
        disagreement=np.zeros(len(axes)),
        reason=np.array(""),
    )
