"""Distances to the nearest of many points."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats


def nearest_distance(
    points: Floats,
    to: Floats | KDTree,
    *,
    max_distance_m: float = np.inf,
    num_threads: int | None = None,
) -> Floats:
    """Distance of each point to the nearest of others.

    points: (n, 3) [m]. to: (m, 3), at least one [m], or a tree of them. max_distance_m: what is
    farther is not looked for. num_threads: all when None.

    Returns (n,) [m], inf where it is farther.
    """
    tree = to if isinstance(to, KDTree) else KDTree(to)
    # Not on the main thread: there a signal ends scipy's wait, while its threads still read arrays
    # that are freed. 5 of 9 signals in the stage sdf ended in a segmentation fault.
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(
            tree.query, points, distance_upper_bound=max_distance_m, workers=num_threads or -1
        ).result()[0]
    return np.asarray(found, dtype=np.float64)
