"""Surface through linked glints and those of rim sub-apertures, for `--preset best`.

Glints without a link to a strong one are dropped; the others are continued to the rim of the
apertures. With few planes the size of the voxels can decide whether a surface is there: then the
field is the mean of several fits. Last, what the content's shadow on the far walls shows to be free
is cut off.

Each step and its worth: docs/method.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, MarginM, NotNegative, Share
from geraf2._types import Progress
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig
from geraf2.echoes.rim import RimConfig, find_rim_glints
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import SilhouetteConfig, Silhouettes, find_silhouettes
from geraf2.geometry.nearest import nearest_distance
from geraf2.ops._threads import resolve_num_threads
from geraf2.scene import Capture, LosPrior
from geraf2.surfaces.fit import UNKNOWN_OFFSET_M, Evidence, FitConfig, fit_sdf
from geraf2.surfaces.workers import Workers

FEW_PLANES = 12
"""With fewer planes the size of the voxels can decide whether a surface is there."""
SELECTION_VERSION = 7
"""Raised when :func:`select_glints` finds something else in the same capture."""


@dataclass(frozen=True, kw_only=True)
class RefineConfig(Bounded):
    """Which glints are selected, and the fit through them."""

    rim: RimConfig = field(default_factory=RimConfig)
    """Glints of smaller sub-apertures at the rim."""
    silhouettes: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    """Outline of the content against the box's far walls."""
    fit: FitConfig = field(default_factory=lambda: FitConfig(spacing_m=0.003))
    """How the surface is drawn through both; on voxels that resolve what the rim adds."""
    few_planes_voxel_scales: Annotated[
        tuple[Annotated[float, Interval(ge=0.1, le=10.0)], ...], MinLen(1)
    ] = (1.0, 7.0 / 6.0, 4.0 / 3.0)
    """Voxels of the fits whose mean is taken with fewer than 12 planes, in units of the fit's own;
    with more one fit is enough."""
    rim_weight: NotNegative = 0.2
    """Weight of a glint of the rim against one of whole sub-apertures; with fewer than 12 planes 1:
    it is often the only one at its position."""
    outline_weight: NotNegative = 0.05
    """Weight of a point where the edge of an outline touches the surface, which errs by 2 mm,
    against a strong glint, which errs by 0.4 mm."""
    outline_clearance_m: MarginM = 0.005
    """Outlines yield to glints nearer than this [m]."""
    shadows: bool = True
    """Cut off what lies on lines of sight that the silhouettes show free."""
    max_contradicted: Share = 0.12
    """Silhouettes that show more of the glints' places free are dropped; good ones: up to 0.08."""

    def rim_weight_of(self, n_poses: int) -> float:
        """Weight of a glint of the rim, for a scan of so many planes."""
        return self.rim_weight if n_poses >= FEW_PLANES else 1.0

    def fits_of(self, n_poses: int) -> list[FitConfig]:
        """Fits whose mean is taken, for a scan of so many planes."""
        if n_poses >= FEW_PLANES:
            return [self.fit]
        scales = self.few_planes_voxel_scales
        return [replace(self.fit, spacing_m=scale * self.fit.spacing_m) for scale in scales]


class SelectedGlints(NamedTuple):
    """Glints and outlines that the fit reads."""

    linked: Glints
    """Glints of whole sub-apertures that are linked to a strong one."""
    rim: Glints
    """Glints of smaller sub-apertures at the rim that continue them."""
    silhouettes: Silhouettes | None = None
    """Outlines against the far walls, None if they were not searched for."""

    @property
    def seen(self) -> Glints:
        """All glints."""
        return self.linked.join(self.rim)

    def numbers(self) -> dict[str, int | str]:
        """How much of each there is, and why there are no outlines."""
        found: dict[str, int | str] = {"linked": len(self.linked), "rim": len(self.rim)}
        if self.silhouettes is not None:
            found["outlines"] = len(self.silhouettes)
            if reason := str(self.silhouettes.reason):
                found["no_outlines"] = reason
        return found


