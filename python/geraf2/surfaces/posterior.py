"""Samples of the fitted signed distance: perturb data and prior, and solve again.

The fit minimises a quadratic energy. Errors of its data become errors of the field by one more
solve with another right side. Sources: perturb-and-MAP, Papandreou and Yuille 2010; Orieux et al.
2012. Derivation: docs/math/expected-error.md.
"""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from geraf2._memory import require_memory
from geraf2._types import Floats, Ints
from geraf2._validation import require_each, require_positive
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.noise import ECHO_NOISE
from geraf2.fields import SdfGrid
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior
from geraf2.surfaces.expected_error import (
    N_NEAREST,
    Nearness,
    SupportModel,
    VertexSpread,
    evidence_of_vertices,
    nearness,
)
from geraf2.surfaces.fit import UNKNOWN_OFFSET_M, Evidence, FitConfig, fitted_points
from geraf2.surfaces.linear_sdf import (
    CM,
    LinearSdf,
    OrientedPoints,
    SdfTerms,
    resample,
    trilinear_rows,
)
from geraf2.surfaces.samples import SurfaceSamples

N_SAMPLES = 24
"""Number of samples of an expected error: they give a standard deviation to 14 %."""
_CELLS = 36
"""Cells along a side of the samples' grid, of 5 to 8 mm each."""
_TOLERANCE = 0.03
"""Relative residual of a sample's solve: a tenth of the standard deviation's own error."""
_MIN_SLOPE = 0.5
"""Lower bound of the field's gradient, which is too small between two close surfaces."""
_BYTES_PER_DISPLACEMENT = 44.0
"""Memory of one vertex in one sample: temporary float64 arrays and the result [bytes]."""


@dataclass(frozen=True, kw_only=True)
class NoiseModel:
    """Errors of the fit's data and prior beside those of single echoes."""

    common_sigma_m: float = UNKNOWN_OFFSET_M
    """Range offset that all glints share, of the radar's delay and the turntable's radius [m]."""
    outline_sigma_m: float = 0.002
    """Position of an outline's tangent point [m]."""
    outline_normal_rad: float = 0.17
    """Each component of its normal [rad]."""
    bend_density_m: float = 0.0035
    """Spectral density of the second derivatives of the objects' signed distance [m]."""
    misfit_cap_m: float = 0.005
    """Largest residual that counts [m]; a glint farther from the surface belongs to another."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)


@dataclass(frozen=True, kw_only=True, eq=False)
class PointNoise:
    """Errors of oriented points: independent ones and shared offsets."""

    position_sigma_m: Floats
    """Independent error along the normal, (n,) [m]."""
    normal_sigma_rad: Floats
    """Independent error of each component of the normal, (n,) [rad]."""
    shared_sigma_m: Floats
    """Standard deviation of each shared offset, (n_groups,) [m]."""
    groups: Ints
    """Indices of the offsets of each point, (n, n_shared); -1: none."""

    @property
    def total_sigma_m(self) -> Floats:
        """Error along the normal with the shared offsets, (n,) [m]."""
        shared = np.append(self.shared_sigma_m, 0.0)[self.groups]
        return np.asarray(np.sqrt(self.position_sigma_m**2 + (shared**2).sum(axis=1)))

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Draw errors of all positions along their normals, (n,) [m], and of normals, (n, 3)."""
        n = len(self.position_sigma_m)
        position = self.position_sigma_m * rng.standard_normal(n)
        offsets = np.append(self.shared_sigma_m * rng.standard_normal(len(self.shared_sigma_m)), 0)
        position += offsets[self.groups].sum(axis=1)
        return position, self.normal_sigma_rad[:, None] * rng.standard_normal((n, 3))


