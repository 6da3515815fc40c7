"""How far each vertex of a reconstructed surface may be from the truth, and what it rests on."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats
from geraf2._validation import require_each, require_positive
from geraf2.echoes.glint_set import Glints
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.surfaces.isosurface import signed_distances

_N_NEAREST = 64
"""Glints around a vertex that count: with 36 planes a patch of 6 to 8 mm."""
_FARTHEST_M = 0.1
"""No glint is farther away than this, where there are none."""


@dataclass(frozen=True, kw_only=True)
class ErrorModel:
    """One standard deviation of a vertex's distance to the true surface, from what is near it.

    The first three were fitted by `bench/python/expected_error.py` on 31 runs of five simulated
    figures (llama, dog, jug, hammer, chair; 36, 18, 12 and 6 planes), which are in no table.
    """

    overall: float = 0.292
    """Share of the misfit of all glints."""
    spread_m: float = 0.0044
    """Spread of the glints around at which the error is their misfit [m]."""
    reach_m: float = 0.0102
    """Way to the nearest glint at which the error is the misfit of those around [m]."""
    turn_m: float = 0.012
    """A glint whose normal is off by one radian counts as if it were this far away [m]."""
    spacing_m: float = 0.003
    """Voxels at which this holds; the error grows with them [m]."""
    near_m: float = 0.008
    """Standard deviation of a glint's weight over distance [m]."""
    misfit_cap_m: float = 0.005
    """Glints farther from the surface are of something else, and count as if this far [m]."""
    seen_reach_m: float = 0.005
    """A vertex was seen if a glint lies within this distance [m] ..."""
    seen_angle_rad: float = 0.35
    """... and its normal within this angle of the vertex's, 20 degrees [rad]."""
    beside_m: float = 0.003
    """It rests on an outline that is not farther away [m]."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Nearness:
    """What lies near each vertex, (n_vertices,) each."""

    reach_m: Floats
    """Distance to the nearest glint, with its turn in place of direction [m]."""
    spread_m: Floats
    """Distance of the vertex from the planes of glints around, root mean square [m]."""
    misfit_m: Floats
    """Distance of these glints from the surface, root mean square [m]."""
    misfit_overall_m: float
    """The same of all glints [m]."""
    seen: Bools
    """Whether a glint with a similar normal lies within reach."""


def nearness(
    mesh: TriangleMesh,
    glints: Glints,
    model: ErrorModel | None = None,
    *,
    num_threads: int | None = None,
) -> Nearness:
    """Measure what the model is a function of.

        reach(v)  = min_j sqrt(|v - p_j|^2 + (turn angle(n_v, n_j))^2)
        spread(v) = sqrt(sum_j w_j ((v - p_j) . n_j)^2 / sum_j w_j),
        misfit(v) = sqrt(sum_j w_j d_j^2 / sum_j w_j),   w_j = exp(-|v - p_j|^2 / (2 near^2)) c_j

    over the glints nearest to the vertex v with unit normal n_v; d_j is the distance of a glint
    from the surface, at most the cap, and c_j = max(0.01, n_v . n_j). Not differentiable.
    """
    model = model or ErrorModel()
    n_vertices = mesh.vertices.shape[0]
    if not len(glints) or not n_vertices:
        nothing = np.full(n_vertices, _FARTHEST_M)
        cap = np.full(n_vertices, model.misfit_cap_m)
        return Nearness(
            reach_m=nothing,
            spread_m=nothing,
            misfit_m=cap,
            misfit_overall_m=model.misfit_cap_m,
            seen=np.zeros(n_vertices, dtype=bool),
        )
    off = np.abs(signed_distances(mesh, glints.positions, num_threads=num_threads))
    off = np.minimum(off, model.misfit_cap_m)
    tree = KDTree(glints.positions)
    distance, nearest = tree.query(mesh.vertices, k=np.arange(1, min(_N_NEAREST, len(glints)) + 1))
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cosine = np.clip(np.einsum("vk,vjk->vj", normals, glints.normals[nearest]), -1.0, 1.0)
    angle = np.arccos(cosine)
    # Relative to the nearest, so that the weights far from all glints do not vanish.
    closer = distance**2 - distance[:, :1] ** 2
    weights = np.exp(-0.5 * closer / model.near_m**2) * np.maximum(cosine, 0.01)
    weights /= weights.sum(axis=1, keepdims=True)
    offset = mesh.vertices[:, None] - glints.positions[nearest]
    off_plane = np.einsum("vjk,vjk->vj", offset, glints.normals[nearest])
    return Nearness(
        reach_m=np.sqrt((distance**2 + (model.turn_m * angle) ** 2).min(axis=1)),
        spread_m=np.sqrt((weights * off_plane**2).sum(axis=1)),
        misfit_m=np.sqrt((weights * off[nearest] ** 2).sum(axis=1)),
        misfit_overall_m=float(np.sqrt(np.mean(off**2))),
        seen=((distance <= model.seen_reach_m) & (angle <= model.seen_angle_rad)).any(axis=1),
    )


def expected_error_m(near: Nearness, spacing_m: float, model: ErrorModel | None = None) -> Floats:
    """Compute the standard deviation of the distance to the true surface, (n_vertices,) [m].

        sigma = h / spacing_m sqrt(
            (overall M)^2 + misfit^2 ((spread / spread_m)^2 + (reach / reach_m)^2))

    M is the misfit of all glints, h the spacing of the field's voxels [m]: where glints are dense
    and agree, the error is a share of M; elsewhere it grows with the way to the nearest one and
    with how far their planes are apart, the more, the less the surface keeps to the glints around.
    """
    model = model or ErrorModel()
    way = (near.spread_m / model.spread_m) ** 2 + (near.reach_m / model.reach_m) ** 2
    overall = (model.overall * near.misfit_overall_m) ** 2
    return np.asarray(spacing_m / model.spacing_m * np.sqrt(overall + near.misfit_m**2 * way))


def with_expected_error(
    mesh: TriangleMesh,
    glints: Glints,
    spacing_m: float,
    *,
    outlines: Silhouettes | None = None,
    model: ErrorModel | None = None,
    num_threads: int | None = None,
) -> TriangleMesh:
    """Give each vertex of the same triangles its expected error and what it rests on.

    glints: that the surface was drawn through.
    spacing_m: of the voxels of its field [m].
    outlines: shadows that cut it.
    """
    model = model or ErrorModel()
    near = nearness(mesh, glints, model, num_threads=num_threads)
    evidence = np.full(len(mesh.vertices), Evidence.GUESSED, dtype=np.uint8)
    if outlines is not None and len(outlines):
        beside = np.abs(outlines.free_distance(mesh.vertices)) <= model.beside_m
        evidence[beside] = Evidence.OUTLINE
    evidence[near.seen] = Evidence.SEEN
    return replace(
        mesh, expected_error_m=expected_error_m(near, spacing_m, model), evidence=evidence
    )


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
