"""How far each vertex of a reconstructed surface may be from the truth, and what it rests on."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats
from geraf2._validation import require_each, require_positive
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.glints.glint_set import Glints
from geraf2.glints.silhouettes import Silhouettes
from geraf2.io.mesh import Evidence, TriangleMesh

_N_NEAREST = 48
"""Glints of which the nearest, in place and direction, is looked for: a patch of 8 mm."""


@dataclass(frozen=True, kw_only=True)
class ErrorModel:
    """One standard deviation of a vertex's distance to the true surface, from what is near it."""

    floor_m: float = 0.0003
    """Where glints are dense and agree [m]."""
    spread: float = 1.0
    """Share of the disagreement of glints near the vertex."""
    reach: float = 0.2
    """Error per metre to the nearest glint, in place and direction."""
    turn_m: float = 0.012
    """A glint whose normal is off by one radian counts as if it were this far away [m]."""
    near_m: float = 0.006
    """Standard deviation of a glint's weight over distance, for their disagreement [m]."""
    seen_reach_m: float = 0.008
    """A vertex was seen if a glint lies within this distance [m] ..."""
    seen_angle_rad: float = float(np.deg2rad(45.0))
    """... and its normal within this angle of the vertex's [rad]."""
    beside_m: float = 0.003
    """It rests on an outline or a continued surface that is not farther away [m]."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Nearness:
    """What lies near each vertex, (n_vertices,) each."""

    reach_m: Floats
    """Distance to the nearest glint, with its turn in place of direction [m]."""
    spread_m: Floats
    """Distance of the planes of the glints around, root mean square [m]."""
    seen: Bools
    """Whether a glint with a similar normal lies within reach."""


def nearness(mesh: TriangleMesh, glints: Glints, model: ErrorModel | None = None) -> Nearness:
    """Measure what the model is a function of.

        reach(v)  = min_j sqrt(|v - p_j|^2 + (turn angle(n_v, n_j))^2)
        spread(v) = sqrt(sum_j w_j ((v - p_j) . n_j)^2 / sum_j w_j),
        w_j       = exp(-|v - p_j|^2 / (2 near^2)) max(0, n_v . n_j)

    over the glints nearest to the vertex v with unit normal n_v. Not differentiable.
    """
    model = model or ErrorModel()
    n_vertices = mesh.vertices.shape[0]
    if not len(glints) or not n_vertices:
        nothing = np.full(n_vertices, np.inf)
        seen = np.zeros(n_vertices, dtype=bool)
        return Nearness(reach_m=nothing, spread_m=np.zeros(n_vertices), seen=seen)
    tree = KDTree(glints.positions)
    distance, nearest = tree.query(mesh.vertices, k=np.arange(1, min(_N_NEAREST, len(glints)) + 1))
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cosine = np.clip(np.einsum("vk,vjk->vj", normals, glints.normals[nearest]), -1.0, 1.0)
    angle = np.arccos(cosine)
    weights = np.exp(-0.5 * (distance / model.near_m) ** 2) * np.maximum(cosine, 0.0)
    offset = mesh.vertices[:, None] - glints.positions[nearest]
    off_plane = np.einsum("vjk,vjk->vj", offset, glints.normals[nearest])
    total = np.maximum(weights.sum(axis=1), 1e-12)
    return Nearness(
        reach_m=np.sqrt((distance**2 + (model.turn_m * angle) ** 2).min(axis=1)),
        spread_m=np.sqrt((weights * off_plane**2).sum(axis=1) / total),
        seen=((distance <= model.seen_reach_m) & (angle <= model.seen_angle_rad)).any(axis=1),
    )


def expected_error_m(near: Nearness, model: ErrorModel | None = None) -> Floats:
    """sqrt(floor^2 + (spread factor x spread)^2 + (reach factor x reach)^2), (n_vertices,) [m]."""
    model = model or ErrorModel()
    reach = np.minimum(near.reach_m, 0.1)
    return np.sqrt(
        model.floor_m**2 + (model.spread * near.spread_m) ** 2 + (model.reach * reach) ** 2
    )


def with_expected_error(
    mesh: TriangleMesh,
    glints: Glints,
    *,
    continued: Floats | None = None,
    outlines: Silhouettes | None = None,
    model: ErrorModel | None = None,
) -> TriangleMesh:
    """Give each vertex of the same triangles its expected error and what it rests on.

    glints: that the surface was drawn through.
    continued: places where the surface was taken to go on unseen, (n, 3) [m].
    outlines: shadows that cut it.
    """
    model = model or ErrorModel()
    near = nearness(mesh, glints, model)
    evidence = np.full(len(mesh.vertices), Evidence.GUESSED, dtype=np.uint8)
    if continued is not None and len(continued) and len(mesh.vertices):
        beside = KDTree(continued).query(mesh.vertices)[0] <= model.beside_m
        evidence[beside] = Evidence.CONTINUED
    if outlines is not None and len(outlines):
        beside = np.abs(outlines.free_distance(mesh.vertices)) <= model.beside_m
        evidence[beside] = Evidence.OUTLINE
    evidence[near.seen] = Evidence.SEEN
    return replace(mesh, expected_error_m=expected_error_m(near, model), evidence=evidence)


def seen_vertices(mesh: TriangleMesh, glints: Glints | None) -> Bools | None:
    """Which vertices an echo came from, (n_vertices,); None where nothing tells."""
    if mesh.evidence is not None:
        return np.asarray(mesh.evidence == Evidence.SEEN)
    if glints is None or not len(glints):
        return None
    return nearness(mesh, glints).seen


def quality_numbers(mesh: TriangleMesh) -> dict[str, Any]:
    """Sum up expected errors over the area [mm], and shares of the area by evidence; {} without."""
    if mesh.expected_error_m is None or mesh.evidence is None or not len(mesh.faces):
        return {}
    areas = vertex_areas(mesh.vertices, mesh.faces)
    order = np.argsort(mesh.expected_error_m)
    below = np.cumsum(areas[order]) / areas.sum()
    at = np.minimum(np.searchsorted(below, [0.5, 0.95]), len(order) - 1)
    half, most = 1e3 * mesh.expected_error_m[order[at]]
    return {
        "expected_error_median_mm": round(float(half), 3),
        "expected_error_95_percent_mm": round(float(most), 3),
        "evidence_shares": {
            kind.name.lower(): round(float(areas[mesh.evidence == kind].sum() / areas.sum()), 4)
            for kind in reversed(Evidence)
        },
    }
