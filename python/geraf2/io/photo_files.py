"""Files of a photo set that geraf2 writes: PNG images and nerfstudio's `transforms.json`."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from geraf2._types import Floats
from geraf2._validation import require_shape
from geraf2.geometry.transforms import OPENGL_TO_OPENCV
from geraf2.io.atomic import atomic_path, write_json_atomic

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


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a PNG (height, width, 3) or (height, width), whole or not at all."""
    with atomic_path(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")


def write_transforms(path: Path, records: Sequence[PhotoRecord], *, frame: str) -> None:
    """Write records in metres as a transforms.json; images are named relative to it."""
    if not records:
        msg = "records must hold at least one photo, got none"
        raise ValueError(msg)
    common = _intrinsics_of(records[0])
    same = all(_intrinsics_of(record) == common for record in records)
    frames = []
    for record in records:
        entry: dict[str, Any] = {"file_path": record.path.relative_to(path.parent).as_posix()}
        if record.mask_path is not None:
            entry["mask_path"] = record.mask_path.relative_to(path.parent).as_posix()
        if not same:
            entry |= _intrinsics_of(record)
        entry["transform_matrix"] = (record.camera_to_world @ OPENGL_TO_OPENCV).tolist()
        frames.append(entry)
    head: dict[str, Any] = {"camera_model": "OPENCV", "unit": "m", "frame": frame}
    write_json_atomic(path, head | (common if same else {}) | {"frames": frames})


def _intrinsics_of(record: PhotoRecord) -> dict[str, float | int]:
    k = record.intrinsics
    size = {} if record.size is None else {"w": record.size[0], "h": record.size[1]}
    names = dict(zip(DISTORTION, (float(v) for v in record.distortion), strict=True))
    focal = {"fl_x": float(k[0, 0]), "fl_y": float(k[1, 1])}
    return size | focal | {"cx": float(k[0, 2]), "cy": float(k[1, 2])} | names
