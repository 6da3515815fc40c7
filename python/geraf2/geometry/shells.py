"""Nested shells of a mesh."""

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.geometry.components import face_labels

_INSIDE = 0.5
"""Winding number above which a point is inside."""


def outer_shells(vertices: Floats, faces: Ints) -> Bools:
    """Whether each face belongs to a shell that no other one encloses, (n_faces,).

    vertices, faces: closed mesh, (n_vertices, 3) and (n_faces, 3), with any winding.
    """
    labels, n_shells = face_labels(faces)
    outer = np.ones(len(faces), dtype=np.bool_)
    if n_shells < 2:
        return outer
    shells = np.arange(n_shells)
    bounds = []
    for shell in shells:
        used = vertices[faces[labels == shell]].reshape(-1, 3)
        bounds.append((used.min(axis=0), used.max(axis=0)))
    low, high = (np.array(side) for side in zip(*bounds, strict=True))
    for k, shell in enumerate(shells):
        around = (low < low[k]).all(axis=1) & (high > high[k]).all(axis=1)
        point = vertices[faces[labels == shell][0, 0]]
        for other in shells[around]:
            if abs(_winding(point, vertices[faces[labels == other]])) > _INSIDE:
                outer[labels == shell] = False
                break
    return outer


def _winding(point: Floats, corners: Floats) -> float:
    """Winding number of triangles (n, 3, 3) around a point, from their solid angles."""
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("nk,nk->n", a, np.cross(b, c))
    dots = [np.einsum("nk,nk->n", *pair) for pair in ((a, b), (b, c), (c, a))]
    flat = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return float(np.arctan2(volume, flat).sum() / (2 * np.pi))
