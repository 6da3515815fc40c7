"""From glints to the signed distance of the content."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from geraf2._bounds import (
    AngleRad,
    Bounded,
    CellM,
    Cosine,
    LengthM,
    MarginM,
    NotNegative,
    Positive,
    Rounds,
)
from geraf2._types import Floats, Ints, Progress
from geraf2.echoes.glint_set import Glints, strong_level
from geraf2.echoes.glints import GlintConfig
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.freespace.absence import SOFT_M, beyond, refuted
from geraf2.freespace.caps import cap_retreat
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.freespace.tangents import Tangents, tangent_points
from geraf2.geometry.triangles import vertex_normals
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, Grid, LosPrior
from geraf2.scene.aperture import apertures_of
from geraf2.surfaces.linear_sdf import DistanceTarget, LinearSdf, OrientedPoints, SdfTerms, resample

_PLACES_AT_ONCE = 256
# Voxels of the first solve over those of the second, which it only speeds up.
_COARSE = 2.0
# Residuals, relative: 1e-5 leaves 0.02 mm in a solve, which is enough at last; starts may err more.
_FINE, _ROUGH = 1e-5, 1e-4

UNKNOWN_OFFSET_M = 1e-3
"""Standard deviation of the range offset of a scan that shows no wall of its box [m]."""
FIT_VERSION = 20
"""Raised when the same glints and settings give another field, for best, too."""


@dataclass(frozen=True, kw_only=True)
class FitConfig(Bounded):
    """Constants of the fit."""

    spacing_m: CellM = 0.004
    """Voxel size [m]."""
    margin_m: LengthM = 0.035
    """Room around the glints [m]; the domain's faces are pulled to about this distance."""
    max_voxels: Annotated[int, Interval(ge=1000, le=10**9)] = 4_000_000
    """Largest grid; above it the voxels grow."""
    position_weight: Positive = 30.0
    """Weight of f = 0 at the glints, against that of grad f = n there, which is the unit."""
    bending_weight: Positive = 0.8
    """Weight of the squared Hessian."""
    outside_weight: NotNegative = 0.1
    """Weight of the pull at the domain's faces; without it closed bodies open up."""
    outside_distance_m: LengthM = 0.03
    """Distance that the faces are pulled to [m]."""
    distance_rounds: Rounds = 2
    """Rounds that draw the field to the distance from its own zero level, lest it flatten and
    bulge."""
    distance_weight: NotNegative = 0.12
    """Weight of that pull."""
    distance_band_m: LengthM = 0.02
    """The pull acts within this distance of the zero level [m]."""
    cap_slope: NotNegative = 1.0
    """Unseen flat caps go inwards by this times how much farther than cap_start_m a glint is."""
    cap_start_m: MarginM = 0.0225
    """Distance from the glints at which that begins [m]."""
    cap_lean: tuple[Cosine, Cosine] = (0.2, 0.4)
    """Cosine of a cap's normal to those around it: flat below the first, round from the second
    on."""
    absence_weight: NotNegative = 0.3
    """Weight of the pull away from absent echoes, shared out as distance_weight; 0: off."""
    absence_reach_m: MarginM = 0.010
    """A glint this near explains a surface that faces the aperture [m]."""
    absence_angle_rad: AngleRad = 0.3
    """If its normal is within this angle [rad]."""
    absence_margin_m: MarginM = 0.035
    """Rim of each aperture from which no echo is expected [m]."""
    absence_clearance_m: MarginM = 0.015
    """Voxels nearer to a glint, or to where an outline's edge touches, than this stay [m]."""
    absence_depth_m: MarginM = 0.012
    """Voxels this near to a surface that is not there are pulled outside [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What a surface is fitted to."""

    glints: Glints
    """Of whole sub-apertures, at least 10. Caps and absent echoes are judged by these
    alone."""
    rim: Glints | None = None
    """Of smaller sub-apertures at the rim; the surface is drawn through them, too."""
    rim_weight: float = 1.0
    """Weight of one of them against one of `glints`."""
    outlines: Silhouettes | None = None
    """Shadows whose edges the surface touches."""
    outline_weight: float = 0.0
    """Weight of a point where an edge touches, against a strong glint; 0: there is none."""
    outline_clearance_m: float = 0.0
    """Outlines yield to glints nearer than this [m]."""
    common_sigma_m: float = UNKNOWN_OFFSET_M
    """Standard deviation of the range offset that all glints share, as calibration states it: delay
    of the radar, radius of the turntable [m]."""
    found_with: GlintConfig = field(default_factory=GlintConfig)
    """Settings with which the glints were found: their agreement, the margin at the box."""

    @property
    def seen(self) -> Glints:
        """All glints, those of the rim last."""
        return self.glints if self.rim is None else self.glints.join(self.rim)


