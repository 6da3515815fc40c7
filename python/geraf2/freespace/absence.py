"""Surfaces that should have flashed and did not.

A smooth surface whose normal points at the scanned aperture, with nothing in between, sends a
specular echo. Where the fitted surface does so and no glint was found, it is not there
(docs/math.md, absent echoes).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints
from geraf2.echoes.glint_set import Glints
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Pose

# Limits are ramps of this half width [m], [rad]: a surface that rounding moves across one is
# refuted by as much more or less, and not at once.
SOFT_M = 0.002
_SOFT_RAD = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Apertures:
    """The rectangles that the antennas of each pose cover."""

    axes: Floats
    """Looking, horizontal and vertical direction of each pose, (n_poses, 3, 3)."""
    low: Floats
    """Smallest coordinates along those axes, (n_poses, 3) [m]."""
    high: Floats
    """Largest coordinates, (n_poses, 3) [m]."""

    @classmethod
    def of(cls, poses: Sequence[Pose]) -> "Apertures":
        """Rectangles of a capture's poses."""
        local = [pose.phase_centers @ pose.axes.T for pose in poses]
        return cls(
            axes=np.stack([pose.axes for pose in poses]),
            low=np.stack([points.min(axis=0) for points in local]),
            high=np.stack([points.max(axis=0) for points in local]),
        )


def beyond(values: Floats, limit: float, half_width: float = SOFT_M) -> Floats:
    """How far values are beyond a limit: 0 up to `half_width` before it, 1 from that behind it."""
    return np.clip(0.5 + 0.5 * (values - limit) / half_width, 0.0, 1.0)


def mirror_points(
    points: Floats, normals: Floats, apertures: Apertures, margin_m: float
) -> tuple[Ints, Floats, Floats]:
    """Where the normals of surface points meet an aperture.

    points: (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    margin_m: rim of each aperture that does not count [m]: an echo from there is cut off.

    Returns index of each point that meets one, (n_hits,), the place on the aperture, (n_hits, 3)
    [m], and its distance from the rim, (n_hits,) [m]. A point that meets several counts for each.
    """
    index, places, from_rim = [], [], []
    for axes, low, high in zip(apertures.axes, apertures.low, apertures.high, strict=True):
        local = points @ axes.T
        slope = normals @ axes.T
        facing = slope[:, 0] < -0.1  # within 84 degrees of the looking direction
        depth = 0.5 * (low[0] + high[0])
        step = (depth - local[:, 0]) / np.where(facing, slope[:, 0], -1.0)
        place = local + step[:, None] * slope
        inside = np.minimum(place[:, 1:] - low[1:], high[1:] - place[:, 1:]).min(axis=1)
        hit = np.nonzero(facing & (step > 0.0) & (inside >= margin_m))[0]
        index.append(hit)
        places.append(place[hit] @ axes)
        from_rim.append(inside[hit])
    return np.concatenate(index), np.concatenate(places), np.concatenate(from_rim)


def refuted(
    points: Floats,
    normals: Floats,
    scene: MeshScene,
    glints: Glints,
    apertures: Apertures,
    *,
    margin_m: float,
    reach_m: float,
    angle_rad: float,
) -> Floats:
    """How much points of a surface face an aperture in full view and have no glint, (n_points,).

    0 to 1, the product of ramps across the limits of margin, reach and angle.

    points: on the surface, (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    scene: the surface; it may hide its own parts.
    margin_m: rim of the apertures that does not count [m].
    reach_m: a glint this near explains a point [m].
    angle_rad: if its normal is within this angle [rad].
    """
    index, places, from_rim = mirror_points(points, normals, apertures, margin_m - SOFT_M)
    # Start 1 mm off the surface: the facets around a point must not hide it.
    start = points[index] + 1e-3 * normals[index]
    in_view = ~scene.occluded(start, places)
    result = np.zeros(len(points))
    np.maximum.at(result, index[in_view], beyond(from_rim[in_view], margin_m))
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
