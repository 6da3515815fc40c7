"""Parts with closed surfaces, as if they had been measured, for tests of inspections."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from geraf2.apps.inspection.bodies import Body
from geraf2.io.mesh import TriangleMesh

POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
POSE[:3, 3] = [0.012, -0.007, 0.02]


def block(sides_m, middle_m=(0.0, 0.0, 0.0), edge_m=0.004):
    """Block in fine triangles."""
    made = trimesh.creation.box(extents=sides_m)
    made = made.subdivide_to_size(edge_m, max_iter=20)
    made.merge_vertices()
    return TriangleMesh(
        vertices=np.asarray(made.vertices) + middle_m, faces=np.asarray(made.faces, np.int64)
    )


def joined(*meshes):
    """All in one, touching or not."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return TriangleMesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + s for m, s in zip(meshes, starts[:-1], strict=True)]),
    )


def wedge(height_m=0.03):
    """Solid without any symmetry: a block with three of its upper corners moved."""
    made = block((0.06, 0.04, height_m))
    x, y, z = made.vertices.T
    up = z / height_m + 0.5
    moved = np.stack([x * (1.0 - 0.3 * up * (y > 0)), y * (1.0 - 0.35 * up), z + 0.25 * x * up], 1)
    return TriangleMesh(vertices=moved, faces=made.faces)


SMALL = block((0.02, 0.015, 0.03), (0.07, 0.0, 0.0))


def measured(mesh, pose=POSE, *, sigma_m=0.0005, unseen=None, seed=0):
    """Body of a mesh that was moved; errors of the stated size along its normals.

    unseen: directions in the mesh's frame whose side was filled, 4 mm off, and said to be.
    """
    from geraf2.geometry.triangles import vertex_normals  # noqa: PLC0415

    rng = np.random.default_rng(seed)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    seen, off = np.ones(len(normals), dtype=bool), sigma_m * rng.normal(size=len(normals))
    if unseen is not None:
        seen = normals @ np.asarray(unseen) < 0.5
        off = np.where(seen, off, -0.004)
    vertices = (mesh.vertices + off[:, None] * normals) @ pose[:3, :3].T + pose[:3, 3]
    return Body(
        mesh=TriangleMesh(vertices=vertices, faces=mesh.faces),
        sigma_m=np.where(seen, sigma_m, 0.004),
        seen=seen,
    )
