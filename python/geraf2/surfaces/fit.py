"""Fit of the content's signed distance to its glints."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval
from skimage.measure import marching_cubes

from geraf2._bounds import (
    Bounded,
    CellM,
    LengthM,
    NotNegative,
    Positive,
)
from geraf2._memory import require_memory
from geraf2._types import Floats, Ints, Progress
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.echoes.wall_delay import DELAY_SIGMA_M
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.freespace.tangents import Tangents, tangent_points
from geraf2.geometry.nearest import nearest_distance
from geraf2.scene import Grid
from geraf2.scene.aperture import Aperture
from geraf2.surfaces.completion import SPACING_M as COMPLETION_M
from geraf2.surfaces.completion import complete
from geraf2.surfaces.fit_memory import fit_bytes
from geraf2.surfaces.isosurface import extract_surface
from geraf2.surfaces.linear_sdf import LinearSdf, OrientedPoints, SdfTerms, resample
from geraf2.surfaces.pieces import separate_pieces

_MIN_KEPT = 0.5
"""Share of the glints on the fit's surface that have to stay on the completed one: where few glints
lie in clumps, the networks take the clumps for false and remove the body."""
UNKNOWN_OFFSET_M: float = DELAY_SIGMA_M
"""Standard deviation of the range offset, when a scan shows no wall of its box [m]."""
FIT_VERSION = 27
"""Increase when the same glints and settings give another field, also for the preset best."""


@dataclass(frozen=True, kw_only=True)
class FitConfig(Bounded):
    """Settings of the fit; the constants are properties of the simulated population of objects."""

    spacing_m: CellM = 0.004
    """Voxel size [m]."""
    margin_m: LengthM = 0.035
    """Margin around the glints [m], about equal to the distance at the domain's faces."""
    max_voxels: Annotated[int, Interval(ge=1000, le=10**9)] = 4_000_000
    """Largest grid; above it the voxels grow."""
    position_weight: Positive = 30.0
    """Weight of f = 0 at the glints, relative to that of grad f = n there."""
    bending_weight: Positive = 0.8
    """Weight of the squared Hessian."""
    outside_weight: NotNegative = 0.1
    """Weight of the distance at the domain's faces; without it closed bodies open."""
    outside_distance_m: LengthM = 0.03
    """Distance that the fit assumes at the domain's faces [m]."""
    completion: Literal["objects", "smooth"] = "objects"
    """What closes the surface where no echo came from: a network that has seen objects, or the
    smoothest surface. Content of plastic gets the smoothest one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Data of a surface fit."""

    glints: Glints
    """At least 10."""
    outlines: Silhouettes | None = None
    """Silhouettes whose edges touch the surface."""
    outline_weight: float = 0.0
    """Weight of a tangent point of an outline's edge, relative to a strong glint; 0: not used."""
    outline_clearance_m: float = 0.0
    """Distance within which glints override outlines [m]."""
    common_sigma_m: float = UNKNOWN_OFFSET_M
    """Standard deviation of the range offset that all glints share [m]. Calibration states it; its
    causes are the radar's delay and the turntable's radius."""


