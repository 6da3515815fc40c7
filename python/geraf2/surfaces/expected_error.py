"""Expected error of each vertex of a reconstructed surface, and the kind of its evidence."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Bytes, Floats
from geraf2.echoes.glint_set import Glints
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.io.mesh import Evidence, TriangleMesh

SLOPE = 0.40
"""Expected error over the distance from the nearest glint. This is the maximum likelihood value of
simulated scans with a truth (`bench/python/expected_error.py --fit`)."""
SEEN_REACH_M, SEEN_ANGLE_RAD = 0.005, 0.35
"""A vertex was seen if a glint lies within this distance [m], and the normals of both differ by at
most this angle [rad]."""
_BESIDE_M, _OUTLINE_SIGMA_M = 0.003, 0.002
"""Largest distance of a vertex that an outline supports, and its error [m]."""
_N_NEAREST = 64
"""Glints around a vertex that count: with 36 planes they cover a patch of 6 to 8 mm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Nearness:
    """Glints near each vertex, (n_vertices,) each."""

    seen: Bools
    """Whether a glint with a similar normal lies within reach."""
    distance_m: Floats
    """Distance to the nearest glint, with the error of its position [m]; infinite without."""


def nearness(mesh: TriangleMesh, glints: Glints) -> Nearness:
    """Find the glints near each vertex."""
    n_vertices = mesh.vertices.shape[0]
    if not len(glints) or not n_vertices:
        return Nearness(
            seen=np.zeros(n_vertices, dtype=bool), distance_m=np.full(n_vertices, np.inf)
        )
    n_near = np.arange(1, min(_N_NEAREST, len(glints)) + 1)
    distance, nearest = KDTree(glints.positions).query(mesh.vertices, k=n_near)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cosine = np.einsum("vk,vjk->vj", normals, glints.normals[nearest])
    agreeing = (distance <= SEEN_REACH_M) & (cosine >= np.cos(SEEN_ANGLE_RAD))
    return Nearness(
        seen=agreeing.any(axis=1),
        distance_m=np.hypot(distance[:, 0], glints.position_sigma_m[nearest[:, 0]]),
    )


def evidence_of_vertices(
    mesh: TriangleMesh,
    near: Nearness,
    outlines: Silhouettes | None,
) -> Bytes:
    """Return the kind of evidence that each vertex rests on, (n_vertices,)."""
    kinds = np.full(len(mesh.vertices), Evidence.NOT_SEEN, dtype=np.uint8)
    if outlines is not None and len(outlines) and len(mesh.vertices):
        beside = np.abs(outlines.free_distance(mesh.vertices)) <= _BESIDE_M
        kinds[beside] = Evidence.OUTLINE
    kinds[near.seen] = Evidence.SEEN
    return kinds


def own_errors_m(near: Nearness, kinds: Bytes) -> Floats:
    """Return the expected error of each vertex without what all share, (n_vertices,) [m].

    It is `SLOPE` times the distance to the nearest glint, and at most that of an outline beside
    which the vertex lies. kinds: of the evidence, (n_vertices,).
    """
    error_m = SLOPE * near.distance_m
    beside = kinds == Evidence.OUTLINE
    return np.where(beside, np.minimum(error_m, _OUTLINE_SIGMA_M), error_m)


def seen_vertices(mesh: TriangleMesh, glints: Glints | None) -> Bools | None:
    """Vertices that an echo came from, (n_vertices,); None without evidence and glints."""
    if mesh.evidence is not None:
        return np.asarray(mesh.evidence == Evidence.SEEN)
    if glints is None or not len(glints):
        return None
    return nearness(mesh, glints).seen


def typical_error_m(mesh: TriangleMesh, share: float = 0.5) -> float:
    """Return the expected error that is not exceeded on a share of the area [m].

    share: 0.5 gives the typical expected error of all reports.
    mesh: with expected errors.
    """
    assert mesh.expected_error_m is not None
    areas = vertex_areas(mesh.vertices, mesh.faces)
    order = np.argsort(mesh.expected_error_m)
    below = np.cumsum(areas[order]) / areas.sum()
    return float(mesh.expected_error_m[order[min(int(below.searchsorted(share)), len(order) - 1)]])


def quality_numbers(mesh: TriangleMesh) -> dict[str, Any]:
    """Quantiles of the expected error [mm] and area shares of evidence; {} without them."""
    if mesh.expected_error_m is None or mesh.evidence is None or not len(mesh.faces):
        return {}
    areas = vertex_areas(mesh.vertices, mesh.faces)
    return {
        "expected_error_median_mm": round(1e3 * typical_error_m(mesh), 3),
        "expected_error_95_percent_mm": round(1e3 * typical_error_m(mesh, 0.95), 3),
        "evidence_shares": {
            kind.name.lower(): round(float(areas[mesh.evidence == kind].sum() / areas.sum()), 4)
            for kind in reversed(Evidence)
        },
    }
