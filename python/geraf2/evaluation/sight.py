"""Which part of a surface a scan can see by specular echoes."""

from collections.abc import Sequence

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Pose

_START_M = 1e-4
"""Rays begin this far above their own face [m]: a tenth of a millimetre, below any detail."""


def in_sight(
    points: Floats,
    normals: Floats,
    poses: Sequence[Pose],
    surface: TriangleMesh,
    *,
    num_threads: int | None = None,
) -> Bools:
    """Whether a smooth surface sends an echo from each point straight to an antenna.

    It does where the normal, prolonged, goes through the rectangle of a plane's antennas and meets
    no other part of the surface before. Walls of the box do not hide anything.

    points, normals: of the surface, outward, (n, 3) [m].
    poses: scan planes. surface: closed, what may stand in between. num_threads: all when None.

    Returns (n,).
    """
    scene = MeshScene(surface.vertices, surface.faces, num_threads=num_threads)
    seen = np.zeros(len(points), dtype=bool)
    for pose in poses:
        center, look = pose.phase_centers.mean(axis=0), pose.axes[0]
        local = (pose.phase_centers - center) @ pose.axes[1:].T
        along = normals @ look
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (center - points) @ look / along
            hits = points + reach[:, None] * normals
            place = (hits - center) @ pose.axes[1:].T
            within = ((place >= local.min(axis=0)) & (place <= local.max(axis=0))).all(axis=1)
        candidates = np.flatnonzero(within & (reach > 0) & ~seen)
        if candidates.size:
            start = points[candidates] + _START_M * normals[candidates]
            free = ~scene.occluded(start, hits[candidates])
            seen[candidates[free]] = True
    return seen
