"""Connected components of pairs, and of faces."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from geraf2._types import Ints
from geraf2.geometry.triangles import directed_edges


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
