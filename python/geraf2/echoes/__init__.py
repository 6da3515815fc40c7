"""Specular returns as oriented points (glints), and their labels."""

from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig, find_glints

__all__ = ["GlintConfig", "Glints", "find_glints"]
