"""Solids as signed distances and their smooth unions, the parts of procedural objects."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2.io.mesh import TriangleMesh

Points = Floats
"""(..., 3), object coordinates: z up, one unit about a centimetre."""
Distance = Floats
"""(...), below zero inside."""
Solid = Callable[[Points], Distance]


def limb(start: Sequence[float], end: Sequence[float], r_start: float, r_end: float) -> Solid:
    """Tapered stroke with round ends: distance to the segment minus the interpolated radius."""
    a, b = np.asarray(start, float), np.asarray(end, float)

    def distance(points: Points) -> Distance:
        along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.linalg.norm(points - a - along[..., None] * (b - a), axis=-1)
        return np.asarray(away - r_start - along * (r_end - r_start))

    return distance


def ball(center: Sequence[float], radii: Sequence[float]) -> Solid:
    """Ellipsoid: exact to first order at its surface."""
    c, r = np.asarray(center, float), np.asarray(radii, float)
    return lambda points: _from_ellipsoid(points - c, r)


def ring(center: Sequence[float], radii: Sequence[float], radius: float) -> Solid:
    """Round tube along an ellipse with radii along y and z in a plane x = const.

    Exact to first order near the ellipse.
    """
    c, r = np.asarray(center, float), np.asarray(radii, float)

    def distance(points: Points) -> Distance:
        q = points - c
        return np.asarray(np.hypot(q[..., 0], _from_ellipsoid(q[..., 1:], r)) - radius)

    return distance


def _from_ellipsoid(q: Points, radii: Floats) -> Distance:
    """|q / r| (|q / r| - 1) / |q / r^2|, for an ellipsoid, or an ellipse, about the origin."""
    k = np.linalg.norm(q / radii, axis=-1)
    slope = np.linalg.norm(q / radii**2, axis=-1)
    return np.asarray(k * (k - 1.0) / np.maximum(slope, 1e-9))  # 1e-9: the very centre


def block(center: Sequence[float], half: Sequence[float], rounding: float = 0.0) -> Solid:
    """Box with sides 2 half; `rounding` is the radius of its edges."""
    c, h = np.asarray(center, float), np.asarray(half, float) - rounding

    def distance(points: Points) -> Distance:
        q = np.abs(points - c) - h
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0) - rounding)

    return distance


def tube(path: Floats, radius: float) -> Solid:
    """Round tube along a polyline (n, 3): distance to it, sampled every tenth of a radius.

    The surface is rough by 1e-3 radius for that: less than a grid cell by two orders.
    """
    pieces = [
        np.linspace(start, end, 2 + int(10.0 * np.linalg.norm(end - start) / radius))
        for start, end in itertools.pairwise(path)
    ]
    tree = KDTree(np.concatenate(pieces))

    def distance(points: Points) -> Distance:
        return np.asarray(tree.query(points)[0] - radius)

    return distance


def arc(
    center: Sequence[float], radii: Sequence[float], ends_deg: Sequence[float], radius: float
) -> Solid:
    """Round tube along part of an ellipse with radii along x and z, in a plane y = const.

    ends_deg: angles where it starts and ends, from x to z [degrees].
    """
    turn = np.deg2rad(np.linspace(ends_deg[0], ends_deg[1], 25))
    ellipse = np.stack([radii[0] * np.cos(turn), 0.0 * turn, radii[1] * np.sin(turn)], axis=1)
    return tube(np.asarray(center) + ellipse, radius)


def revolve(profile: Floats) -> Solid:
    """Solid of revolution: stacked tapered strokes through (height, radius), (n, 2)."""
    strokes = [
        limb((0.0, 0.0, low), (0.0, 0.0, high), r_low, r_high)
        for (low, r_low), (high, r_high) in itertools.pairwise(profile)
    ]

    def distance(points: Points) -> Distance:
        return np.asarray(np.min([stroke(points) for stroke in strokes], axis=0))

    return distance


def blend(solids: Sequence[Solid], radius: float) -> Solid:
    """Smooth union: fillets of about `radius` where solids meet.

    min(a, b) - r h^3 / 6, h = max(r - |a - b|, 0) / r, pair after pair.
    """

    def distance(points: Points) -> Distance:
        total = solids[0](points)
        for solid in solids[1:]:
            other = solid(points)
            h = np.maximum(radius - np.abs(total - other), 0.0) / radius
            total = np.minimum(total, other) - radius * h**3 / 6.0
        return total

    return distance


def grid_points(low: Floats, high: Floats, step: float) -> Points:
    """Points of a grid over a box, (nx, ny, nz, 3)."""
    # 0.377: no face of a block may lie in a plane of the grid, where cubes degenerate.
    axes = [np.arange(a - 0.377 * step, b + step, step) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def zero_level(distances: Distance, step: float) -> TriangleMesh:
    """Surface of distances at the points of a grid, from its first point."""
    from skimage.measure import marching_cubes  # noqa: PLC0415 - 0.3 s to import

    vertices, faces, _, _ = marching_cubes(distances, 0.0, spacing=(step,) * 3)
    return TriangleMesh(vertices=vertices.astype(np.float64), faces=faces.astype(np.int64))


@dataclass(frozen=True)
class Figure:
    """A solid and its bounding box."""

    solid: Solid
    low: tuple[float, float, float]
    high: tuple[float, float, float]
