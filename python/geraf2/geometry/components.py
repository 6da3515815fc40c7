"""Connected components of pairs."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from geraf2._types import Ints


def connected_labels(i: Ints, j: Ints, n: int) -> Ints:
    """Component of each of n things, (n,), from 0; i and j, (n_pairs,), are pairs that connect."""
    graph = csr_array((np.ones(len(i)), (i, j)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
