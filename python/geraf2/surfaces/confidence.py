"""How well each vertex of a reconstructed surface was seen."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats
from geraf2._validation import require_each, require_positive
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.glints.glint_set import Glints
from geraf2.io.mesh import TriangleMesh


@dataclass(frozen=True, kw_only=True)
class ConfidenceConfig:
    """Scales at which a glint is evidence for a piece of surface."""

    reach_m: float = 0.004
    """Standard deviation of a glint's weight over distance [m]: half of a link of the filter."""
    strength_quantile: float = 0.98
    """Amplitude that counts as full strength, as in the surface fit."""
    strength_exponent: float = 0.5
    """Weight = (relative amplitude)^exponent: weak echoes have less certain normals."""
    seen_reach_m: float = 0.008
    """A vertex was seen if a glint lies within this distance [m] ..."""
    seen_angle_rad: float = float(np.deg2rad(45.0))
    """... and its normal within this angle of the vertex's [rad]."""

    def __post_init__(self) -> None:
        names = ("reach_m", "strength_exponent", "seen_reach_m", "seen_angle_rad")
        require_each(require_positive, self, *names)
        if not 0.0 < self.strength_quantile <= 1.0:
            msg = f"strength_quantile must lie in (0, 1], got {self.strength_quantile}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceEvidence:
    """Per-vertex evidence for a surface."""

    confidence: Floats
    """1 - exp(-evidence), 0 to 1, (n_vertices,)."""
    seen: Bools
    """Whether a glint with a similar normal lies within reach, (n_vertices,)."""
    nearest_normal_angle_rad: Floats
    """Smallest angle to the normal of a glint within reach, pi if none, (n_vertices,) [rad]."""
    unseen_area_fraction: float
    """Share of the area around vertices that were not seen: there the surface is only filled."""


def surface_evidence(
    mesh: TriangleMesh, glints: Glints, config: ConfidenceConfig | None = None
) -> SurfaceEvidence:
    """Evidence of the glints for each vertex v with unit normal n_v.

        e(v) = sum_j (A_j / A_q)^b exp(-|v - p_j|^2 / (2 r^2)) max(0, n_v . n_j),
        confidence(v) = 1 - exp(-e(v)),

    A_j capped at A_q, the q-quantile of all strengths. So one glint of full strength, exactly at
    the vertex and with its normal, gives 0.63, three give 0.95, and none gives 0: confidence
    says how much was measured there, not how large the error is. Not differentiable.
    """
    config = ConfidenceConfig() if config is None else config
    n_vertices = mesh.vertices.shape[0]
    evidence = np.zeros(n_vertices)
    angle = np.full(n_vertices, np.pi)
    if len(glints) and n_vertices:
        full = max(float(np.quantile(glints.strengths, config.strength_quantile)), 1e-300)
        weights = np.minimum(glints.strengths / full, 1.0) ** config.strength_exponent
        # At three standard deviations a weight of 0.011 is left out.
        reach = max(3.0 * config.reach_m, config.seen_reach_m)
        # The sums below follow the order of the pairs, which follows the size of the leaves.
        trees = [KDTree(at, leafsize=16) for at in (mesh.vertices, glints.positions)]
        pairs = trees[0].sparse_distance_matrix(trees[1], reach, output_type="ndarray")
        vertex, glint, distance = pairs["i"], pairs["j"], pairs["v"]
        normals = vertex_normals(mesh.vertices, mesh.faces)
        cosine = np.clip(np.einsum("ij,ij->i", normals[vertex], glints.normals[glint]), -1, 1)
        kernel = np.exp(-0.5 * (distance / config.reach_m) ** 2)
        share = weights[glint] * kernel * np.maximum(cosine, 0.0)
        evidence = np.bincount(vertex, share, minlength=n_vertices).astype(np.float64)
        near = distance <= config.seen_reach_m
        np.minimum.at(angle, vertex[near], np.arccos(cosine[near]))
    seen = angle <= config.seen_angle_rad
    areas = vertex_areas(mesh.vertices, mesh.faces)
    total = float(areas.sum())
    return SurfaceEvidence(
        confidence=-np.expm1(-evidence),
        seen=seen,
        nearest_normal_angle_rad=angle,
        unseen_area_fraction=float(areas[~seen].sum()) / total if total > 0 else 1.0,
    )


def with_confidence(
    mesh: TriangleMesh, glints: Glints, config: ConfidenceConfig | None = None
) -> TriangleMesh:
    """Give each vertex of the same triangles its confidence."""
    evidence = surface_evidence(mesh, glints, config)
    return TriangleMesh(vertices=mesh.vertices, faces=mesh.faces, confidence=evidence.confidence)
