"""Heat maps and glints."""

from geraf2.imaging.glint_set import Glints
from geraf2.imaging.glints import GlintConfig, find_glints
from geraf2.imaging.subapertures import SubapertureConfig

__all__ = ["GlintConfig", "Glints", "SubapertureConfig", "find_glints"]
