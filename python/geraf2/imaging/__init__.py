"""Heat maps, glints, and the linear signed-distance fit."""

from dataclasses import dataclass, field

from geraf2.imaging.fit import FitConfig, fit_sdf
from geraf2.imaging.glint_set import Glints
from geraf2.imaging.glints import GlintConfig, find_glints
from geraf2.imaging.subapertures import SubapertureConfig


@dataclass(frozen=True, kw_only=True)
class ReconstructConfig:
    """Everything that a reconstruction from glints can be told."""

    glints: GlintConfig = field(default_factory=GlintConfig)
    """What counts as a glint."""
    fit: FitConfig = field(default_factory=FitConfig)
    """How the surface is drawn through the glints."""


__all__ = [
    "FitConfig",
    "GlintConfig",
    "Glints",
    "ReconstructConfig",
    "SubapertureConfig",
    "find_glints",
    "fit_sdf",
]
