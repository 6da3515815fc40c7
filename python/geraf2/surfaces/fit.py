"""From glints to the signed distance of the content."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from geraf2._bounds import (
    Bounded,
    CellM,
    Cosine,
    LengthM,
    MarginM,
    NotNegative,
    Positive,
    Rounds,
)
from geraf2._memory import require_memory
from geraf2._types import Floats, Ints, Progress
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.freespace.caps import cap_retreat
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.freespace.tangents import Tangents, tangent_points
from geraf2.geometry.nearest import nearest_distance
from geraf2.geometry.triangles import vertex_normals
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid
from geraf2.surfaces.fit_memory import fit_bytes
from geraf2.surfaces.linear_sdf import DistanceTarget, LinearSdf, OrientedPoints, SdfTerms, resample

_RAMP_M = 0.004
"""Over which the weight of the pull to a distance ends, at the end of the band [m]."""
# Voxels of the first solve over those of the second, which it only speeds up.
_COARSE = 2.0
# Residuals, relative: 1e-5 leaves 0.02 mm in a solve, which is enough at last; starts may err more.
_FINE, _ROUGH = 1e-5, 1e-4

UNKNOWN_OFFSET_M = 1e-3
"""Standard deviation of the range offset of a scan that shows no wall of its box [m]."""
FIT_VERSION = 24
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What a surface is fitted to."""

    glints: Glints
    """Of whole sub-apertures, at least 10. Caps are judged by these alone."""
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

    @property
    def seen(self) -> Glints:
        """All glints, those of the rim last."""
        return self.glints if self.rim is None else self.glints.join(self.rim)

    @property
    def weights(self) -> Floats:
        """Of these against one of whole sub-apertures, (n,)."""
        n_rim = 0 if self.rim is None else len(self.rim)
        return np.repeat([1.0, self.rim_weight], [len(self.glints), n_rim])


