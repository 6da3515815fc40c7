"""What every reader of a photo set returns: one record a photo, in one convention."""

from dataclasses import dataclass
from pathlib import Path

from geraf2._types import Floats
from geraf2._validation import require_shape

N_DISTORTION = 5
"""Coefficients k1, k2, p1, p2, k3, in the order of OpenCV."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoRecord:
    """One photo and its camera; the image itself is not read yet.

    Image coordinates have the middle of the upper left pixel at (0.5, 0.5), as those of COLMAP and
    nerfstudio; readers of formats that put it at (0, 0) add the half.
    """

    name: str
    """Name of the photo in its set."""
    path: Path
    """Image file; it may be missing."""
    intrinsics: Floats
    """Upper triangular matrix K of focal lengths, skew and principal point, (3, 3) [pixel]."""
    camera_to_world: Floats
    """Rigid transform from camera axes x right, y down, z forward, (4, 4) [source's unit]."""
    distortion: Floats
    """k1, k2, p1, p2, k3 of the Brown model, (5,)."""
    size: tuple[int, int] | None = None
    """Width and height that the intrinsics are of [pixel]; None: those of the image."""
    mask_path: Path | None = None
    """Mask that the source names, bright where the object is."""

    def __post_init__(self) -> None:
        require_shape("intrinsics", self.intrinsics, (3, 3))
        require_shape("camera_to_world", self.camera_to_world, (4, 4))
        require_shape("distortion", self.distortion, (N_DISTORTION,))


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoSource:
    """A photo set as a reader found it, images not yet read."""

    format: str
    """Name of the format."""
    records: tuple[PhotoRecord, ...]
    """One a photo, in the source's order."""
    unit_m: float | None = None
    """Length of the source's unit, where the source says it [m]."""
    frame: str | None = None
    """Name of the frame of the poses, where the source says it."""
    notes: tuple[str, ...] = ()
    """What the user should know."""
