"""Displacement of unseen tops and bottoms (caps) inwards.

The surface with the least bending over a wide unseen cap is a dome. The glints around the cap show
whether that is likely. A rounded body has glints whose normals lean towards the cap, up to the
limit of the aperture; a body with an edge has none (docs/math/surface-fit.md#caps).
"""

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2.echoes.glint_set import Glints

# Glints around a cap: enough to surround a cap of 10 cm, and not the whole content.
_NEIGHBORS = 100
# Quantile of the cosines between the cap's normal and theirs: the most leaning sixth counts.
_QUANTILE = 0.85


def cap_retreat(
    points: Floats,
    normals: Floats,
    glints: Glints,
    *,
    slope: float,
    start_m: float,
    lean: tuple[float, float],
    known: Floats | None = None,
) -> Floats:
    """Distance by which points of a surface should move inwards, (n_points,) [m].

    points: on the surface, (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    slope: displacement per distance to the nearest known position beyond `start_m`.
    start_m: points nearer to a known position do not move [m].
    lean: cosines between a point's normal and those of the glints around it. Below the first the
        displacement is full, above the second zero, linear between.
    known: known positions of the surface, seen or not, (n_known, 3) [m]; the glints when None.
    """
    retreat = np.zeros(len(points))
    if slope <= 0.0 or len(glints) == 0:
        return retreat
    tree = KDTree(glints.positions)
    distance = (tree if known is None else KDTree(known)).query(points)[0]
    far = np.nonzero(distance > start_m)[0]
    if len(far) == 0:
        return retreat
    flat = _flatness(points[far], normals[far], glints, lean, tree)
    retreat[far] = slope * flat * (distance[far] - start_m)
    return retreat


def _flatness(
    points: Floats,
    normals: Floats,
    glints: Glints,
    lean: tuple[float, float],
    tree: KDTree,
) -> Floats:
    """Flatness of a cap by the glints around it, from 0 (round) to 1 (has an edge), (n_points,).

    tree: of the glints' positions. Other arguments as those of `cap_retreat`.
    """
    neighbors = np.arange(1, min(_NEIGHBORS, len(glints)) + 1)
    _, around = tree.query(points, k=neighbors)
    cosine = np.einsum("nkj,nj->nk", glints.normals[around], normals)
    low, high = lean
    leaning = np.quantile(cosine, _QUANTILE, axis=1)
    return np.asarray(np.clip((high - leaning) / (high - low), 0.0, 1.0))
