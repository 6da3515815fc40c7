"""Connected components of pairs, and of faces."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from geraf2._types import Bools, Floats, Ints
from geraf2.geometry.triangles import closed_edges, directed_edges, six_fold_volumes


def connected_labels(i: Ints, j: Ints, n: int) -> Ints:
    """Component of each of n nodes, (n,), from 0; i and j, (n_pairs,), are connected pairs."""
    graph = csr_array((np.ones(len(i)), (i, j)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def face_labels(faces: Ints) -> tuple[Ints, int]:
    """Component of each face, (n_faces,), from 0, and their number; faces connect at vertices."""
    if not len(faces):
        return np.zeros(0, dtype=np.int64), 0
    edges = directed_edges(faces)
    of_vertex = connected_labels(edges[:, 0], edges[:, 1], int(faces.max()) + 1)
    present, labels = np.unique(of_vertex[faces[:, 0]], return_inverse=True)
    return labels.astype(np.int64), len(present)


def are_voids(vertices: Floats, faces: Ints, labels: Ints, n_components: int) -> Bools:
    """Whether each component is closed and faces inwards, (n_components,).

    labels: component of each face, (n_faces,).
    """
    volumes = np.bincount(labels, six_fold_volumes(vertices, faces), n_components)
    n_open = np.bincount(np.tile(labels, 3), ~closed_edges(faces), n_components)
    return np.asarray((volumes < 0.0) & (n_open == 0))
