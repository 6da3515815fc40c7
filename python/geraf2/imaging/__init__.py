"""Heat maps: matched-filter volumes, and images of small sub-apertures."""

from geraf2.imaging.subapertures import SubapertureConfig

__all__ = ["SubapertureConfig"]
