"""Closed meshes of simple shapes."""

import numpy as np
import trimesh

from geraf2.io.mesh import TriangleMesh


def triangles(made, middle=(0.0, 0.0, 0.0), **attributes):
    """Mesh of trimesh as one of geraf2."""
    faces = np.array(made.faces, dtype=np.int64)
    return TriangleMesh(vertices=np.array(made.vertices) + middle, faces=faces, **attributes)


def ball(radius, subdivisions=3, middle=(0.0, 0.0, 0.0), **attributes):
    """Sphere with 20 * 4^subdivisions triangles."""
    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return triangles(made, middle, **attributes)


def joined(*meshes):
    """All in one, touching or not."""
    return TriangleMesh.joined(meshes)
