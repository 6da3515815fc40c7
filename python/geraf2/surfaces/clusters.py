"""Groups of neighbouring antennas."""

import numpy as np

from geraf2._types import Floats, Ints


def antenna_clusters(positions: Floats, n_clusters: int) -> list[Ints]:
    """Split antennas into groups of neighbours, of equal sizes.

    Each step halves a group across its longest side.

    positions: (n_antennas, 3) [m].
    n_clusters: number of groups; 0 makes one group per antenna.

    Returns the ascending indices of each group.
    """
    n = positions.shape[0]
    if n_clusters == 0 or n_clusters >= n:
        return [np.array([index]) for index in range(n)]
    groups = [(np.arange(n), n_clusters)]
    done: list[Ints] = []
    while groups:
        members, share = groups.pop()
        if share == 1:
            done.append(np.sort(members))
            continue
        extent = np.ptp(positions[members], axis=0)
        order = members[np.argsort(positions[members, int(extent.argmax())], kind="stable")]
        left = share // 2
        cut = round(len(order) * left / share)
        groups += [(order[:cut], left), (order[cut:], share - left)]
    return done
