"""Specular echoes as oriented points, and what else a scan shows of the surface: silhouettes."""

from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig, find_glints

__all__ = ["GlintConfig", "Glints", "find_glints"]
