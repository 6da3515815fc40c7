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
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return TriangleMesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + s for m, s in zip(meshes, starts[:-1], strict=True)]),
    )
