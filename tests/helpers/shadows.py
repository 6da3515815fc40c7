"""Shadows, and outlines of bodies whose half extents are known."""

import numpy as np

from geraf2.freespace.silhouettes import Silhouettes

CELL_M = 0.002


def shadows(transmission, axes=(0,), known=None):
    """Shadows across axes, each on cells about the middle, (n_axes, n_u, n_v)."""
    transmission = np.asarray(transmission, dtype=float)
    n, *sides = shape = transmission.shape
    return Silhouettes(
        axes=np.array(axes),
        origins_m=np.tile(-0.5 * CELL_M * (np.array(sides) - 1), (n, 1)),
        spacing_m=np.array(CELL_M),
        transmission=transmission,
        known=np.ones(shape, dtype=bool) if known is None else np.broadcast_to(known, shape),
        thresholds=np.full(n, 0.5),
        reason=np.array(""),
    )


def outlines(axes, half_m, known=None):
    """Shadows of a body whose half extents along x, y and z are given, elliptic across."""
    cells = CELL_M * np.arange(-40, 41)
    u, v = np.meshgrid(cells, cells, indexing="ij")
    free = []
    for axis in axes:
        a, b = (half_m[k] for k in range(3) if k != axis)
        off_m = (np.hypot(u / a, v / b) - 1.0) * np.sqrt(a * b)
        free.append(np.clip(0.5 + off_m / (2.0 * CELL_M), 0.0, 1.0))
    return shadows(free, axes, known)
