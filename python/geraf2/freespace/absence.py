"""Surfaces whose specular return was expected and is absent.

A smooth surface whose normal points at the scanned aperture, with nothing in between, sends a
specular echo. Where the fitted surface does so and no glint was found, it is not there
(docs/math/free-space.md#absent-echoes).
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2.echoes.glint_set import Glints
from geraf2.freespace.specular import specular_visibility
from geraf2.ops.visibility import MeshScene
from geraf2.scene.aperture import Aperture

# Limits are ramps of this half width [m], [rad]: a surface that rounding moves across one is
# refuted by as much more or less, and not at once.
SOFT_M = 0.002
_SOFT_RAD = 0.05
# Rays begin this far above the fitted surface [m]: the facets around a point must not block them.
_LIFT_M = 1e-3


def beyond(values: Floats, limit: float, half_width: float = SOFT_M) -> Floats:
    """How far values are beyond a limit: 0 up to `half_width` before it, 1 from that behind it."""
    return np.clip(0.5 + 0.5 * (values - limit) / half_width, 0.0, 1.0)


def refuted(
    points: Floats,
    normals: Floats,
    scene: MeshScene,
    glints: Glints,
    apertures: Sequence[Aperture],
    *,
    margin_m: float,
    reach_m: float,
    angle_rad: float,
) -> Floats:
    """How certain a specular return of surface points is expected and absent, (n_points,).

    0 to 1, the product of ramps across the limits of margin, reach and angle.

    points: on the surface, (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    scene: the surface; it may hide its own parts.
    margin_m: rim of the apertures that does not count [m].
    reach_m: a glint this near explains a point [m].
    angle_rad: if its normal is within this angle [rad].
    """
    margins = specular_visibility(
        points, normals, apertures, scene, least_m=margin_m - SOFT_M, lift_m=_LIFT_M
    )
    result: Floats = beyond(margins, margin_m).max(axis=1)
    candidates = np.nonzero(result)[0]
    if len(candidates):
        neighbors = min(24, len(glints))
        distance, nearest = KDTree(glints.positions).query(
            points[candidates], k=neighbors, distance_upper_bound=reach_m + SOFT_M
        )
        distance, nearest = distance.reshape(-1, neighbors), nearest.reshape(-1, neighbors)
        found = np.isfinite(distance)
        cosine = np.einsum(
            "nkj,nj->nk", glints.normals[np.where(found, nearest, 0)], normals[candidates]
        )
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        unlike = np.maximum(beyond(distance, reach_m), beyond(angle, angle_rad, _SOFT_RAD))
        result[candidates] *= np.where(found, unlike, 1.0).min(axis=1)
    return result
