"""Antennas that receive the specular return of a surface.

An antenna of a plane receives a specular return if the line along the surface's normal meets the
plane's aperture and nothing blocks it.
"""

from collections.abc import Sequence

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.geometry.boxes import SIGNS
from geraf2.ops.visibility import MeshScene
from geraf2.scene.aperture import Aperture

LIFT_M = 1e-4
"""Rays start this far above their own face [m], less than any detail of an exact surface."""
_INNER_SHARE = 0.3  # share of a box's sides within which content is assumed
# Points along and across an aperture that represent all its antenna positions.
_N_GRID = 9


def specular_visibility(
    points: Floats,
    normals: Floats,
    apertures: Sequence[Aperture],
    blocker: MeshScene | None = None,
    *,
    min_m: Floats | float = 0.0,
    lift_m: float = LIFT_M,
) -> Floats:
    """Margin by which each aperture receives the specular return of each point, [m].

    The margin is the distance of the mirror point inside the nearest edge of the aperture. It is
    -inf where no return is received: the normal points away, the margin is below `min_m`, or the
    path is blocked.

    points: on a smooth surface, (n_points, 3) [m].
    normals: outward unit normals, (n_points, 3).
    apertures: of the planes of antennas.
    blocker: what may block the path; nothing when None.
    min_m: least margin [m], or one for each point and aperture, (n_points, n_apertures). Positive
        where a sub-aperture must fit around the mirror point. Negative where a lobe is wider than
        the aperture or the limit is a ramp.
    lift_m: rays start this far above the surface [m], more than its facets deviate from it.

    Returns margins, (n_points, n_apertures) [m].
    """
    visible = np.full((len(points), len(apertures)), -np.inf)
    least = np.broadcast_to(min_m, visible.shape)
    for number, aperture in enumerate(apertures):
        mirror = aperture.mirror(points, normals)
        margins = mirror.margins_m
        hit = np.flatnonzero(margins >= least[:, number])
        if blocker is not None and hit.size:
            start = points[hit] + lift_m * normals[hit]
            hit = hit[~blocker.occluded(start, mirror.positions_m[hit])]
        visible[hit, number] = margins[hit]
    return visible


def received_normals(apertures: Sequence[Aperture], normals: Floats, point: Floats) -> Bools:
    """Whether each aperture receives a surface at `point` (3,) [m] with each normal (n, 3).

    Returns (n_normals, n_apertures).
    """
    points = np.broadcast_to(point, normals.shape)
    return specular_visibility(points, normals, apertures) >= 0.0


def seen_share(apertures: Sequence[Aperture], center_m: Floats, box_m: Floats) -> float:
    """Share of all normals whose specular return some aperture receives.

    Mean over the centre of a box and the corners of its inner third.

    center_m: centre of the box, (3,) [m]. box_m: its sides, (3,) [m].
    """
    normals = sphere_points(4000)
    points = inner_points(center_m, box_m)
    return float(np.mean([received_normals(apertures, normals, p).any(axis=1) for p in points]))


def inner_points(center_m: Floats, box_m: Floats) -> Floats:
    """Centre of a box and corners of its inner third, (9, 3) [m]; arguments of `seen_share`."""
    reach = 0.5 * _INNER_SHARE * np.asarray(box_m)
    return np.asarray(center_m + np.concatenate([np.zeros((1, 3)), SIGNS * reach]))


def angles_off(normals: Floats, apertures: Sequence[Aperture], center_m: Floats) -> Floats:
    """Angle from each normal to the nearest one that some aperture receives, (n,) [rad].

    normals: (n, 3). center_m: position of the surface, (3,) [m].
    """
    grid = np.linspace(-1.0, 1.0, _N_GRID)
    shares = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    nearest = np.full(len(normals), -1.0)
    for aperture in apertures:
        directions = aperture.points_at(shares) - center_m
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        nearest = np.maximum(nearest, (normals @ directions.T).max(axis=1))
    return np.asarray(np.arccos(np.clip(nearest, -1.0, 1.0)))


def sphere_points(n: int) -> Floats:
    """Evenly spread unit vectors, (n, 3)."""
    height = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(n)
    ring = np.sqrt(1.0 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
