"""Curvature of a surface around single glints, from the glints beside them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.glint_set import Glints, strong_level

# Of a patch: 1.5 cm hold some 60 glints of a body seen from planes 10 degrees apart, and a
# curvature of 1/(2 cm) errs by a few percent; more smooths over edges, in less noise counts.
_RADIUS_M = 0.015
_NEIGHBORS = 200
_MIN_GLINTS = 12
# Residuals of a quadric that are noise: 1.5 times the errors of strong glints (0.03 rad, 0.4 mm).
_NORMAL_RMS_RAD = 0.05
_POSITION_RMS_M = 6e-4
# Share of the weight that the quadric must explain, and extent of what it explains in the
# direction asked for, in radii.
_MIN_SHARE = 0.7
_MIN_EXTENT = 0.6
_ROUNDS = 4
_CHUNK = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """Quadrics that explain the glints around them to within their noise."""

    points: Floats
    """On the surface, (n, 3) [m]."""
    normals: Floats
    """Outward, unit (n, 3)."""
    curvatures_per_m: Floats
    """Normal curvature in the direction asked for, positive where convex, (n,)."""


def fit_patches(glints: Glints, index: Ints, along: Floats) -> tuple[Patches, Ints]:
    """Quadric around each of some glints, where one fits -> patches and whose they are (n,).

    Least squares over positions and normals of the neighbours, weighted by strength, outliers
    weighted down in rounds (docs/math/surface-fit.md#continued-curvature).

    glints: all of the surface.
    index: glints asked for, (n_asked,).
    along: unit tangents there, the direction whose curvature is asked for, (n_asked, 3).
    """
    parts, whose = [], []
    tree = KDTree(glints.positions)
    for first in range(0, len(index), _CHUNK):
        some = slice(first, first + _CHUNK)
        patches, good = _fit_chunk(glints, tree, index[some], along[some])
        parts.append(patches)
        whose.append(first + good)
    if not parts:
        nothing = np.zeros((0, 3))
        empty = Patches(points=nothing, normals=nothing, curvatures_per_m=np.zeros(0))
        return empty, np.zeros(0, dtype=np.int64)
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in Patches.__dataclass_fields__
    }
    return Patches(**joined), np.concatenate(whose)


def _fit_chunk(glints: Glints, tree: KDTree, index: Ints, along: Floats) -> tuple[Patches, Ints]:
    center, normal = glints.positions[index], glints.normals[index]
    across = np.cross(normal, along)
    k = np.arange(1, min(_NEIGHBORS, len(glints)) + 1)
    distance, near = tree.query(center, k=k, distance_upper_bound=_RADIUS_M)
    found = np.isfinite(distance)
    near = np.where(found, near, 0)
    offset, turned = glints.positions[near] - center[:, None], glints.normals[near]
    x, y, h = (np.einsum("nki,ni->nk", offset, axis) for axis in (along, across, normal))
    facing = np.einsum("nki,ni->nk", turned, normal)
    usable = found & (facing > 0.5) & (np.abs(h) < 0.5 * _RADIUS_M)
    strong = strong_level(glints.strengths)
    base = usable * np.minimum(1.0, glints.strengths[near] / strong)

    turn = turned - normal[:, None]
    a, b = (np.einsum("nki,ni->nk", turn, axis) for axis in (along, across))
    rows, right = _equations(x, y, np.stack([a, b, h], axis=-1))
    weight = base
    for _ in range(_ROUNDS):
        weighted = rows * weight[..., None, None]
        matrix = np.einsum("nkci,nkcj->nij", weighted, rows) + 1e-12 * np.eye(6)
        vector = np.einsum("nkci,nkc->ni", weighted, right)
        solution = np.linalg.solve(matrix, vector[..., None])[..., 0]
        residual = np.einsum("nkci,ni->nkc", rows, solution) - right
        angle = np.hypot(residual[..., 0], residual[..., 1])
        depth = _RADIUS_M * np.abs(residual[..., 2])
        outside = np.maximum(angle / (3.0 * _NORMAL_RMS_RAD), depth / (3.0 * _POSITION_RMS_M))
        weight = base * (np.clip(1.0 - outside**2, 0.0, None) ** 2 + 1e-9)

    explained = base * (outside < 1.0)
    total = explained.sum(axis=1) + 1e-30
    good = np.nonzero(
        ((explained > 0.0).sum(axis=1) >= _MIN_GLINTS)
        & (total > _MIN_SHARE * base.sum(axis=1))
        & (np.sqrt((explained * angle**2).sum(axis=1) / total) < _NORMAL_RMS_RAD)
        & (np.sqrt((explained * depth**2).sum(axis=1) / total) < _POSITION_RMS_M)
        & (_extent(x, explained > 0.0) > _MIN_EXTENT * _RADIUS_M)
    )[0]
    curvature, _, _, tilt, tilt_across, height = solution[good].T
    points = center[good] + (_RADIUS_M * height)[:, None] * normal[good]
    normals = normal[good] + tilt[:, None] * along[good] + tilt_across[:, None] * across[good]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (
        Patches(points=points, normals=normals, curvatures_per_m=curvature / _RADIUS_M),
        good.astype(np.int64),
    )


def _equations(x: Floats, y: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Rows (n, k, 3, 6) and right sides (n, k, 3): two turns of the normal, and the height.

    Unknowns: curvature along, twist, curvature across, two tilts, height; lengths in radii. Turns
    and heights count alike: a strong glint's 0.4 mm in 15 mm are 0.027, its normal's error is 0.03.
    """
    x, y = x / _RADIUS_M, y / _RADIUS_M
    one, zero = np.ones_like(x), np.zeros_like(x)
    rows = np.stack(
        [
            np.stack([x, y, zero, one, zero, zero], axis=-1),
            np.stack([zero, x, y, zero, one, zero], axis=-1),
            np.stack([-0.5 * x * x, -x * y, -0.5 * y * y, -x, -y, one], axis=-1),
        ],
        axis=2,
    )
    right = measured.copy()
    right[..., 2] /= _RADIUS_M
    return rows, right


def _extent(x: Floats, used: Bools) -> Floats:
    """From the 5 % to the 95 % quantile of the values used, row by row; 0 where there are none."""
    ordered = np.sort(np.where(used, x, np.inf), axis=1)
    last = np.maximum(used.sum(axis=1) - 1, 0)
    row = np.arange(len(x))
    low = ordered[row, np.rint(0.05 * last).astype(int)]
    high = ordered[row, np.rint(0.95 * last).astype(int)]
    extent = np.zeros(len(x))
    some = used.any(axis=1)
    extent[some] = high[some] - low[some]
    return extent