def fit_sdf(
    glints: Glints | Evidence,
    capture: Capture,
    prior: LosPrior,
    config: FitConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SdfGrid:
    """Signed distance of the content from its glints; negative inside.

    Minimises position + normal + bending + outside terms
    (docs/math/surface-fit.md#linear-signed-distance), coarse then fine, then with the points where
    edges of outlines touch what it found, then draws the field to the distance from its own zero
    level.

    glints: at least 10; or all evidence, with the settings with which the glints were found.
    capture: its poses say from where an echo would have been seen.
    prior: outer surface of the box: near it no echo counts as absent. The
    content is cut to the box when its mesh is extracted.
    config: weights and sizes.
    num_threads: of the distance queries; torch's number or all cores when None.
    progress: called with the fraction done.

    Returns samples on a grid [m]. Raises UserError where the glints do not enclose anything.

    >>> from geraf2.surfaces import FitConfig
    >>> capture, prior = geraf2.examples.small_capture()[0], geraf2.examples.small_run().prior
    >>> sdf = geraf2.fit_sdf(geraf2.examples.small_run().glints, capture, prior,
    ...                      FitConfig(spacing_m=0.012, distance_rounds=0))
    >>> sdf.values.shape == sdf.grid.shape
    True
    """
    evidence = Evidence(glints=glints) if isinstance(glints, Glints) else glints
    config = config or FitConfig()
    report = progress or (lambda _: None)
    n_rounds = config.distance_rounds
    n_solves = 2 + n_rounds
    first = _first_solves(evidence, config, num_threads, lambda n: report(n / n_solves))
    sdf = first.sdf
    absence = _Absence(evidence, first.sure, capture, prior, sdf.grid, config, num_threads)
    for number in range(n_rounds):
        surface = _Surface.of(sdf, num_threads)
        absence.update(surface)
        retreat = cap_retreat(
            surface.vertices,
            surface.normals,
            evidence.glints,
            slope=config.cap_slope,
            start_m=config.cap_start_m,
            known=first.sure,
            lean=config.cap_lean,
        )
        target = _targets(sdf, surface, retreat, absence, config)
        tolerance = _FINE if number + 1 == n_rounds else _ROUGH
        sdf = first.system.solve(target, start=sdf, tolerance=tolerance)
        report((3.0 + number) / n_solves)
    return sdf


class _FirstFit(NamedTuple):
    """Field that is no distance yet."""

    system: LinearSdf
    sdf: SdfGrid
    sure: Floats  # places of glints and where edges of outlines touch, (n, 3) [m]


def _first_solves(
    evidence: Evidence, config: FitConfig, num_threads: int | None, report: Callable[[int], None]
) -> _FirstFit:
    """Fit of all oriented points, coarse, fine, and with the points that outlines touch."""
    terms, points = _terms(config), _weigh(evidence, config)
    sure = evidence.glints.positions
    grid = _domain(sure, config)
    coarse = SdfGrid(grid=grid, values=np.zeros(grid.shape, dtype=np.float32))
    coarse = LinearSdf(coarse, points, terms, num_threads=num_threads).solve(tolerance=_ROUGH)
    report(1)
    start = resample(coarse, grid.spacing_m / _COARSE)
    system = LinearSdf(start, points, terms, num_threads=num_threads)
    tolerance = _ROUGH if config.distance_rounds else _FINE
    sdf = system.solve(tolerance=tolerance)
    outlines = evidence.outlines
    if outlines is not None and len(outlines) and evidence.outline_weight > 0.0:
        seen, clearance_m = evidence.seen.positions, evidence.outline_clearance_m
        touched = tangent_points(sdf, outlines, seen, clearance_m, num_threads=num_threads)
        sure = np.concatenate([sure, touched.positions])
        points = _weigh(evidence, config, touched)
        system = LinearSdf(sdf, points, terms, num_threads=num_threads)
        sdf = system.solve(tolerance=tolerance)
    report(2)
    return _FirstFit(system, sdf, sure)


def fitted_points(
    evidence: Evidence, sdf: SdfGrid, config: FitConfig, *, num_threads: int | None = None
) -> tuple[OrientedPoints, SdfTerms]:
    """Points and terms of the last solve of :func:`fit_sdf`: glints, then where outlines touch.

    sdf: field that the fit gave; it decides where edges of outlines touch the surface.
    """
    outlines, touched = evidence.outlines, None
    if outlines is not None and len(outlines) and evidence.outline_weight > 0.0:
        seen, clearance_m = evidence.seen.positions, evidence.outline_clearance_m
        touched = tangent_points(sdf, outlines, seen, clearance_m, num_threads=num_threads)
    return _weigh(evidence, config, touched), _terms(config)


def _terms(config: FitConfig) -> SdfTerms:
    return SdfTerms(
        position=config.position_weight,
        normal=1.0,
        bending=config.bending_weight,
        outside=config.outside_weight,
        outside_distance_m=config.outside_distance_m,
    )


def _weigh(
    evidence: Evidence, config: FitConfig, touched: Tangents | None = None
) -> OrientedPoints:
    glints, together = evidence.glints, evidence.seen
    relative = np.minimum(1.0, together.strengths / strong_level(glints.strengths))
    # Variances: of a normal as 1 / amplitude, of a position as its root; thin parts echo weakly.
    position, normal = together.probability * (np.sqrt(relative), relative)
    for weights in (position, normal):
        weights[len(glints) :] *= evidence.rim_weight
    groups: list[Glints | Tangents] = [together]
    if touched is not None:
        groups.append(touched)
        outline = np.full(len(touched), evidence.outline_weight)
        position, normal = (np.concatenate([each, outline]) for each in (position, normal))
    return OrientedPoints(
        positions=np.concatenate([group.positions for group in groups]),
        normals=np.concatenate([group.normals for group in groups]),
        position_weights=position / position.sum(),
        normal_weights=normal / normal.sum(),
    )


def _domain(points: Floats, config: FitConfig) -> Grid:
    """Coarse grid around the surface: a cube, so that no direction is favoured."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * float((high - low).max()) + config.margin_m
    center = 0.5 * (low + high)
    spacing = _COARSE * config.spacing_m
    cells = max(4, int(np.ceil(2.0 * half / spacing)))
    fine_cells = cells * _COARSE
    if fine_cells**3 > config.max_voxels:
        grow = fine_cells / config.max_voxels ** (1.0 / 3.0)
        spacing, cells = spacing * grow, max(4, int(np.ceil(cells / grow)))
    return Grid.centered(center, spacing, (cells + 1,) * 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Surface:
    """Zero level of a field."""

    vertices: Floats
    normals: Floats
    scene: MeshScene

    @classmethod
    def of(cls, sdf: SdfGrid, num_threads: int | None) -> "_Surface":
        vertices, faces = zero_level(sdf)
        return cls(
            vertices=vertices,
            normals=vertex_normals(vertices, faces),
            scene=MeshScene(vertices, faces, num_threads=num_threads),
        )


class _Absence:
    """Voxels where the surface was expected to flash and did not, over all rounds."""

    def __init__(
        self,
        evidence: Evidence,
        sure: Floats,
        capture: Capture,
        prior: LosPrior,
        grid: Grid,
        config: FitConfig,
        num_threads: int | None,
    ) -> None:
        self._glints, self._config, self._grid = evidence.glints, config, grid
        self._apertures = apertures_of(capture.poses)
        self._wall_margin_m = evidence.found_with.wall_margin_m
        self._box = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
        self.points = grid.points()
        self._tree = KDTree(sure)
        self.clearance_m = np.full(len(self.points), np.inf)
        """To the nearest sure place of the surface, where an echo is absent [m]."""
        self.degree = np.zeros(len(self.points))

    def update(self, surface: _Surface) -> None:
        """Add the voxels around the parts of a surface that are not there."""
        config = self._config
        if config.absence_weight <= 0.0:
            return
        gone = refuted(
            surface.vertices,
            surface.normals,
            surface.scene,
            self._glints,
            self._apertures,
            margin_m=config.absence_margin_m,
            reach_m=config.absence_reach_m,
            angle_rad=config.absence_angle_rad,
        )
        wrong = np.nonzero(gone)[0]
        if len(wrong) == 0:
            return
        # Echoes nearer to the box than this were attributed to its wall: none is missing there.
        depth_m = -self._box.signed_distance(surface.vertices[wrong])
        degree = gone[wrong] * beyond(depth_m, self._wall_margin_m)
        reach_m, gone = config.absence_depth_m + SOFT_M, np.zeros(len(self.points))
        for vertex, voxels, distance in voxels_around(self._grid, surface.vertices[wrong], reach_m):
            near = degree[vertex] * beyond(-distance, -config.absence_depth_m)
            np.maximum.at(gone, voxels, near)
        voxels = np.nonzero(gone)[0]
        self.clearance_m[voxels] = self._tree.query(self.points[voxels])[0]
        gone[voxels] *= beyond(self.clearance_m[voxels], config.absence_clearance_m)
        self.degree = np.maximum(self.degree, gone)


def voxels_around(
    grid: Grid, places: Floats, reach_m: float
) -> Iterator[tuple[Ints, Ints, Floats]]:
    """Pairs of places (n, 3) [m] and voxels not farther apart than this, a few places at a time.

    Yields place, flat index of the voxel and distance [m], (n_pairs,) each.
    """
    side = int(np.ceil(reach_m / grid.spacing_m)) + 1
    offsets = np.stack(np.meshgrid(*[np.arange(-side, side + 1)] * 3, indexing="ij"), axis=-1)
    offsets = offsets.reshape(-1, 3)
    offsets = offsets[np.linalg.norm(offsets, axis=1) * grid.spacing_m <= reach_m + grid.spacing_m]
    shape = np.asarray(grid.shape)
    for first in range(0, len(places), _PLACES_AT_ONCE):
        at = (places[first : first + _PLACES_AT_ONCE] - np.asarray(grid.origin_m)) / grid.spacing_m
        voxel = np.rint(at).astype(np.int64)[:, None] + offsets
        distance = grid.spacing_m * np.linalg.norm(voxel - at[:, None], axis=2)
        inside = ((voxel >= 0) & (voxel < shape)).all(axis=2) & (distance <= reach_m)
        place, which = np.nonzero(inside)
        flat = np.ravel_multi_index(tuple(voxel[place, which].T), grid.shape)
        yield first + place, flat, distance[place, which]


def _targets(
    sdf: SdfGrid, surface: _Surface, retreat: Floats, absence: _Absence, config: FitConfig
) -> DistanceTarget:
    """Distance from the present zero level, or from the glints where an echo is absent.

    The zero level is first moved inwards by `retreat` [m] at each of its vertices.
    """
    distance = surface.scene.distance(absence.points, max_distance_m=config.distance_band_m)
    # The sign is the field's own, so that an open zero level cannot turn it.
    distance = np.copysign(distance, sdf.values.ravel().astype(np.float64))
    near = np.abs(distance) < config.distance_band_m
    weights = beyond(-np.abs(distance), SOFT_M - config.distance_band_m)
    n_near = weights.sum()
    if retreat.any():
        # Most voxels are near to no vertex that retreats, which is soon known.
        moving = KDTree(surface.vertices[retreat != 0.0])
        reach_m = config.distance_band_m + 2.0 * sdf.grid.spacing_m
        close = np.nonzero(near)[0]
        far = moving.query(absence.points[close], distance_upper_bound=reach_m)[0]
        close = close[np.isfinite(far)]
        distance[close] += retreat[KDTree(surface.vertices).query(absence.points[close])[1]]
    weights *= (1.0 - absence.degree) * config.distance_weight / n_near
    away = absence.degree * config.absence_weight / n_near
    free = np.minimum(absence.clearance_m, config.distance_band_m)
    # Two squares about two distances are one about their mean.
    voxels = np.nonzero(weights + away)[0]
    distance = np.where(near, distance, free)  # infinite beyond the band
    distance = (weights * distance + away * free) / np.maximum(weights + away, 1e-300)
    weights += away
    return DistanceTarget(values=distance[voxels], voxels=voxels, weights=weights[voxels])


def zero_level(sdf: SdfGrid) -> tuple[Floats, Ints]:
    """Triangles of the zero level, outward; UserError when there is none."""
    low, high = float(sdf.values.min()), float(sdf.values.max())
    if not low < 0.0 < high:
        raise UserError(
            what="the glints do not enclose anything",
            expected="a signed distance with both signs",
            got=f"values from {low:.4f} to {high:.4f} m",
            hint="check the frame of the scan and the number of planes",
        )
    vertices, faces, _, _ = marching_cubes(sdf.values, 0.0, gradient_direction="descent")
    vertices = vertices.astype(np.float64) * sdf.grid.spacing_m + np.asarray(sdf.grid.origin_m)
    return vertices, faces.astype(np.int64)