def fit_sdf(
    glints: Glints | Evidence,
    config: FitConfig | None = None,
    *,
    apertures: Sequence[Aperture] = (),
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SdfGrid:
    """Signed distance of the content from its glints, negative inside.

    Minimises the sum of position, normal, bending and outside terms
    (docs/math/surface-fit.md#linear-signed-distance). It solves once, then with the points
    where edges of outlines touch the result. Where no echo came from it is then completed
    (docs/math/completion.md). Outlines finally cut it.

    Parameters
    ----------
    glints
        At least 10; or all evidence.
    config
        Weights and sizes.
    apertures
        Of all planes of the scan. Without them nothing is completed.
    num_threads
        Of the solver; torch's number or all cores when None.
    progress
        Called with the fraction done.

    Returns
    -------
    SdfGrid
        Samples on a grid [m].

    Raises
    ------
    UserError
        If the glints do not enclose anything.

    Examples
    --------
    >>> from geraf2.surfaces import FitConfig
    >>> sdf = geraf2.fit_sdf(geraf2.examples.small_run().glints,
    ...                      FitConfig(spacing_m=0.012))
    >>> sdf.values.shape == sdf.grid.shape
    True
    """
    evidence = Evidence(glints=glints) if isinstance(glints, Glints) else glints
    config = config or FitConfig()
    sdf, points = smooth_fit(evidence, config, num_threads=num_threads, progress=progress)
    if apertures and config.completion == "objects":
        completed = complete(sdf, points, apertures, evidence.outlines)
        kept, before = (_weight_on(of, evidence) for of in (completed, sdf))
        sdf = completed if kept > _MIN_KEPT * before else sdf
    outlines, clearance_m = evidence.outlines, evidence.outline_clearance_m
    if outlines is None or not len(outlines):
        return sdf
    return cut_to_outlines(sdf, outlines, evidence.glints, clearance_m, num_threads=num_threads)


def smooth_fit(
    evidence: Evidence,
    config: FitConfig,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> tuple[SdfGrid, OrientedPoints]:
    """Fit the smoothest field, without completion and cut -> field, points that it was fitted to.

    Arguments as those of `fit_sdf`. The points are glints, and tangent points of outlines.
    """
    report = progress or (lambda _: None)
    terms, points = _terms(config), _weigh(evidence)
    grid = _domain(evidence.glints.positions, config)
    start = SdfGrid(grid=grid, values=np.zeros(grid.shape, dtype=np.float32))
    sdf = LinearSdf(start, points, terms, num_threads=num_threads).solve()
    report(0.5)
    touched = _touched(evidence, sdf, num_threads)
    if touched is not None:
        points = _weigh(evidence, touched)
        sdf = LinearSdf(sdf, points, terms, num_threads=num_threads).solve()
    report(1.0)
    return sdf, points


def _touched(evidence: Evidence, sdf: SdfGrid, num_threads: int | None) -> Tangents | None:
    """Tangent points of outlines on the zero level of a field; None without outlines."""
    outlines = evidence.outlines
    if outlines is None or not len(outlines) or evidence.outline_weight <= 0.0:
        return None
    seen, clearance_m = evidence.glints.positions, evidence.outline_clearance_m
    return tangent_points(sdf, outlines, seen, clearance_m, num_threads=num_threads)


def _terms(config: FitConfig) -> SdfTerms:
    return SdfTerms(
        position=config.position_weight,
        normal=1.0,
        bending=config.bending_weight,
        outside=config.outside_weight,
        outside_distance_m=config.outside_distance_m,
    )


def _weigh(evidence: Evidence, touched: Tangents | None = None) -> OrientedPoints:
    """Return the known points of the surface, with weights relative to a strong glint."""
    glints = evidence.glints
    relative, shares = relative_strengths(glints.strengths), glints.probability
    # The variance of a normal falls as 1 / amplitude, that of a position as its root.
    position, normal = shares * np.sqrt(relative), shares * relative
    groups: list[Glints | Tangents] = [glints]
    if touched is not None:
        groups.append(touched)
        outline = np.full(len(touched), evidence.outline_weight)
        position, normal = (np.concatenate([each, outline]) for each in (position, normal))
    return OrientedPoints(
        positions=np.concatenate([group.positions for group in groups]),
        normals=np.concatenate([group.normals for group in groups]),
        position_weights=position,
        normal_weights=normal,
    )


def _weight_on(sdf: SdfGrid, evidence: Evidence) -> float:
    """Sum the weights of glints on the surface of a field, but for pieces that likely do not exist.

    Read on voxels of 5 mm, which suffices to count.
    """
    seen = evidence.glints
    vertices = separate_pieces(extract_surface(resample(sdf, COMPLETION_M)), seen)[0].vertices
    if not len(vertices):
        return 0.0
    distance = nearest_distance(seen.positions, vertices, max_distance_m=2.0 * COMPLETION_M)
    return float(seen.probability[distance < COMPLETION_M].sum())


def _domain(points: Floats, config: FitConfig) -> Grid:
    """Grid around the surface: a cube, so that no axis is preferred."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * float((high - low).max()) + config.margin_m
    center = 0.5 * (low + high)
    # The larger voxels of at most so many; an even number of cells has exact coarser grids.
    spacing = max(config.spacing_m, 2.0 * half / config.max_voxels ** (1.0 / 3.0))
    cells = 2 * max(4, int(np.ceil(half / spacing)))
    require_memory(fit_bytes(cells**3), "raise the fit's spacing-m, or lower its max-voxels")
    return Grid.centered(center, spacing, (cells + 1,) * 3)


def cut_to_outlines(
    sdf: SdfGrid,
    outlines: Silhouettes,
    seen: Glints,
    clearance_m: float,
    *,
    num_threads: int | None = None,
) -> SdfGrid:
    """Remove from a field what outlines show to be free space.

    The result is the maximum of the field and the outlines' free distance. Near glints the free
    distance is reduced by `clearance_m` minus the distance to the nearest glint, because glints
    are more accurate than outlines.

    sdf: signed distance of the content.
    seen: at least one glint.
    clearance_m: distance to the nearest glint from which outlines count fully [m].
    """
    points = sdf.grid.points()
    distance = nearest_distance(
        points, seen.positions, max_distance_m=clearance_m, num_threads=num_threads
    )
    free_m = outlines.free_distance(points) - np.maximum(0.0, clearance_m - distance)
    values = np.maximum(sdf.values.ravel(), free_m)
    return SdfGrid(grid=sdf.grid, values=values.reshape(sdf.grid.shape).astype(np.float32))


def zero_level(sdf: SdfGrid) -> tuple[Floats, Ints]:
    """Triangles of the zero level, facing outwards; UserError when there is none."""
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
