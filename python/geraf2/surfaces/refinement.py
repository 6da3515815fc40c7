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
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Capture, LosPrior
from geraf2.surfaces.fit import UNKNOWN_OFFSET_M, Evidence, FitConfig
from geraf2.surfaces.workers import Workers

SELECTION_VERSION = 10
"""Increase when :func:`select_glints` returns something else for the same capture."""


@dataclass(frozen=True, kw_only=True)
class RefineConfig(Bounded):
    """Settings of the evidence that the preset best adds, and of the fit to all evidence."""

    rim: RimConfig = field(default_factory=RimConfig)
    """Glints of smaller rim sub-apertures."""
    silhouettes: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    """Silhouettes of the content against the box's far walls."""
    fit: FitConfig = field(default_factory=lambda: FitConfig(spacing_m=0.003))
    """Fit to all evidence, on voxels that resolve the details of rim glints."""
    rim_weight: NotNegative = 0.2
    """Weight of a rim glint, in whose small sub-aperture echoes merge, relative to one of a whole
    sub-aperture."""
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


class SelectedGlints(NamedTuple):
    """Glints and outlines of the fit."""

    glints: Glints
    """Glints of whole sub-apertures."""
    rim: Glints
    """Glints of smaller rim sub-apertures that continue them."""
    silhouettes: Silhouettes | None = None
    """Silhouettes against the far walls; None if they were not searched for."""

    @property
    def seen(self) -> Glints:
        """All glints, rim glints last."""
        return self.glints.join(self.rim)

    def numbers(self) -> dict[str, int | str]:
        """Count rim glints and outlines, and state why there are no outlines."""
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
    kept: KeptPeaks | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SelectedGlints:
    """Find rim glints that continue the given ones, and outlines.

    first: settings that found `glints`. kept: peaks of the capture's planes.
    Other arguments as those of `find_rim_glints`.
    """
    config = config or RefineConfig()
    with Workers(num_threads) as workers:
        outlines = workers.start(
            lambda: find_silhouettes(capture, config.silhouettes) if config.shadows else None
        )
        rim = find_rim_glints(
            capture,
            prior,
            glints,
            config.rim,
            first,
            kept=kept,
            num_threads=num_threads,
            progress=progress,
        )
        return SelectedGlints(glints, rim, outlines())


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
    selected: SelectedGlints, config: RefineConfig, common_sigma_m: float = UNKNOWN_OFFSET_M
) -> Evidence:
    """Gather the data of the refined fit, without outlines that glints contradict.

    common_sigma_m: standard deviation of the range offset that all glints share [m].
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
