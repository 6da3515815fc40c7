"""Which part of a surface a scan can see by specular echoes."""

from collections.abc import Sequence

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene.plan import Plane

_START_M = 1e-4
"""Rays begin this far above their own face [m]: a tenth of a millimetre, below any detail."""


def in_sight(
    points: Floats,
    normals: Floats,
    planes: Sequence[Plane],
    surface: TriangleMesh,
    *,
    num_threads: int | None = None,
) -> Bools:
    """Whether a smooth surface sends an echo from each point straight to an antenna.

    It does where the normal, prolonged, goes through the rectangle of a plane's antennas and meets
    no other part of the surface before. Walls of the box do not hide anything.

    points, normals: of the surface, outward, (n, 3) [m].
    planes: of the scan. surface: closed, what may stand in between.
    num_threads: all when None.

    Returns (n,).
    """
    scene = MeshScene(surface.vertices, surface.faces, num_threads=num_threads)
    seen = np.zeros(len(points), dtype=bool)
    for plane in planes:
        rows = np.flatnonzero(~seen)
        seen[rows] = plane_sees(plane, points[rows], normals[rows], scene)
    return np.asarray(seen)


def plane_sees(plane: Plane, points: Floats, normals: Floats, blocker: MeshScene) -> Bools:
    """Whether the specular echo of each point goes unobstructed to a plane's rectangle, (n,).

    points, normals: of a smooth surface, outward, (n, 3) [m].
    blocker: what may stand in between.
    """
    along = normals @ plane.axes[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (plane.middle - points) @ plane.axes[0] / along
        hits = points + reach[:, None] * normals
        within = (np.abs((hits - plane.middle) @ plane.axes[1:].T) <= plane.half_m).all(axis=1)
    seen = within & (reach > 0)
    candidates = np.flatnonzero(seen)
    if candidates.size:
        start = points[candidates] + _START_M * normals[candidates]
        seen[candidates] = ~blocker.occluded(start, hits[candidates])
    return np.asarray(seen)
