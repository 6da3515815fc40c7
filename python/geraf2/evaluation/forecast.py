"""Comparison of the expected errors of a mesh with the true ones."""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.surfaces.expected_error import typical_error_m


@dataclass(frozen=True, kw_only=True)
class EvidencePart:
    """The part of the mesh whose vertices rest on one kind of evidence."""

    evidence: str
    """Kind: seen, outline or not seen."""
    area_fraction: float
    """Share of the mesh's area."""
    expected_m: float
    """Median expected error [m]."""
    median_m: float
    """Median exact distance to the true surface [m]."""
    within_one: float
    """Share of the part not farther from the truth than its expected error."""
    within_two: float
    """Share not farther than twice that."""


@dataclass(frozen=True, kw_only=True)
class ErrorForecast:
    """Expected against true errors, over the mesh's area."""

    expected_m: float
    """Median expected error [m]."""
    within_one: float
    """Share of the area not farther from the truth than its expected error: 0.68 of a normal
    distribution."""
    within_two: float
    """Share not farther than twice that: 0.95."""
    rank_correlation: float
    """Spearman's, of expected and true errors; 0 where all of one are the same."""
    parts: tuple[EvidencePart, ...]
    """By evidence, the best first; without kinds that the mesh does not have."""


def error_forecast(
    mesh: TriangleMesh, faces: Ints, weights: Floats, distances_m: Floats
) -> ErrorForecast | None:
    """Compare expected errors with true ones at samples of the mesh, uniform by area.

    faces, weights: face of each sample and the weights of its corners, (n,) and (n, 3).
    distances_m: to the true surface, (n,) [m].

    Returns None where the mesh has no expected errors.
    """
    if mesh.expected_error_m is None:
        return None
    corners = mesh.faces[faces]
    expected = np.einsum("nk,nk->n", weights, mesh.expected_error_m[corners])
    parts = []
    if mesh.evidence is not None:
        nearest = corners[np.arange(len(corners)), weights.argmax(axis=1)]
        for kind in reversed(Evidence):
            at = mesh.evidence[nearest] == kind
            if at.any():
                parts.append(
                    EvidencePart(
                        evidence=str(kind),
                        area_fraction=float(at.mean()),
                        expected_m=float(np.median(expected[at])),
                        median_m=float(np.median(distances_m[at])),
                        within_one=_share_within(distances_m[at], expected[at]),
                        within_two=_share_within(distances_m[at], 2.0 * expected[at]),
                    )
                )
    return ErrorForecast(
        expected_m=typical_error_m(mesh),
        within_one=_share_within(distances_m, expected),
        within_two=_share_within(distances_m, 2.0 * expected),
        rank_correlation=rank_correlation(expected, distances_m),
        parts=tuple(parts),
    )


def rank_correlation(a: Floats, b: Floats) -> float:
    """Spearman's rank correlation; equal values share the mean of their ranks."""
    ranks = np.stack([_ranks(a), _ranks(b)])
    ranks -= ranks.mean(axis=1, keepdims=True)
    scale = float(np.sqrt((ranks[0] ** 2).sum() * (ranks[1] ** 2).sum()))
    return float(ranks[0] @ ranks[1]) / scale if scale > 0 else 0.0


def _ranks(values: Floats) -> Floats:
    """Ranks, as by scipy.stats.rankdata, which takes half a second to import."""
    _, rank, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - 0.5 * (counts - 1))[rank])


def _share_within(distances_m: Floats, limits_m: Floats) -> float:
    return float(np.mean(distances_m <= limits_m))
