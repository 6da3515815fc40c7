"""From glints to the surface: linear signed-distance fit, isosurface, meshes, their confidence."""

from dataclasses import dataclass, field

from geraf2.glints import GlintConfig
from geraf2.surfaces.fit import FitConfig, fit_sdf


@dataclass(frozen=True, kw_only=True)
class ReconstructConfig:
    """Everything that a reconstruction from glints can be told."""

    glints: GlintConfig = field(default_factory=GlintConfig)
    """What counts as a glint."""
    fit: FitConfig = field(default_factory=FitConfig)
    """How the surface is drawn through the glints."""


__all__ = ["FitConfig", "ReconstructConfig", "fit_sdf"]
