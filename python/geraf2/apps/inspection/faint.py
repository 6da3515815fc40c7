"""Faint bodies: parts without a surface, from many uncertain echoes that agree.

A body whose echoes are each more likely clutter than not has no glints, and the fit gives it no
surface. Uncertain echoes of many planes around one spot are a body all the same.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull, KDTree
from scipy.special import expit

from geraf2._types import Floats, Ints
from geraf2.apps.inspection.bodies import Body, body_of
from geraf2.geometry.components import connected_labels
from geraf2.geometry.triangles import unit_normals, used_vertices
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene.aperture import Aperture

_LEAST_PROBABILITY = 0.1
"""Least probability of an echo that counts: noise has less."""
_OFF_M = 0.006
"""Echoes nearer to the surface than this belong to it [m]."""
_LINK_M, _INWARDS_M = 0.004, 0.012
"""Largest distance of neighbouring echoes of a body [m], once they are moved inwards so far [m]:
towards the middle of a body of 3 to 5 cm."""
_ONE_M = 0.02
"""Groups whose middles are nearer are one body [m]."""
_BODY_OFF_M = 0.0135
"""Least median distance of a body's echoes from other surface [m]: 5 mm of gap, and half of a
body of 2 cm. Those of a side that the fit cut off are nearer."""
_EVEN_PLANES, _GAIN = 5.3, 12.0
"""Number of planes at which the odds are even, and slope of the log odds over its logarithm."""
_FEWEST = 20
"""Fewest echoes of a body."""
_SIGMA_M = 0.004
"""Standard uncertainty of the hull of uncertain echoes [m]."""


def faint_bodies(
    content: TriangleMesh,
    peaks: tuple[Floats, Floats, Floats],
    corners_m: Floats,
) -> tuple[list[Body], float]:
    """Bodies that are likelier than not, as the hulls of their echoes.

    content: surface. peaks: position, outward normal and probability of each peak, (n_peaks, 3),
    (n_peaks, 3), (n_peaks,). corners_m: of the planes, (n_planes, 4, 3) [m].

    Returns the bodies, and the probability that so many are right.
    """
    positions, normals, probability = peaks
    apertures = [Aperture.of_corners(corners) for corners in corners_m]
    scene = MeshScene(content.vertices, content.faces)
    off = scene.signed_distance(positions)
    used = np.flatnonzero((probability > _LEAST_PROBABILITY) & (off > _OFF_M))
    if not len(used) or not apertures:
        return [], 1.0
    inner = positions - _INWARDS_M * normals
    labels, certain = _near(inner[used], _LINK_M), 1.0
    groups, odds = list[Ints](), list[float]()
    for label in np.flatnonzero(np.bincount(labels) > _FEWEST):
        own = used[labels == label]
        planes = _planes_of(positions[own], normals[own], apertures)
        if np.median(off[own]) <= _BODY_OFF_M:
            continue
        n_planes = _seen_by(planes, probability[own])
        exists = float(expit(_GAIN * np.log(n_planes / _EVEN_PLANES)))
        certain *= max(exists, 1.0 - exists)
        if exists > 0.5:
            groups.append(own)
            odds.append(exists)
    if not groups:
        return [], certain
    whole = _near(np.array([inner[own].mean(axis=0) for own in groups]), _ONE_M)
    members = [np.flatnonzero(whole == body) for body in np.unique(whole)]
    return [
        _hull(positions[np.concatenate([groups[k] for k in own])], max(odds[k] for k in own))
        for own in members
    ], certain


def _near(points: Floats, distance_m: float) -> Ints:
    """Group of each point, (n,): chains of neighbours within a distance."""
    i, j = KDTree(points).query_pairs(distance_m, output_type="ndarray").reshape(-1, 2).T
    return connected_labels(i, j, len(points))


def _planes_of(positions: Floats, normals: Floats, apertures: Sequence[Aperture]) -> Ints:
    """Plane that each echo came to: the one that its normal points at best, (n,)."""
    towards = np.stack([aperture.middle_m - positions for aperture in apertures])
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    return np.asarray(np.argmax((towards * normals).sum(axis=2), axis=0))


def _seen_by(planes: Ints, probability: Floats) -> float:
    """Sum over the planes of the probability that at least one echo is direct."""
    none = np.zeros(int(planes.max()) + 1)
    np.add.at(none, planes, np.log1p(-np.minimum(probability, 1.0 - 1e-6)))
    return float((1.0 - np.exp(none)).sum())


def _hull(points: Floats, probability: float) -> Body:
    """Body of the convex hull of points, seen nowhere for certain."""
    hull = ConvexHull(points)
    used, faces = used_vertices(hull.simplices.astype(np.int64))
    vertices = points[used]
    inwards = (unit_normals(vertices[faces]) * hull.equations[:, :3]).sum(axis=1) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    n = len(vertices)
    mesh = TriangleMesh(
        vertices=vertices,
        faces=faces,
        expected_error_m=np.full(n, _SIGMA_M),
        evidence=np.full(n, Evidence.NOT_SEEN, dtype=np.uint8),
    )
    return replace(body_of(mesh), probability=probability)
