"""Distance to the nearest of many points."""

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
    """Distance of each point to the nearest of others, (n,) [m]; inf beyond the maximum.

    points: (n, 3) [m].
    to: other points, at least one, (m, 3) [m], or a tree of them.
    max_distance_m: limit of the search [m].
    """
    tree = to if isinstance(to, KDTree) else KDTree(to)
    # Not in the main thread: there a signal ends scipy's wait while its threads still read arrays
    # that are then freed, a segmentation fault.
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(
            tree.query, points, distance_upper_bound=max_distance_m, workers=num_threads or -1
        ).result()[0]
    return np.asarray(found, dtype=np.float64)
