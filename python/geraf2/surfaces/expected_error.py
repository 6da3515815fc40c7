"""Expected error of each vertex of a reconstructed surface, and the kind of its evidence."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.special import ndtr

from geraf2._types import Bools, Bytes, Floats, Ints
from geraf2._validation import require_each, require_positive
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.io.mesh import Evidence, TriangleMesh

# Smallest bound in standard deviations: below it the variance's two terms cancel.
_MIN_BOUND = 1e-3
N_NEAREST = 64
"""Glints around a vertex that count: with 36 planes they cover a patch of 6 to 8 mm."""


@dataclass(frozen=True, kw_only=True)
class SupportModel:
    """Conformal factor of the posterior's spread at a vertex, from the glints around it.

    The posterior treats each glint as a direct return. A glint that its neighbours confirm is a
    direct return more often, so the factor falls with the number of agreeing glints. Exponent,
    least and full support are maximum likelihood values of the simulated population of objects
    (`bench/python/expected_error.py --fit`).
    """

    reach_m: float = 0.018
    """Standard deviation of the Gaussian that weights glints by distance [m]."""
    least: float = 0.01
    """Support of a vertex without a glint nearby, in strong glints."""
    full: float = 10.6
    """Support at which the factor is 1."""
    exponent: float = 0.4
    """Exponent of the factor's decrease."""
    seen_reach_m: float = 0.005
    """A vertex was seen if a glint lies within this distance [m]..."""
    seen_angle_rad: float = 0.35
    """...and the normals of both differ by at most this angle [rad]."""
    beside_m: float = 0.003
    """Largest distance of a vertex that an outline supports [m]."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Nearness:
    """Glints near each vertex, (n_vertices,) each."""

    support: Floats
    """Sum of the agreeing glints nearby, each weighted by strength and distance."""
    seen: Bools
    """Whether a glint with a similar normal lies within reach."""
    nearest: Ints
    """Index of the nearest glint; 0 without glints."""
    distance_m: Floats
    """Distance to it [m]; infinite without glints."""


def nearness(
    mesh: TriangleMesh,
    glints: Glints,
    model: SupportModel | None = None,
    weights: Floats | None = None,
) -> Nearness:
    """Measure the glints around each vertex.

        support(v) = sum_j w_j a_j exp(-|v - p_j|^2 / (2 reach^2)) max(0, n_v . n_j)

    over the 64 nearest glints. a_j is the strength relative to a strong glint, at most 1.

    weights: w_j of the glints in the fit, (n_glints,); ones when None.
    """
    model = model or SupportModel()
    n_vertices = mesh.vertices.shape[0]
    if not len(glints) or not n_vertices:
        none = np.zeros(n_vertices)
        return Nearness(
            support=none,
            seen=none.astype(bool),
            nearest=none.astype(np.int64),
            distance_m=none + np.inf,
        )
    n_near = np.arange(1, min(N_NEAREST, len(glints)) + 1)
    distance, nearest = KDTree(glints.positions).query(mesh.vertices, k=n_near)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cosine = np.clip(np.einsum("vk,vjk->vj", normals, glints.normals[nearest]), -1.0, 1.0)
    relative = relative_strengths(glints.strengths) * (1.0 if weights is None else weights)
    weights = relative[nearest] * np.exp(-0.5 * (distance / model.reach_m) ** 2)
    agreeing = (distance <= model.seen_reach_m) & (cosine >= np.cos(model.seen_angle_rad))
    return Nearness(
        support=(weights * np.maximum(cosine, 0.0)).sum(axis=1),
        seen=agreeing.any(axis=1),
        nearest=nearest[:, 0],
        distance_m=distance[:, 0],
    )


def conformal_factor(support: Floats, model: SupportModel | None = None) -> Floats:
    """Factor of the posterior's spread, ((support + least) / full)^-exponent, (n_vertices,)."""
    model = model or SupportModel()
    return np.asarray(((support + model.least) / model.full) ** -model.exponent)


def bounded_factor(spread_m: Floats, bound_m: Floats, probability: Floats) -> Floats:
    r"""Factor of a spread where the surface passes through a glint nearby, (n_vertices,).

    .. math:: \sqrt{p \, v(b / s) + 1 - p}, \qquad
        v(a) = 1 - \frac{2 a \varphi(a)}{2 \Phi(a) - 1}

    No vertex is farther from the true surface than from a direct return. v is the variance of a
    standard normal variable that is at most a (Johnson, Kotz and Balakrishnan 1994, section 13.10).

    spread_m: standard deviation s without the bound [m]. bound_m: distance b of the glint, with
    its own error [m]. probability: p that the glint is a direct return.
    """
    bound = np.maximum(bound_m / spread_m, _MIN_BOUND)
    density = np.exp(-0.5 * bound**2) / np.sqrt(2.0 * np.pi)
    variance = 1.0 - bound * density / (ndtr(bound) - 0.5)
    return np.asarray(np.sqrt(probability * variance + 1.0 - probability))


@dataclass(frozen=True, kw_only=True, eq=False)
class VertexSpread:
    """Spread of the posterior at each vertex, and what changes it, (n_vertices,) each."""

    own_m: Floats
    """Standard deviation of the draws, without the offset that all glints share [m]."""
    common_m: float
    """Standard deviation of that offset [m]."""
    support: Floats
    """As of :class:`Nearness`."""
    bound_m: Floats
    """Distance to the nearest glint, with the error of its position; both share the offset [m]."""
    probability: Floats
    """Probability that it is a direct return."""

    def factors(self, model: SupportModel | None = None) -> tuple[Floats, Floats]:
        """Factors of the draws and of the common offset, (n_vertices,) each."""
        factor = conformal_factor(self.support, model)
        bounded = bounded_factor(factor * self.own_m, self.bound_m, self.probability)
        return factor * bounded, factor

    def expected_error_m(self, model: SupportModel | None = None) -> Floats:
        """Return the expected error, (n_vertices,) [m]."""
        own, common = self.factors(model)
        return np.asarray(np.hypot(own * self.own_m, common * self.common_m))


def evidence_of_vertices(
    mesh: TriangleMesh,
    near: Nearness,
    outlines: Silhouettes | None,
    model: SupportModel | None = None,
) -> Bytes:
    """Return the kind of evidence that each vertex rests on, (n_vertices,)."""
    model = model or SupportModel()
    kinds = np.full(len(mesh.vertices), Evidence.NOT_SEEN, dtype=np.uint8)
    if outlines is not None and len(outlines) and len(mesh.vertices):
        beside = np.abs(outlines.free_distance(mesh.vertices)) <= model.beside_m
        kinds[beside] = Evidence.OUTLINE
    kinds[near.seen] = Evidence.SEEN
    return kinds


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
