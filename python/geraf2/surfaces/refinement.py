"""Evidence of the preset best: glints, and outlines on the far walls."""

from dataclasses import dataclass, field

import numpy as np

from geraf2._bounds import Bounded, MarginM, NotNegative, Share
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.freespace.silhouettes import SilhouetteConfig, Silhouettes
from geraf2.surfaces.fit import UNKNOWN_OFFSET_M, Evidence, FitConfig


@dataclass(frozen=True, kw_only=True)
class RefineConfig(Bounded):
    """Settings of the evidence that the preset best adds, and of the fit to all evidence."""

    silhouettes: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    """Silhouettes of the content against the box's far walls."""
    fit: FitConfig = field(default_factory=lambda: FitConfig(spacing_m=0.003))
    """Fit to all evidence."""
    outline_weight: NotNegative = 0.05
    """Weight of an outline's tangent point, with an error of 2 mm, relative to a strong glint, with
    an error of 0.4 mm."""
    outline_clearance_m: MarginM = 0.005
    """Distance within which glints override outlines [m]."""
    shadows: bool = True
    """Whether to remove content on lines of sight that silhouettes show free."""
    max_contradicted: Share = 0.03
    """Largest share of the amplitude of glints on an outline's known lines of sight that lies in
    its free space. Other outlines are dropped. A property of the population of objects."""


def uncontradicted(outlines: Silhouettes, seen: Glints, config: RefineConfig) -> Silhouettes:
    """Select the outlines whose free lines of sight do not cross glints.

    Glints on the known lines of sight confirm an outline; a region without content has none. They
    count by amplitude and probability.
    """
    free_m = outlines.free_distances(seen.positions)
    known = np.isfinite(free_m) * seen.probability * relative_strengths(seen.strengths)
    wrong = (known * (free_m > config.outline_clearance_m)).sum(axis=1)
    return outlines.select(wrong < config.max_contradicted * known.sum(axis=1))


def evidence_of(
    glints: Glints,
    outlines: Silhouettes | None,
    config: RefineConfig,
    common_sigma_m: float = UNKNOWN_OFFSET_M,
) -> Evidence:
    """Gather the data of the refined fit, without outlines that glints contradict.

    outlines: against the far walls; None if they were not searched for.
    common_sigma_m: standard deviation of the range offset that all glints share [m].
    """
    if outlines is not None:
        outlines = uncontradicted(outlines, glints, config)
    return Evidence(
        glints=glints,
        outlines=outlines,
        outline_weight=config.outline_weight,
        outline_clearance_m=config.outline_clearance_m,
        common_sigma_m=common_sigma_m,
    )
