"""Groups of neighbouring antennas."""

import numpy as np

from geraf2._types import Floats, Ints


def antenna_clusters(places: Floats, n_clusters: int) -> list[Ints]:
    """Group neighbouring antennas in equal numbers, cutting the longest side again and again.

    places: (n_antennas, 3) [m].
    n_clusters: how many; 0 for one an antenna.

    Returns indices of each group, ascending.
    """
    n = places.shape[0]
    if n_clusters == 0 or n_clusters >= n:
        return [np.array([index]) for index in range(n)]
    groups = [(np.arange(n), n_clusters)]
    done: list[Ints] = []
    while groups:
        members, share = groups.pop()
        if share == 1:
            done.append(np.sort(members))
            continue
        extent = np.ptp(places[members], axis=0)
        order = members[np.argsort(places[members, int(extent.argmax())], kind="stable")]
        left = share // 2
        cut = round(len(order) * left / share)
        groups += [(order[:cut], left), (order[cut:], share - left)]
    return done
