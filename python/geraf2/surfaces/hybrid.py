"""Surface from glints that hang together and a second look, for `--preset best`.

A fit decides in places whether a surface is there, and small things, the size of its voxels or a
few glints that hang on to no other, turn such decisions: the hybrid is the mean of several fits.
What the content's shadow on the far walls shows to be free is cut off at last.

Each step and its worth: docs/method.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, LengthM, MarginM, Positive, Share
from geraf2._types import Progress
from geraf2.fields import SdfGrid
from geraf2.geometry.nearest import nearest_distance
from geraf2.glints.glint_set import Glints
from geraf2.glints.glints import GlintConfig
from geraf2.glints.links import CLUTTER, FEW_PLANES, LinkConfig, linked_to_strong
from geraf2.glints.rim import RimConfig, find_rim_glints
from geraf2.glints.silhouettes import SilhouetteConfig, Silhouettes, find_silhouettes
from geraf2.ops._threads import resolve_num_threads
from geraf2.scene import Capture, LosPrior
from geraf2.surfaces.fit import FitConfig, continue_unseen, fit_sdf
from geraf2.surfaces.workers import Workers

SECOND_LOOK_VERSION = 4
"""Raised when :func:`look_again` finds something else in the same capture."""


@dataclass(frozen=True, kw_only=True)
class HybridConfig(Bounded):
    """What the hybrid does after the glints were found as ever."""

    links: LinkConfig = field(default_factory=LinkConfig)
    """Which glints are kept."""
    rim: RimConfig = field(default_factory=RimConfig)
    """Second look from the rim of the apertures."""
    silhouettes: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    """Outline of the content against the box's far walls."""
    fit: FitConfig = field(
        default_factory=lambda: FitConfig(spacing_m=0.003, coarse_spacing_m=0.006)
    )
    """How the surface is drawn through both; on voxels that can hold what the second look adds."""
    voxel_scales: Annotated[tuple[Annotated[float, Interval(ge=0.1, le=10.0)], ...], MinLen(1)] = (
        1.0,
        4.0 / 3.0,
    )
    """Voxels of the fits whose mean is taken, in units of the fit's own."""
    few_planes_voxel_scales: Annotated[
        tuple[Annotated[float, Interval(ge=0.1, le=10.0)], ...], MinLen(1)
    ] = (1.0, 7.0 / 6.0, 4.0 / 3.0)
    """The same with fewer than 12 planes."""
    plain_share: Share = 1.0
    """Share of fits to the first glints alone, near these; with 12 planes or more."""
    plain_near_m: MarginM = 0.004
    """The nearest first glint is this near there [m] ..."""
    plain_far_m: LengthM = 0.010
    """... and from here on they have no share [m]."""
    clutter: Share = CLUTTER
    """Among scatterers, where more of the first glints are unlinked, only linked ones are fitted
    to."""
    shadows: bool = True
    """Cut off what lies on lines of sight that the silhouettes show free."""
    shadow_clearance_m: MarginM = 0.005
    """From this far from glints on they are believed, at one off by as much [m]: they err by 2
    mm."""
    max_contradicted: Share = 0.12
    """Silhouettes that show more of the glints' places free are dropped; good ones: up to 0.08."""
    few_planes_weight: Positive = 1.0
    """Weight of a second-look glint with fewer than 12 planes, often the only one at its place."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.plain_near_m < self.plain_far_m:
            msg = f"plain_near_m must be below plain_far_m, got {self.plain_near_m}"
            raise ValueError(msg)

    def fits_of(self, n_poses: int) -> list[FitConfig]:
        """Fits whose mean is taken, for a scan of so many planes."""
        scales, weight = self.voxel_scales, self.fit.more_weight
        if n_poses < FEW_PLANES:
            scales, weight = self.few_planes_voxel_scales, self.few_planes_weight
        return [
            replace(
                self.fit,
                spacing_m=scale * self.fit.spacing_m,
                coarse_spacing_m=scale * self.fit.coarse_spacing_m,
                more_weight=weight,
            )
            for scale in scales
        ]


class SecondLook(NamedTuple):
    """What the fit of the hybrid reads."""

    kept: Glints
    """Glints of whole sub-apertures that hang together."""
    rim: Glints
    """Glints of smaller ones at the rim that continue them."""
    silhouettes: Silhouettes | None = None
    """Outlines against the far walls, None if they were not looked for."""

    @property
    def seen(self) -> Glints:
        """All glints."""
        return self.kept.join(self.rim)

    def numbers(self) -> dict[str, int | str]:
        """How much of each there is, and why there are no outlines."""
        found: dict[str, int | str] = {"kept": len(self.kept), "rim": len(self.rim)}
        if self.silhouettes is not None:
            found["outlines"] = len(self.silhouettes)
            if reason := str(self.silhouettes.reason):
                found["no_outlines"] = reason
        return found


def look_again(
    capture: Capture,
    prior: LosPrior,
    glints: Glints,
    config: HybridConfig | None = None,
    look: GlintConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SecondLook:
    """Drop glints that hang on to no strong one, continue the rest to the rim, find silhouettes.

    Arguments as those of `find_rim_glints`.
    """
    config = config or HybridConfig()
    kept = glints.select(linked_to_strong(glints, len(capture.poses), config.links))
    with Workers(resolve_num_threads(num_threads)) as workers:
        outlines = workers.start(
            lambda: find_silhouettes(capture, config.silhouettes) if config.shadows else None
        )
        rim = find_rim_glints(
            capture, prior, kept, config.rim, look, num_threads=num_threads, progress=progress
        )
        return SecondLook(kept, rim, outlines())


def uncontradicted(outlines: Silhouettes, seen: Glints, config: HybridConfig) -> Silhouettes:
    """Those whose free lines of sight do not pass through what was seen."""
    contradicted = outlines.free_distances(seen.positions) > config.shadow_clearance_m
    return outlines.select(contradicted.mean(axis=1) <= config.max_contradicted)


def fit_hybrid(
    glints: Glints,
    look: SecondLook,
    capture: Capture,
    prior: LosPrior,
    config: HybridConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SdfGrid:
    """Signed distance of the content, the mean of several fits.

    Mean of fits to the kept glints and those of the second look. With 12 planes and more and
    without scatterers, as many fits to all first glints and the second look join the mean, and
    fits to the first glints alone take its place near these: there they are enough, and the second
    look, of smaller sub-apertures, is less sharp. At last silhouettes cut (`cut_to_silhouettes`).

    glints: all of whole sub-apertures.
    look: what `look_again` made of them.
    capture, prior, num_threads, progress: as those of `fit_sdf`.
    config: which fits.
    """
    config, report = config or HybridConfig(), progress or (lambda _: None)
    unlinked = 1.0 - len(look.kept) / len(glints)
    is_clean = len(capture.poses) >= FEW_PLANES and unlinked <= config.clutter
    points: list[tuple[Glints, Glints | None]] = [(look.kept, look.rim)]
    if is_clean and unlinked > 0.0:
        points.append((glints, look.rim))
    n_mean = len(points)
    if is_clean and config.plain_share > 0.0:
        points.append((glints, None))
    fits = config.fits_of(len(capture.poses))
    jobs = [(first, more, fit) for first, more in points for fit in fits]
    n_threads = resolve_num_threads(num_threads)
    share = max(1, n_threads // len(jobs))
    with Workers(min(n_threads, len(jobs))) as workers:
        # Of glints alone, and those of the first and the last points are the same.
        firsts = {id(first): first for first, _ in points}
        found = workers.each(
            lambda first: continue_unseen(first, capture, config.fit), firsts.values()
        )
        unseen = dict(zip(firsts, found, strict=True))

        def draw(first: Glints, more: Glints | None, fit: FitConfig) -> SdfGrid:
            known = unseen[id(first)]
            return fit_sdf(first, capture, prior, fit, num_threads=share, more=more, unseen=known)

        fields = workers.each(
            draw, *zip(*jobs, strict=True), on_result=lambda n: report(n / len(jobs))
        )
    sdf = mean_field(fields[: n_mean * len(fits)])
    plain = fields[n_mean * len(fits) :]
    if plain:
        sdf = _with_share(sdf, mean_field(plain), look.kept, config, num_threads)
    if look.silhouettes is None:
        return sdf
    seen = look.seen
    outlines = uncontradicted(look.silhouettes, seen, config)
    return cut_to_silhouettes(
        sdf, outlines, seen, config.shadow_clearance_m, num_threads=num_threads
    )


def _with_share(
    mean: SdfGrid, plain: SdfGrid, near: Glints, config: HybridConfig, num_threads: int | None
) -> SdfGrid:
    """Mean in which another field has `plain_share` near some glints."""
    points = mean.grid.points()
    near_m, far_m = config.plain_near_m, config.plain_far_m
    distance = nearest_distance(
        points, near.positions, max_distance_m=far_m, num_threads=num_threads
    )
    share = config.plain_share * np.clip((far_m - distance) / (far_m - near_m), 0.0, 1.0)
    values = (1.0 - share) * mean.values.ravel() + share * plain.sample(points)
    return SdfGrid(grid=mean.grid, values=values.reshape(mean.grid.shape).astype(np.float32))


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