def select_glints(
    capture: Capture,
    prior: LosPrior,
    glints: Glints,
    config: RefineConfig | None = None,
    first: GlintConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SelectedGlints:
    """Drop glints without a link to a strong one, continue the others to the rim, find outlines.

    first: how `glints` were found. Other arguments as those of `find_rim_glints`.
    """
    config = config or RefineConfig()
    linked = glints
    with Workers(resolve_num_threads(num_threads)) as workers:
        outlines = workers.start(
            lambda: find_silhouettes(capture, config.silhouettes) if config.shadows else None
        )
        rim = find_rim_glints(
            capture,
            prior,
            linked,
            config.rim,
            first,
            num_threads=num_threads,
            progress=progress,
        )
        return SelectedGlints(linked, rim, outlines())


def uncontradicted(outlines: Silhouettes, seen: Glints, config: RefineConfig) -> Silhouettes:
    """Those whose free lines of sight do not pass through what was seen."""
    contradicted = outlines.free_distances(seen.positions) > config.outline_clearance_m
    return outlines.select(contradicted.mean(axis=1) <= config.max_contradicted)


def evidence_of(
    selected: SelectedGlints,
    n_poses: int,
    config: RefineConfig,
    found_with: GlintConfig | None = None,
    common_sigma_m: float = UNKNOWN_OFFSET_M,
) -> Evidence:
    """Gather what the refined surface is fitted to, without outlines that glints contradict.

    n_poses: planes of the scan. found_with: settings with which the glints were found.
    common_sigma_m: of the range offset that all glints share [m].
    """
    outlines = selected.silhouettes
    if outlines is not None:
        outlines = uncontradicted(outlines, selected.seen, config)
    return Evidence(
        glints=selected.linked,
        rim=selected.rim,
        rim_weight=config.rim_weight_of(n_poses),
        outlines=outlines,
        outline_weight=config.outline_weight,
        outline_clearance_m=config.outline_clearance_m,
        common_sigma_m=common_sigma_m,
        found_with=found_with or GlintConfig(),
    )


def fit_refined(
    selected: SelectedGlints,
    capture: Capture,
    prior: LosPrior,
    config: RefineConfig | None = None,
    found_with: GlintConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SdfGrid:
    """Signed distance of the content, the mean of fits on several voxels where planes are few.

    Each is drawn through the linked glints and those of the rim. Last, silhouettes cut
    (`cut_to_silhouettes`).

    selected: what `select_glints` found.
    capture, prior, num_threads, progress: as those of `fit_sdf`.
    config: which fits.
    found_with: settings with which the glints were found.
    """
    config, report = config or RefineConfig(), progress or (lambda _: None)
    fits = config.fits_of(len(capture.poses))
    n_threads = resolve_num_threads(num_threads)
    share = max(1, n_threads // len(fits))
    evidence = evidence_of(selected, len(capture.poses), config, found_with)
    outlines = evidence.outlines
    with Workers(min(n_threads, len(fits))) as workers:

        def draw(fit: FitConfig) -> SdfGrid:
            return fit_sdf(evidence, capture, prior, fit, num_threads=share)

        fields = workers.each(draw, fits, on_result=lambda n: report(n / len(fits)))
    sdf = mean_field(fields)
    if outlines is None:
        return sdf
    clearance_m = config.outline_clearance_m
    return cut_to_silhouettes(sdf, outlines, selected.seen, clearance_m, num_threads=num_threads)


def cut_to_silhouettes(
    sdf: SdfGrid,
    silhouettes: Silhouettes,
    seen: Glints,
    clearance_m: float,
    *,
    num_threads: int | None = None,
) -> SdfGrid:
    """Largest of a field and the distance to what silhouettes do not show free.

    That distance is less by what a place lacks of `clearance_m` to the nearest glint: a glint is
    the better witness where both differ by less.

    sdf: signed distance of the content.
    silhouettes: where lines of sight are free.
    seen: glints, at least one.
    clearance_m: distance to the nearest glint from which on silhouettes are believed as they are
        [m].
    """
    points = sdf.grid.points()
    free_m = silhouettes.free_distance(points)
    distance = nearest_distance(
        points, seen.positions, max_distance_m=clearance_m, num_threads=num_threads
    )
    values = np.maximum(sdf.values.ravel(), free_m - np.maximum(0.0, clearance_m - distance))
    return SdfGrid(grid=sdf.grid, values=values.reshape(sdf.grid.shape).astype(np.float32))


def mean_field(fields: Sequence[SdfGrid]) -> SdfGrid:
    """Mean of fields, on the grid of the first."""
    first = fields[0]
    if len(fields) == 1:
        return first
    points = first.grid.points()
    samples = np.stack([f.sample(points) for f in fields])
    values = samples.mean(axis=0)
    return SdfGrid(grid=first.grid, values=values.reshape(first.grid.shape).astype(np.float32))