def point_noise(
    glints: Glints, n_outline: int, sdf: SdfGrid, prior: LosPrior, model: NoiseModel | None = None
) -> PointNoise:
    """Errors of the points of a fit: glints first, then tangent points of outlines.

    sigma_i^2 = position_sigma_i^2 + m_i^2. m_i is the root mean square of f at nearby
    glints, weighted as in docs/math/expected-error.md.

    glints: all that the surface was fitted to, rim glints too.
    n_outline: number of tangent points of outlines.
    sdf: fitted field.
    prior: box; glints whose normals meet the same face share an offset.
    """
    model = model or NoiseModel()
    misfit = local_misfit(glints, sdf, model)
    position = np.hypot(glints.position_sigma_m, misfit)
    planes = np.unique(glints.poses, return_inverse=True)[1]
    n_planes = int(planes.max()) + 1 if len(planes) else 0
    groups = np.stack([planes, n_planes + faces_met(glints, prior)], axis=1)
    none = np.full((n_outline, 2), -1, dtype=np.int64)
    return PointNoise(
        position_sigma_m=np.append(position, np.full(n_outline, model.outline_sigma_m)),
        normal_sigma_rad=np.append(
            glints.normal_sigma_rad, np.full(n_outline, model.outline_normal_rad)
        ),
        shared_sigma_m=np.repeat([ECHO_NOISE.plane_m, ECHO_NOISE.face_m], [n_planes, 6]),
        groups=np.concatenate([groups, none]),
    )


def local_misfit(glints: Glints, sdf: SdfGrid, model: NoiseModel) -> Floats:
    """Weighted RMS of the field at glints near each one with a like normal, (n,) [m]."""
    n_near = min(N_NEAREST, len(glints))
    if n_near == 0:
        return np.zeros(0)
    residual = np.clip(np.abs(sdf.sample(glints.positions)), 0.0, model.misfit_cap_m)
    distance, near = KDTree(glints.positions).query(glints.positions, k=np.arange(1, n_near + 1))
    cosine = np.einsum("nk,njk->nj", glints.normals, glints.normals[near])
    weights = np.exp(-0.5 * (distance / SupportModel().reach_m) ** 2) * np.maximum(cosine, 0.0)
    return np.asarray(np.sqrt((weights * residual[near] ** 2).sum(axis=1) / weights.sum(axis=1)))


