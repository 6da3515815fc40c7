"""How far unseen tops and bottoms are drawn inwards.

The surface that bends least over a wide unseen cap is a dome. The glints around the cap say whether
that is likely: a body that rounds off is seen leaning towards the cap as far as the aperture
reaches, a body with an edge there is not (docs/math/surface-fit.md#caps).
"""

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2.echoes.glint_set import Glints

# The glints that surround a cap: enough to reach around one of 10 cm, and few enough not to
# reach around the whole figure. The most leaning sixth of them counts.
_NEIGHBORS = 100
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
    """Distance by which points of a surface are to be drawn inwards, (n_points,) [m].

    points: on the surface, (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    slope: retreat per distance to the nearest known place beyond `start_m`.
    start_m: points nearer to a known place than this stay [m].
    lean: cosines between the normal of a point and those of the glints around it: below the first
        the retreat is whole, above the second there is none, linear between.
    known: where the surface is known, seen or not, (n_known, 3) [m]; the glints when None.
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
    """How far the glints around say that a cap has an edge, not that it rounds off, (n_points,).

    From 0, round, to 1, flat; arguments as of `cap_retreat`. tree: of the glints' positions.
    """
    neighbors = np.arange(1, min(_NEIGHBORS, len(glints)) + 1)
    _, around = tree.query(points, k=neighbors)
    cosine = np.einsum("nkj,nj->nk", glints.normals[around], normals)
    low, high = lean
    leaning = np.quantile(cosine, _QUANTILE, axis=1)
    return np.asarray(np.clip((high - leaning) / (high - low), 0.0, 1.0))
