"""Residuals of oriented points against each other's tangent planes."""

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints

Pairs = tuple[Ints, Ints]


def tangent_offset(positions: Floats, others: Floats, normals: Floats) -> Floats:
    """Height of others above the planes through positions, (p_j - p_i) . n, (n,) [m].

    With the normal of the first point its order is the square of the distance on a smooth surface,
    with the mean of both normals the third power (docs/math/echoes.md#connected-glints).
    """
    return np.asarray(np.einsum("ij,ij->i", others - positions, normals))


def agreeing_pairs(
    positions: Floats, normals: Floats, *, radius_m: float, offset_m: float, angle_rad: float
) -> Pairs:
    """Ordered pairs (i, j) in which j lies on the tangent plane of i and faces the same direction.

    radius_m: distance of both at most [m].
    offset_m: of j from the tangent plane at most [m].
    angle_rad: between both normals at most [rad].
    """
    i, j = near_pairs(positions, radius_m)
    i, j = np.concatenate([i, j]), np.concatenate([j, i])
    alike = np.einsum("ij,ij->i", normals[i], normals[j]) > np.cos(angle_rad)
    fits = alike & (np.abs(tangent_offset(positions[i], positions[j], normals[i])) < offset_m)
    return i[fits], j[fits]


def near_pairs(positions: Floats, reach_m: float, within: Ints | None = None) -> Pairs:
    """Pairs of places (n, 3) nearer than this [m], of equal number if `within`, (n,), is given."""
    if within is None:
        pairs = KDTree(positions).query_pairs(reach_m, output_type="ndarray").astype(np.int64)
        return pairs[:, 0], pairs[:, 1]
    order = np.argsort(within, kind="stable")
    found = [np.zeros((0, 2), dtype=np.int64)]
    for group in np.split(order, np.nonzero(np.diff(within[order]))[0] + 1):
        pairs = KDTree(positions[group]).query_pairs(reach_m, output_type="ndarray")
        found.append(group[pairs])
    together = np.concatenate(found)
    return together[:, 0], together[:, 1]
