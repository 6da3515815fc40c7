"""Slow twin of the mesh metrics, written from their definitions with plain loops."""

import math


def nearest_distances(points, others):
    """min over o of |p - o| for each p."""
    return [min(math.dist(p, o) for o in others) for p in points]


def chamfer(first, second):
    """Mean squared nearest distance, both directions, summed [m^2]."""
    there = nearest_distances(first, second)
    back = nearest_distances(second, first)
    return sum(d * d for d in there) / len(there) + sum(d * d for d in back) / len(back)


def f1(mesh_points, truth_points, tau):
    """Precision, recall and their harmonic mean at threshold tau [m]."""
    matched_mesh = [d < tau for d in nearest_distances(mesh_points, truth_points)]
    matched_truth = [d < tau for d in nearest_distances(truth_points, mesh_points)]
    precision = sum(matched_mesh) / len(matched_mesh)
    recall = sum(matched_truth) / len(matched_truth)
    if precision + recall == 0:
        return precision, recall, 0.0
    return precision, recall, 2 * precision * recall / (precision + recall)


def volume(corners):
    """Sum of the signed tetrahedra between the origin and the triangles, (n, 3, 3) -> [m^3]."""
    total = 0.0
    for (ax, ay, az), (bx, by, bz), (cx, cy, cz) in corners:
        total += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return total / 6.0


def extents(corners):
    """Largest less smallest coordinate along each axis [m]."""
    points = [corner for triangle in corners for corner in triangle]
    return [max(p[axis] for p in points) - min(p[axis] for p in points) for axis in range(3)]
