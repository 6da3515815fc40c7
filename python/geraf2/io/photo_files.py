"""Photos as files of other programs name them."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2._validation import require_shape

TRANSFORMS_NAME = "transforms.json"
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Units that can be named, in metres."""
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
"""Names of the lens coefficients in `transforms.json`, in the order of OpenCV."""
N_DISTORTION = 5
"""Coefficients k1, k2, p1, p2, k3, in the order of OpenCV."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoRecord:
    """One photo and its camera; the image itself is not read yet.

    Image coordinates have the middle of the upper left pixel at (0.5, 0.5), as those of COLMAP and
    nerfstudio.
    """

    name: str
    """Name of the photo in its set."""
    path: Path
    """Image file; it may be missing."""
    intrinsics: Floats
    """Upper triangular matrix K of focal lengths, skew and principal point, (3, 3) [pixel]."""
    camera_to_world: Floats
    """Rigid transform from camera axes x right, y down, z forward, (4, 4) [source's unit]."""
    distortion: Floats = field(default_factory=lambda: np.zeros(N_DISTORTION))
    """k1, k2, p1, p2, k3 of the Brown model, (5,)."""
    size: tuple[int, int] | None = None
    """Width and height that the intrinsics are of [pixel]; None: those of the image."""
    mask_path: Path | None = None
    """Mask that the source names, bright where the object is."""

    def __post_init__(self) -> None:
        require_shape("intrinsics", self.intrinsics, (3, 3))
        require_shape("camera_to_world", self.camera_to_world, (4, 4))
        require_shape("distortion", self.distortion, (N_DISTORTION,))
