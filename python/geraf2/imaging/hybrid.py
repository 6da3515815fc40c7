"""Surface from glints that hang together and a second look, for `--preset hybrid`.

Each step and its worth: docs/method.md.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

from geraf2._validation import require_positive
from geraf2.imaging.fit import FitConfig
from geraf2.imaging.glint_set import Glints
from geraf2.imaging.glints import GlintConfig, Progress
from geraf2.imaging.links import FEW_PLANES, LinkConfig, linked_to_strong
from geraf2.imaging.rim import RimConfig, find_rim_glints
from geraf2.scene import Capture, LosPrior


@dataclass(frozen=True, kw_only=True)
class HybridConfig:
    """What the hybrid does after the glints were found as ever."""

    links: LinkConfig = field(default_factory=LinkConfig)
    """Which glints are kept."""
    rim: RimConfig = field(default_factory=RimConfig)
    """Second look from the rim of the apertures."""
    fit: FitConfig = field(
        default_factory=lambda: FitConfig(spacing_m=0.003, coarse_spacing_m=0.006)
    )
    """How the surface is drawn through both; on voxels that can hold what the second look adds."""
    few_planes_weight: float = 1.0
    """Weight of a glint of the second look with fewer than 12 planes, in place of the fit's own: it
    often is the only one at its place then. 0.2 loses 0.004."""

    def __post_init__(self) -> None:
        require_positive("few_planes_weight", self.few_planes_weight)

    def fit_of(self, n_poses: int) -> FitConfig:
        """Fit for a scan of so many planes."""
        if n_poses >= FEW_PLANES:
            return self.fit
        return replace(self.fit, more_weight=self.few_planes_weight)


class SecondLook(NamedTuple):
    """What the fit of the hybrid reads."""

    kept: Glints
    """Glints of whole sub-apertures that hang together."""
    rim: Glints
    """Glints of smaller ones at the rim that continue them."""


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
    """Drop glints that hang on to no strong one, and continue the rest to the rim.

    Arguments as those of `find_rim_glints`.
    """
    config = config or HybridConfig()
    kept = glints.select(linked_to_strong(glints, len(capture.poses), config.links))
    rim = find_rim_glints(
        capture, prior, kept, config.rim, look, num_threads=num_threads, progress=progress
    )
    return SecondLook(kept, rim)
