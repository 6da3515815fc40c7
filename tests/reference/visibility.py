"""Ray and distance queries by brute force over all faces, in float64."""

import numpy as np


def ray_hits(vertices, faces, origin, direction):
    """Distances along the unit direction and signs of all crossings, by Moller-Trumbore."""
    direction = direction / np.linalg.norm(direction)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    edge_1, edge_2 = b - a, c - a
    p = np.cross(direction, edge_2)
    det = np.einsum("fi,fi->f", edge_1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - a
        u = np.einsum("fi,fi->f", s, p) / det
        q = np.cross(s, edge_1)
        v = q @ direction / det
        t = np.einsum("fi,fi->f", edge_2, q) / det
    hit = (np.abs(det) > 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
    order = np.argsort(t[hit])
    # det > 0 where the face looks against the ray
    return t[hit][order], (det[hit] > 0)[order], np.flatnonzero(hit)[order]


def point_segment_distance(points, a, b):
    s = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(points - (a + s[:, None] * (b - a)), axis=1)


def point_triangle_distance(points, triangle):
    """Plane distance where the foot lies inside the triangle, else the nearest of three edges."""
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal)
    height = (points - a) @ normal
    foot = points - height[:, None] * normal
    inside = np.ones(len(points), dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= np.cross(end - start, foot - start) @ normal >= 0
    edges = np.min([point_segment_distance(points, *e) for e in ((a, b), (b, c), (c, a))], axis=0)
    return np.where(inside, np.abs(height), edges)


def unsigned_distance(vertices, faces, points):
    return np.min([point_triangle_distance(points, vertices[f]) for f in faces], axis=0)


def solid_angle_winding(vertices, faces, points):
    """Sum of signed solid angles of all faces over 4 pi (Van Oosterom and Strackee, 1983)."""
    total = np.zeros(len(points))
    for face in faces:
        a, b, c = (vertices[i] - points for i in face)
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        num = np.einsum("pi,pi->p", a, np.cross(b, c))
        den = la * lb * lc
        den = den + np.einsum("pi,pi->p", a, b) * lc
        den = den + np.einsum("pi,pi->p", b, c) * la + np.einsum("pi,pi->p", c, a) * lb
        total += 2 * np.arctan2(num, den)
    return total / (4 * np.pi)