def fit_sdf(
    glints: Glints | Evidence,
    config: FitConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SdfGrid:
    """Signed distance of the content from its glints; negative inside.

    Minimises position + normal + bending + outside terms
    (docs/math/surface-fit.md#linear-signed-distance), coarse then fine, then with the points where
    edges of outlines touch what it found. It then draws the field to the distance from its own
    zero level, and cuts it to the outlines.

    glints: at least 10; or all evidence.
    config: weights and sizes.
    num_threads: of the distance queries; torch's number or all cores when None.
    progress: called with the fraction done.

    Returns samples on a grid [m]. Raises UserError where the glints do not enclose anything.

    >>> from geraf2.surfaces import FitConfig
    >>> sdf = geraf2.fit_sdf(geraf2.examples.small_run().glints,
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
    for number in range(n_rounds):
        target = _distance_target(sdf, evidence.glints, first.known, config, num_threads)
        tolerance = _FINE if number + 1 == n_rounds else _ROUGH
        sdf = first.system.solve(target, start=sdf, tolerance=tolerance)
        report((3.0 + number) / n_solves)
    outlines, clearance_m = evidence.outlines, evidence.outline_clearance_m
    if outlines is None or not len(outlines):
        return sdf
    return cut_to_outlines(sdf, outlines, evidence.seen, clearance_m, num_threads=num_threads)


class _FirstFit(NamedTuple):
    """Field that is no distance yet."""

    system: LinearSdf
    sdf: SdfGrid
    known: Floats  # positions of glints and of points that edges of outlines touch, (n, 3) [m]


def _first_solves(
    evidence: Evidence, config: FitConfig, num_threads: int | None, report: Callable[[int], None]
) -> _FirstFit:
    """Fit of all oriented points, coarse, fine, and with the points that outlines touch."""
    terms, points = _terms(config), _weigh(evidence, config)
    grid = _domain(evidence.glints.positions, config)
    coarse = SdfGrid(grid=grid, values=np.zeros(grid.shape, dtype=np.float32))
    coarse = LinearSdf(coarse, points, terms, num_threads=num_threads).solve(tolerance=_ROUGH)
    report(1)
    start = resample(coarse, grid.spacing_m / _COARSE)
    system = LinearSdf(start, points, terms, num_threads=num_threads)
    tolerance = _ROUGH if config.distance_rounds else _FINE
    sdf = system.solve(tolerance=tolerance)
    touched, known = _touched(evidence, sdf, num_threads), evidence.glints.positions
    if touched is not None:
        known = np.concatenate([known, touched.positions])
        system = LinearSdf(sdf, _weigh(evidence, config, touched), terms, num_threads=num_threads)
        sdf = system.solve(tolerance=tolerance)
    report(2)
    return _FirstFit(system, sdf, known)


def _touched(evidence: Evidence, sdf: SdfGrid, num_threads: int | None) -> Tangents | None:
    """Points of a field that edges of outlines touch; None without outlines."""
    outlines = evidence.outlines
    if outlines is None or not len(outlines) or evidence.outline_weight <= 0.0:
        return None
    seen, clearance_m = evidence.seen.positions, evidence.outline_clearance_m
    return tangent_points(sdf, outlines, seen, clearance_m, num_threads=num_threads)


def fitted_points(
    evidence: Evidence, sdf: SdfGrid, config: FitConfig, *, num_threads: int | None = None
) -> tuple[OrientedPoints, SdfTerms]:
    """Points and terms of the last solve of :func:`fit_sdf`: glints, then where outlines touch.

    sdf: field that the fit gave; it decides where edges of outlines touch the surface.
    """
    return _weigh(evidence, config, _touched(evidence, sdf, num_threads)), _terms(config)


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
    relative = relative_strengths(together.strengths, glints.strengths)
    # Variances: of a normal as 1 / amplitude, of a position as its root; thin parts echo weakly.
    shares = together.probability * evidence.weights
    position, normal = shares * np.sqrt(relative), shares * relative
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
    hint = "raise the fit's spacing-m, or lower its max-voxels"
    require_memory(fit_bytes((cells * _COARSE) ** 3), hint)
    return Grid.centered(center, spacing, (cells + 1,) * 3)


def _distance_target(
    sdf: SdfGrid, glints: Glints, known: Floats, config: FitConfig, num_threads: int | None
) -> DistanceTarget:
    """Distance of voxels in the band to the present zero level, whose caps retreat first.

    The weight ends with a ramp. known: where the surface is known, seen or not, (n, 3) [m].
    """
    vertices, faces = zero_level(sdf)
    points, band_m = sdf.grid.points(), config.distance_band_m
    scene = MeshScene(vertices, faces, num_threads=num_threads)
    distance = scene.distance(points, max_distance_m=band_m)
    weights = np.clip((band_m - distance) / _RAMP_M, 0.0, 1.0)
    voxels = np.nonzero(weights)[0]
    # The sign is the field's own, so that an open zero level cannot turn it.
    values = np.copysign(distance[voxels], sdf.values.ravel()[voxels].astype(np.float64))
    retreat = cap_retreat(
        vertices,
        vertex_normals(vertices, faces),
        glints,
        slope=config.cap_slope,
        start_m=config.cap_start_m,
        known=known,
        lean=config.cap_lean,
    )
    if retreat.any():
        # Most voxels are near to no vertex that retreats, which is soon known.
        moving = KDTree(vertices[retreat != 0.0])
        reach_m = band_m + 2.0 * sdf.grid.spacing_m
        close = np.isfinite(moving.query(points[voxels], distance_upper_bound=reach_m)[0])
        values[close] += retreat[KDTree(vertices).query(points[voxels[close]])[1]]
    weights *= config.distance_weight / weights.sum()
    return DistanceTarget(values=values, voxels=voxels, weights=weights[voxels])


def cut_to_outlines(
    sdf: SdfGrid,
    outlines: Silhouettes,
    seen: Glints,
    clearance_m: float,
    *,
    num_threads: int | None = None,
) -> SdfGrid:
    """Largest of a field and the distance to what outlines do not show free.

    That distance is less by what a point lacks of `clearance_m` to the nearest glint: a glint is
    the better witness where both differ by less.

    sdf: signed distance of the content. seen: at least one glint. clearance_m: distance to the
    nearest glint from which on outlines are believed as they are [m].
    """
    points = sdf.grid.points()
    distance = nearest_distance(
        points, seen.positions, max_distance_m=clearance_m, num_threads=num_threads
    )
    free_m = outlines.free_distance(points) - np.maximum(0.0, clearance_m - distance)
    values = np.maximum(sdf.values.ravel(), free_m)
    return SdfGrid(grid=sdf.grid, values=values.reshape(sdf.grid.shape).astype(np.float32))


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
