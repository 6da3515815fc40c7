"""Evidence of the preset best: glints, those of rim sub-apertures, outlines on the far walls."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from geraf2._bounds import Bounded, MarginM, NotNegative, Share
from geraf2._types import Progress
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.echoes.glints import GlintConfig
from geraf2.echoes.rim import RimConfig, find_rim_glints
from geraf2.freespace.silhouettes import SilhouetteConfig, Silhouettes, find_silhouettes
from geraf2.ops._threads import resolve_num_threads
from geraf2.scene import Capture, LosPrior
from geraf2.surfaces.fit import UNKNOWN_OFFSET_M, Evidence, FitConfig
from geraf2.surfaces.workers import Workers

_MOST_DISAGREEMENT = 0.05
"""Share of the blocked lines that two sides of one correct outline do not agree on: up to 0.02 of
seven correct ones, 0.07 of an eighth; 0.04 to 0.20 of wrong ones."""
_LEAST_CONFIRMING = 20
"""Glints on lines of sight that an outline knows, at least."""
SELECTION_VERSION = 9
"""Raised when :func:`select_glints` finds something else in the same capture."""


@dataclass(frozen=True, kw_only=True)
class RefineConfig(Bounded):
    """What the preset best adds to the glints, and the fit through all."""

    rim: RimConfig = field(default_factory=RimConfig)
    """Glints of smaller sub-apertures at the rim."""
    silhouettes: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    """Outline of the content against the box's far walls."""
    fit: FitConfig = field(default_factory=lambda: FitConfig(spacing_m=0.003))
    """How the surface is drawn through all; on voxels that resolve what the rim adds."""
    rim_weight: NotNegative = 0.2
    """Weight of a glint of the rim, whose sub-aperture blurs echoes together, against one of whole
    sub-apertures."""
    outline_weight: NotNegative = 0.05
    """Weight of a point where the edge of an outline touches the surface, which errs by 2 mm,
    against a strong glint, which errs by 0.4 mm."""
    outline_clearance_m: MarginM = 0.005
    """Outlines yield to glints nearer than this [m]."""
    shadows: bool = True
    """Cut off what lies on lines of sight that the silhouettes show free."""
    max_contradicted: Share = 0.03
    """Outlines are dropped if more of the amplitude of glints on lines that they know lies where
    they show free space; half of it where planes on the opposite side do not show the same. Of 34
    outlines the correct ones have up to 0.025, wrong ones 0.02 to 0.7; one correct one with 0.019
    is lost, since its sides differ. Chosen on these."""


class SelectedGlints(NamedTuple):
    """Glints and outlines that the fit reads."""

    glints: Glints
    """Of whole sub-apertures."""
    rim: Glints
    """Of smaller sub-apertures at the rim that continue them."""
    silhouettes: Silhouettes | None = None
    """Outlines against the far walls, None if they were not searched for."""

    @property
    def seen(self) -> Glints:
        """All glints."""
        return self.glints.join(self.rim)

    def numbers(self) -> dict[str, int | str]:
        """How much of each there is, and why there are no outlines."""
        found: dict[str, int | str] = {"rim": len(self.rim)}
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
    """Continue glints to the rim of the apertures, and find outlines.

    first: how `glints` were found. Other arguments as those of `find_rim_glints`.
    """
    config = config or RefineConfig()
    with Workers(resolve_num_threads(num_threads)) as workers:
        outlines = workers.start(
            lambda: find_silhouettes(capture, config.silhouettes) if config.shadows else None
        )
        rim = find_rim_glints(
            capture,
            prior,
            glints,
            config.rim,
            first,
            num_threads=num_threads,
            progress=progress,
        )
        return SelectedGlints(glints, rim, outlines())


def uncontradicted(outlines: Silhouettes, seen: Glints, config: RefineConfig) -> Silhouettes:
    """Those whose free lines of sight do not pass through what was seen.

    Only glints on lines that an outline knows can confirm it: of a region without content, or of
    a wall that bulges too much, there are none. They count by amplitude and probability. Wrong
    outlines come from a wall's shape and position, which differ on the two sides of the box.
    """
    limit = np.where(outlines.disagreement > _MOST_DISAGREEMENT, 0.5, 1.0) * config.max_contradicted
    free_m = outlines.free_distances(seen.positions)
    known = np.isfinite(free_m) * seen.probability * relative_strengths(seen.strengths)
    wrong = (known * (free_m > config.outline_clearance_m)).sum(axis=1)
    confirmed = np.isfinite(free_m).sum(axis=1) >= _LEAST_CONFIRMING
    return outlines.select(confirmed & (wrong <= limit * known.sum(axis=1)))


def evidence_of(
    selected: SelectedGlints, config: RefineConfig, common_sigma_m: float = UNKNOWN_OFFSET_M
) -> Evidence:
    """Gather what the refined surface is fitted to, without outlines that glints contradict.

    common_sigma_m: of the range offset that all glints share [m].
    """
    outlines = selected.silhouettes
    if outlines is not None:
        outlines = uncontradicted(outlines, selected.seen, config)
    return Evidence(
        glints=selected.glints,
        rim=selected.rim,
        rim_weight=config.rim_weight,
        outlines=outlines,
        outline_weight=config.outline_weight,
        outline_clearance_m=config.outline_clearance_m,
        common_sigma_m=common_sigma_m,
    )