def faces_met(glints: Glints, prior: LosPrior) -> Ints:
    """Face of the box that each normal points to, (n,): -x, x, -y, y, -z, z as 0 to 5."""
    directions = glints.normals
    if len(glints):
        box = MeshScene(prior.vertices, prior.faces)
        triangle = box.closest_hit(glints.positions, directions)[1]
        corners = np.asarray(prior.vertices)[np.asarray(prior.faces)[np.maximum(triangle, 0)]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        directions = np.where((triangle >= 0)[:, None], normals, directions)
    axis = np.abs(directions).argmax(axis=1)
    positive = np.take_along_axis(directions, axis[:, None], axis=1)[:, 0] > 0.0
    return np.asarray(2 * axis + positive, dtype=np.int64)


class FieldPosterior:
    """Posterior errors of a fitted field on a coarse grid, one solve each."""

    def __init__(
        self,
        sdf: SdfGrid,
        points: OrientedPoints,
        terms: SdfTerms,
        noise: PointNoise,
        *,
        bend_density_m: float,
        tolerance: float = _TOLERANCE,
        num_threads: int | None = None,
    ) -> None:
        """Prepare the solves on the grid of `sdf`, whose values are not used.

        points, terms: of the fit. noise: errors of the points.
        bend_density_m: spectral density of the curvature, see `NoiseModel`.
        """
        self.grid, self._noise = sdf.grid, noise
        system = LinearSdf(sdf, points, terms, num_threads=num_threads)
        self._respond = system.responder(tolerance=tolerance)
        shape, spacing = sdf.grid.shape, sdf.grid.spacing_m * CM
        index = (points.positions - np.asarray(sdf.grid.origin_m)) / sdf.grid.spacing_m
        value, slopes = trilinear_rows(index, shape, spacing)
        self._value = value.T.tocsr().multiply(terms.position * points.position_weights).tocsr()
        weights = terms.normal * points.normal_weights
        self._slopes = [rows.T.tocsr().multiply(weights).tocsr() for rows in slopes]
        volume = float(np.prod(np.asarray(shape) - 1)) * spacing**3
        self._bend = float(np.sqrt(terms.bending * bend_density_m * CM / volume))
        self._bending = terms.bending

    def right_side(self, rng: np.random.Generator) -> Floats:
        """Draw the change of the fit's right side by errors of data and prior, (n_voxels,)."""
        position, normal = self._noise.draw(rng)
        right = self._value @ (position * CM)
        for rows, error in zip(self._slopes, normal.T, strict=True):
            right += rows @ error
        spacing = self.grid.spacing_m * CM
        root = bending_force(self.grid.shape, spacing, self._bending, rng)
        return np.asarray(right + self._bend * root.ravel())

    def draw(self, rng: np.random.Generator) -> Floats:
        """Draw one error of the field, (n_voxels,) [m]."""
        return np.asarray(self._respond(self.right_side(rng)) / CM)


def bending_force(
    shape: tuple[int, int, int], spacing: float, bending: float, rng: np.random.Generator
) -> Floats:
    """Draw L^T e with e white of unit variance, where L^T L is the matrix of the bending energy.

    Same stencils as `geraf2.ops.grid_energy.GridEnergy`: second differences along each axis, and
    mixed ones, counted twice, on cell faces. Each kind is averaged over its number.
    """
    force = np.zeros(shape)

    def inner(axes: tuple[int, ...], starts: tuple[int, ...], lengths: list[int]) -> Floats:
        cut = [slice(None)] * 3
        for axis, start in zip(axes, starts, strict=True):
            cut[axis] = slice(start, start + lengths[axis])
        return force[tuple(cut)]

    for axis in range(3):
        lengths = list(shape)
        lengths[axis] -= 2
        if lengths[axis] > 0:
            scale = np.sqrt(bending / np.prod(lengths)) / spacing**2
            noise = scale * rng.standard_normal(lengths)
            for start, factor in enumerate((1.0, -2.0, 1.0)):
                part = inner((axis,), (start,), lengths)
                part += factor * noise
    for axes in combinations(range(3), 2):
        lengths = [n - (axis in axes) for axis, n in enumerate(shape)]
        scale = np.sqrt(2.0 * bending / np.prod(lengths)) / spacing**2
        noise = scale * rng.standard_normal(lengths)
        for first in (0, 1):
            for second in (0, 1):
                part = inner(axes, (first, second), lengths)
                part += noise if first == second else -noise
    return force


class Displacements(NamedTuple):
    """Samples of a surface's error along its outward normals."""

    own_m: Floats
    """Independent error of each vertex, (n_samples, n_vertices) [m]."""
    common_m: Floats
    """Offset that all vertices share, (n_samples,) [m]."""
    common_sigma_m: float
    """Standard deviation of that offset [m]."""


def draw_displacements(
    vertices: Floats,
    sdf: SdfGrid,
    fitted: tuple[OrientedPoints, SdfTerms],
    noise: PointNoise,
    n_samples: int,
    *,
    model: NoiseModel | None = None,
    seed: int = 0,
    num_threads: int | None = None,
) -> Displacements:
    """Draw distances from each vertex outwards to the true surface, without conformal factor.

        u(v) = c - df(v) / max(|grad f(v)|, 1/2)

    df is a sample of the field's error, and c one of the offset that all glints share. The energy
    does not depend on a constant added to f, so c needs no solve. Draws of c are quantiles of a
    normal distribution in random order, and df is made uncorrelated with them. Few samples then
    have the standard deviation of many.

    vertices: of the zero level of `sdf`, (n_vertices, 3) [m].
    sdf: fitted field. fitted: points and terms of the fit. noise: of these points.
    """
    model = model or NoiseModel()
    rng = np.random.default_rng(seed)
    cells = max(sdf.grid.shape) - 1
    coarse = resample(sdf, sdf.grid.spacing_m * max(1.0, cells / _CELLS))
    posterior = FieldPosterior(
        coarse, *fitted, noise, bend_density_m=model.bend_density_m, num_threads=num_threads
    )
    grid = coarse.grid
    index = (vertices - np.asarray(grid.origin_m)) / grid.spacing_m
    value, slopes = trilinear_rows(index, grid.shape, grid.spacing_m)
    field = coarse.values.astype(np.float64).ravel()
    slope = np.sqrt(sum((rows @ field) ** 2 for rows in slopes))
    slope = np.maximum(slope, _MIN_SLOPE)
    change = np.stack([value @ posterior.draw(rng) / slope for _ in range(n_samples)])
    common = _spread_draws(n_samples, rng)
    if n_samples > 1:  # remove the chance correlation of few draws, which all vertices would share
        change -= common[:, None] * (common @ change / n_samples)
        change *= np.sqrt(n_samples / (n_samples - 1))
    return Displacements(-change, model.common_sigma_m * common, model.common_sigma_m)


def sample_surface(
    mesh: TriangleMesh,
    sdf: SdfGrid,
    evidence: Evidence,
    prior: LosPrior,
    fit: FitConfig | None = None,
    *,
    n_samples: int = N_SAMPLES,
    seed: int = 0,
    num_threads: int | None = None,
) -> SurfaceSamples:
    """Draw surfaces from the posterior of a fit; the mesh gets expected errors and evidence.

    mesh: zero level of `sdf`, or some of its components.
    sdf: field of the fit. evidence, fit: its data and settings.
    prior: box, whose walls delay the echoes behind them.
    n_samples, seed: of the draws.

    Each sample moves a vertex along its normal by a draw of :func:`draw_displacements`, times the
    factors of :class:`geraf2.surfaces.expected_error.VertexSpread`. The expected error is the
    standard deviation over the samples. Not differentiable.
    """
    near = nearness(mesh, evidence.seen, weights=evidence.weights)
    kinds = evidence_of_vertices(mesh, near, evidence.outlines)
    if not len(mesh.vertices):
        nothing = replace(mesh, expected_error_m=np.zeros(0), evidence=kinds)
        return SurfaceSamples(nothing, np.zeros((n_samples, 0)), evidence.common_sigma_m)
    drawn, spread = draw_errors(
        mesh,
        near,
        sdf,
        evidence,
        prior,
        fit,
        draws=(n_samples, seed),
        num_threads=num_threads,
    )
    own, common = spread.factors()
    return SurfaceSamples(
        replace(mesh, expected_error_m=spread.expected_error_m(), evidence=kinds),
        (own * drawn.own_m + common * drawn.common_m[:, None]).astype(np.float32),
        evidence.common_sigma_m,
    )


def draw_errors(
    mesh: TriangleMesh,
    near: Nearness,
    sdf: SdfGrid,
    evidence: Evidence,
    prior: LosPrior,
    fit: FitConfig | None = None,
    *,
    draws: tuple[int, int] = (N_SAMPLES, 0),
    num_threads: int | None = None,
) -> tuple[Displacements, VertexSpread]:
    """Draw errors of a surface without factors, and their spread; arguments of `sample_surface`.

    near: of the mesh and the glints. draws: number and seed.
    """
    n_samples, seed = draws
    n_bytes = _BYTES_PER_DISPLACEMENT * n_samples * len(mesh.vertices)
    require_memory(n_bytes, f"{n_samples} samples are too many for this mesh")
    model, seen = NoiseModel(common_sigma_m=evidence.common_sigma_m), evidence.seen
    fitted = fitted_points(evidence, sdf, fit or FitConfig(), num_threads=num_threads)
    noise = point_noise(seen, len(fitted[0].positions) - len(seen), sdf, prior, model)
    drawn = draw_displacements(
        mesh.vertices,
        sdf,
        fitted,
        noise,
        n_samples,
        model=model,
        seed=seed,
        num_threads=num_threads,
    )
    spread = VertexSpread(
        own_m=np.sqrt(np.mean(drawn.own_m**2, axis=0)),
        common_m=model.common_sigma_m,
        support=near.support,
        bound_m=np.hypot(near.distance_m, noise.total_sigma_m[near.nearest]),
        probability=seen.probability[near.nearest],
    )
    return drawn, spread


def _spread_draws(n: int, rng: np.random.Generator) -> Floats:
    """Draw n quantiles of a normal distribution in random order: mean 0, mean square 1, (n,)."""
    from scipy.special import ndtri  # noqa: PLC0415 - other commands save its import

    draws = ndtri((np.arange(n) + 0.5) / n)
    scale = float(np.sqrt(np.mean(draws**2))) if n > 1 else 1.0
    return rng.permutation(draws / scale) if n > 1 else rng.standard_normal(1)
