"""Echoes that a finished surface predicts, against those that the scan has.

A surface that is right returns an echo to each plane that faces it: the normal of a point meets the
plane's aperture, and nothing is in between. A surface that was invented, or that stands in the
wrong place, predicts echoes that no plane received.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats
from geraf2.echoes.glint_set import Glints
from geraf2.freespace.specular import specular_visibility
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene.aperture import Aperture

_N_POINTS = 1500
"""Points of the surface, uniform by area: the shares have a standard error of 1 %."""
_MARGIN_M = 0.01
"""Least distance of a mirror point inside the aperture's edge [m]: nearer the edge the sub-aperture
of the echo is cut off."""
_LIFT_M = 0.002
"""Paths start this far above the surface [m], more than its error."""
_NEAR_M, _ALIKE = 0.008, 0.97
"""Largest distance of an echo from the point that predicts it [m], half of a window of 18 mm; and
least cosine between their normals, the width of a sub-aperture's lobe."""
_N_NEAREST = 8


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """What the planes could receive from a surface, and what they did."""

    visible: float
    """Share of the area whose echo some plane receives."""
    confirmed: float
    """Share of the predicted echoes, over all planes, that were received; 1 if none is. The back of
    a plastic body is also confirmed by the planes that see it from inside."""

    @classmethod
    def of(
        cls,
        mesh: TriangleMesh,
        glints: Glints,
        apertures: Sequence[Aperture],
        *,
        num_threads: int | None = None,
    ) -> "Confirmation":
        """Compare a surface with its glints.

        apertures: of the planes, in the order of the glints' `poses`.
        """
        points, normals = _points_of(mesh)
        scene = MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads)
        margins = specular_visibility(
            points, normals, apertures, scene, min_m=_MARGIN_M, lift_m=_LIFT_M
        )
        predicted = np.isfinite(margins)
        n_predicted, n_received = int(predicted.sum()), 0
        middles = np.array([aperture.middle_m for aperture in apertures])
        towards = middles[glints.poses] - glints.positions
        is_back = np.einsum("ij,ij->i", towards, glints.normals) < 0.0
        behind = _is_near(points, normals, glints.select(is_back))
        for number in np.unique(glints.poses):
            own, asked = glints.select(glints.poses == number), predicted[:, number]
            received = behind[asked] | _is_near(points[asked], normals[asked], own)
            n_received += int(received.sum())
        return cls(
            visible=float(predicted.any(axis=1).mean()),
            confirmed=n_received / n_predicted if n_predicted else 1.0,
        )


def _points_of(mesh: TriangleMesh) -> tuple[Floats, Floats]:
    """Vertices and their normals, drawn by area, (n, 3) each."""
    areas = vertex_areas(mesh.vertices, mesh.faces)
    chosen = np.random.default_rng(0).choice(len(areas), _N_POINTS, p=areas / areas.sum())
    return mesh.vertices[chosen], vertex_normals(mesh.vertices, mesh.faces)[chosen]


def _is_near(points: Floats, normals: Floats, glints: Glints) -> Bools:
    """Whether a glint lies near each point with a similar normal, (n,)."""
    if not len(glints):
        return np.zeros(len(points), dtype=bool)
    count = np.arange(1, min(_N_NEAREST, len(glints)) + 1)
    distance, nearest = KDTree(glints.positions).query(points, k=count)
    cosine = np.einsum("nkj,nj->nk", glints.normals[nearest], normals)
    return np.asarray(((distance < _NEAR_M) & (cosine > _ALIKE)).any(axis=1))
