"""Polygons and strips as triangles."""

import numpy as np

from geraf2._types import Bools, Floats, Ints

_MAX_CORNERS = 4096
"""Largest number of corners of a concave polygon; the time grows with its square."""
_FLAT = 1e-12
"""Tolerance of a corner's turn, relative to the squared area: guards against rounding."""


def triangulated(vertices: Floats, corners: Ints, counts: Ints) -> Ints:
    """Triangles of polygons in their order and winding, (n_triangles, 3).

    vertices: (n_vertices, 3).
    corners: vertex indices of all polygons, concatenated.
    counts: number of corners of each; polygons with fewer than three are dropped.

    Raises ValueError for a concave polygon with more than 4096 corners.
    """
    starts = np.cumsum(counts) - counts
    known = not corners.size or (corners.min() >= 0 and corners.max() < len(vertices))
    faces, owners = [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for n in np.unique(counts[counts >= 3]).tolist():
        chosen = np.flatnonzero(counts == n)
        polygons = corners[starts[chosen][:, None] + np.arange(n)]
        concave = _concave(vertices[polygons]) if known and n > 3 else np.zeros(len(chosen), bool)
        fan = np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], axis=1)
        faces.append(polygons[~concave][:, fan].reshape(-1, 3))
        owners.append(np.repeat(chosen[~concave], n - 2))
        for owner, polygon in zip(chosen[concave], polygons[concave], strict=True):
            cut = polygon[_ears(vertices[polygon])]
            faces.append(cut)
            owners.append(np.full(len(cut), owner))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.asarray(np.concatenate(faces)[order], dtype=np.int64)


def strip_triangles(strip: Ints) -> Ints:
    """Triangles of a strip, (n_triangles, 3); -1 starts another strip."""
    parts = []
    for part in np.split(strip, np.flatnonzero(strip < 0)):
        run = part[part >= 0]
        faces = np.stack([run[:-2], run[1:-1], run[2:]], axis=1) if len(run) > 2 else run[:0]
        faces = faces.reshape(-1, 3).copy()
        faces[1::2] = faces[1::2][:, [1, 0, 2]]
        parts.append(faces)
    return np.concatenate(parts)


def _normals(polygons: Floats) -> Floats:
    """Polygon normals, (n, n_corners, 3) -> (n, 3), with twice the area as length."""
    spokes = polygons - polygons[:, :1]
    return np.asarray(np.cross(spokes[:, :-1], spokes[:, 1:]).sum(axis=1))


def _concave(polygons: Floats) -> Bools:
    """Whether a corner of a polygon turns against its normal, (n,)."""
    edges = np.roll(polygons, -1, axis=1) - polygons
    turns = np.cross(np.roll(edges, 1, axis=1), edges)
    normals = _normals(polygons)
    along = np.einsum("nck,nk->nc", turns, normals)
    return np.asarray((along < -_FLAT * (normals**2).sum(axis=1)[:, None]).any(axis=1))


def _ears(polygon: Floats) -> Ints:
    """Triangles of one polygon (n, 3) by ear clipping, (n - 2, 3)."""
    if len(polygon) > _MAX_CORNERS:
        msg = f"a concave polygon has {len(polygon)} corners, more than {_MAX_CORNERS}"
        raise ValueError(msg)
    normal = _normals(polygon[None])[0]
    flat = np.delete(polygon, int(np.abs(normal).argmax()), axis=1)
    a, b = np.roll(flat, 1, axis=0), flat
    if (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() < 0:
        flat = flat * [-1.0, 1.0]
    rest, faces = list(range(len(flat))), []
    while len(rest) > 3:
        at = next((k for k in range(len(rest)) if _is_ear(flat, rest, k)), 0)
        faces.append((rest[at - 1], rest[at], rest[(at + 1) % len(rest)]))
        del rest[at]
    return np.array([*faces, rest], dtype=np.int64)


def _is_ear(flat: Floats, rest: list[int], at: int) -> bool:
    """Whether a corner is convex and no other one lies within its triangle."""
    tri = flat[[rest[at - 1], rest[at], rest[(at + 1) % len(rest)]]]
    sides = np.roll(tri, -1, axis=0) - tri
    if not sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0] > 0:
        return False
    others = flat[rest]
    offsets = others[:, None] - tri
    inside = (sides[:, 0] * offsets[..., 1] - sides[:, 1] * offsets[..., 0] >= 0).all(axis=1)
    corner = (others[:, None] == tri).all(axis=2).any(axis=1)
    return not (inside & ~corner).any()
