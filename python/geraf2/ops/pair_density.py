"""Densities that points of a surface predict for each other."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Floats, Ints
from geraf2._validation import require_shape

PairModel = _core.PairModel
"""Constants of the density: reach, spread [m], least cosine of the normals, and others in
`pair_density.hpp`."""


class PeakPoints(NamedTuple):
    """Points with normals, from peaks of sub-apertures of planes."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """Unit vectors, (n, 3)."""
    planes: Ints
    """(n,)."""
    subapertures: Ints
    """(n,)."""

    def rows(self, first: int, stop: int) -> "PeakPoints":
        """Select consecutive points."""
        positions, normals, planes, subapertures = (values[first:stop] for values in self)
        return PeakPoints(positions, normals, planes, subapertures)  # type: ignore[arg-type]


def pair_densities(points: PeakPoints, others: PeakPoints, model: PairModel) -> sparse.csr_array:
    """Densities at points that others within reach predict, (n_points, 2 n_others) [1/(m^3 sr)].

    The first n_others columns hold others of other planes, the last those of the point's own
    plane. Points of one sub-aperture do not predict each other. The density is that of
    docs/math/echoes.md#labels. No gradients.

    points, others: finite.
    model: constants.
    """
    arrays = (*_checked("points", points), *_checked("others", others))
    shape = len(points.planes), 2 * len(others.planes)
    densities, columns, starts = _core.pair_densities(*arrays, model)
    index = np.int32 if starts[-1] <= np.iinfo(np.int32).max else np.int64  # half the memory
    rows = densities, columns.astype(index), starts.astype(index)
    return sparse.csr_array(rows, shape=shape)


def _checked(name: str, points: PeakPoints) -> tuple[Floats, Floats, Ints, Ints]:
    n = len(points.planes)
    if n >= 2**30:
        msg = f"{name} must be fewer than 2^30, got {n}"
        raise ValueError(msg)
    vectors = []
    for kind in ("positions", "normals"):
        values = np.ascontiguousarray(getattr(points, kind), dtype=np.float64)
        require_shape(f"{name}.{kind}", values, (n, 3))
        if not np.isfinite(values).all():
            msg = f"{name}.{kind} must be finite"
            raise ValueError(msg)
        vectors.append(values)
    numbers = [np.ascontiguousarray(values, dtype=np.int64) for values in points[2:]]
    return vectors[0], vectors[1], numbers[0], numbers[1]
