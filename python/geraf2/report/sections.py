"""Cuts of triangle meshes with planes across the axes."""

import numpy as np

from geraf2._types import Floats
from geraf2.io.mesh import TriangleMesh


def plane_section(mesh: TriangleMesh, axis: int, coordinate_m: float) -> Floats:
    """Line segments of the intersection with the plane x[axis] = coordinate_m, (n, 2, 3) [m].

    A vertex exactly in the plane counts as above it.
    """
    height = mesh.vertices[:, axis] - coordinate_m
    above = (height >= 0)[mesh.faces]
    crossing = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    faces, sides = mesh.faces[crossing], above[crossing]
    # The corner that is alone on its side has the two crossing edges.
    n_above = sides.sum(axis=1)
    alone = np.where(n_above == 1, np.argmax(sides, axis=1), np.argmin(sides, axis=1))
    rows = np.arange(len(faces))
    apex = faces[rows, alone]
    ends = []
    for step in (1, 2):
        other = faces[rows, (alone + step) % 3]
        t = height[apex] / (height[apex] - height[other])
        ends.append(mesh.vertices[apex] + t[:, None] * (mesh.vertices[other] - mesh.vertices[apex]))
    return np.stack(ends, axis=1)
