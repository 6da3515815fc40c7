"""Slow twin of `geraf2.freespace.specular`: one surface element, one plane, one triangle at a time.

A monostatic echo is specular where the direction to the antenna is the normal: p + t n = a, t > 0.
"""

import numpy as np


def specular_margin(point, normal, corners, triangles=(), lift_m=0.0):
    """Distance of the mirror point inside the nearest edge of a rectangle; -inf if none [m].

    corners: of the rectangle in turn, (4, 3) [m]. triangles: what may block, each (3, 3) [m].
    lift_m: where the ray begins [m].
    """
    across, up = corners[1] - corners[0], corners[3] - corners[0]
    plane_normal = np.cross(across, up) / np.linalg.norm(np.cross(across, up))
    if abs(plane_normal @ normal) <= 0.1:  # 84 degrees off the boresight
        return -np.inf
    t, u, v = np.linalg.solve(np.stack([-normal, across, up], axis=1), point - corners[0])
    if t <= 0.0:
        return -np.inf
    for a, b, c in triangles:
        if blocks(point + lift_m * normal, normal, t - lift_m, a, b, c):
            return -np.inf
    width, height = np.linalg.norm(across), np.linalg.norm(up)
    return min(u * width, (1.0 - u) * width, v * height, (1.0 - v) * height)


def blocks(start, direction, length, a, b, c):
    """Whether a triangle meets the piece of a line from its start."""
    matrix = np.stack([-direction, b - a, c - a], axis=1)
    if abs(np.linalg.det(matrix)) < 1e-15:
        return False
    t, u, v = np.linalg.solve(matrix, start - a)
    return 0.0 < t < length and u >= 0.0 and v >= 0.0 and u + v <= 1.0
