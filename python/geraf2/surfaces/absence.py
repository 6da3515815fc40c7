"""Surfaces that should have flashed and did not.

A smooth surface whose normal points at the scanned aperture, with nothing in between, sends a
specular echo. Where the fitted surface does so and no glint was found, it is not there
(docs/math.md, absent echoes).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.glints.glint_set import Glints
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Pose


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
    def of(cls, poses: tuple[Pose, ...]) -> "Apertures":
        """Rectangles of a capture's poses."""
        local = [pose.phase_centers @ pose.axes.T for pose in poses]
        return cls(
            axes=np.stack([pose.axes for pose in poses]),
            low=np.stack([points.min(axis=0) for points in local]),
            high=np.stack([points.max(axis=0) for points in local]),
        )


def mirror_points(
    points: Floats, normals: Floats, apertures: Apertures, margin_m: float
) -> tuple[Ints, Floats]:
    """Where the normals of surface points meet an aperture.

    points: (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    margin_m: rim of each aperture that does not count [m]: an echo from there is cut off.

    Returns index of each point that meets one, (n_hits,), and the place on the aperture, (n_hits,
    3) [m]. A point that meets several counts once for each.
    """
    index, places = [], []
    for axes, low, high in zip(apertures.axes, apertures.low, apertures.high, strict=True):
        local = points @ axes.T
        slope = normals @ axes.T
        facing = slope[:, 0] < -0.1  # within 84 degrees of the looking direction
        depth = 0.5 * (low[0] + high[0])
        step = (depth - local[:, 0]) / np.where(facing, slope[:, 0], -1.0)
        place = local + step[:, None] * slope
        within = (place[:, 1:] >= low[1:] + margin_m) & (place[:, 1:] <= high[1:] - margin_m)
        hit = np.nonzero(facing & (step > 0.0) & within.all(axis=1))[0]
        index.append(hit)
        places.append(place[hit] @ axes)
    return np.concatenate(index), np.concatenate(places)


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
) -> Bools:
    """Points of a surface that face an aperture in full view and have no glint, (n_points,).

    points: on the surface, (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    scene: the surface; it may hide its own parts.
    margin_m: rim of the apertures that does not count [m].
    reach_m: a glint this near explains a point [m].
    angle_rad: if its normal is within this angle [rad].
    """
    index, places = mirror_points(points, normals, apertures, margin_m)
    # Start 1 mm off the surface: the facets around a point must not hide it.
    start = points[index] + 1e-3 * normals[index]
    in_view = ~scene.occluded(start, places)
    expected = np.zeros(len(points), dtype=bool)
    expected[index[in_view]] = True
    result = np.zeros(len(points), dtype=bool)
    candidates = np.nonzero(expected)[0]
    if len(candidates):
        neighbors = min(24, len(glints))
        distance, nearest = KDTree(glints.positions).query(
            points[candidates], k=neighbors, distance_upper_bound=reach_m
        )
        distance, nearest = distance.reshape(-1, neighbors), nearest.reshape(-1, neighbors)
        found = np.isfinite(distance)
        cosine = np.einsum(
            "nkj,nj->nk", glints.normals[np.where(found, nearest, 0)], normals[candidates]
        )
        explained = (found & (cosine > np.cos(angle_rad))).any(axis=1)
        result[candidates[~explained]] = True
    return result
