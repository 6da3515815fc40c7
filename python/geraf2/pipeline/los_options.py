"""Flags that say how a photo set is meant, for all commands that read one."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from numpy.typing import NDArray

from geraf2.errors import UserError
from geraf2.io.photos.transforms import UNITS_M
from geraf2.io.transform_file import read_transform
from geraf2.scene.photo_store import CameraAxes, PhotoOptions

PhotoPreset = Literal["quick", "default", "paper"]
Bounds = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class PhotoFlags:
    """How photos of the box are read, and a surface is made of them."""

    unit: str | None = None
    """Unit of the poses: m, cm, mm, or how many metres it is; that of the source, else metres."""
    to_radar: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Transform from the frame of the poses into the capture's: a 4 x 4 matrix (text, JSON, npy;
    in metres, with a scale if need be), or a scene that was calibrated with this prior."""
    camera_axes: CameraAxes = "format"
    """Camera axes of the poses, where they are not those of their format."""
    masks: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Silhouettes of the box named as the photos, bright where the box is."""
    mask_threshold: float | None = None
    """Or: the background is at most this bright, 0 to 255."""
    bounds: Annotated[Bounds | None, tyro.conf.arg(metavar="X0 Y0 Z0 X1 Y1 Z1")] = None
    """The box lies between these coordinates of the capture frame; `-inf` and `inf` leave a side
    open. What is outside is cut off, e.g. the table below Z0 [m]."""
    preset: PhotoPreset = "default"
    """What is trained: a grid (minutes), a coarser one (quick), or the paper's networks (days)."""
    hold_out: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Leave every N-th photo out of the training and compare it with the surface; 0: none."""
    keep_surface: bool = False
    """Keep the trained surface with its colours, too (surface.safetensors, some 100 MB), which
    `geraf2.photos.neural_surface.NeuralSurface.load` reads and renders."""
    seed: int = 0
    """Seed of the training."""

    def options(self) -> PhotoOptions:
        """Options of :func:`geraf2.scene.photo_store.load_photos`."""
        rigid, scale = self.transform()
        unit_m = self.unit_m()
        if scale != 1.0:
            unit_m = scale * (1.0 if unit_m is None else unit_m)
        if self.mask_threshold is not None and not 0.0 <= self.mask_threshold < 255.0:
            raise UserError(
                what="--mask-threshold must be at least 0 and below 255", got=self.mask_threshold
            )
        if self.mask_threshold is not None and self.masks is not None:
            raise UserError(what="give either --masks or --mask-threshold", got="both")
        if self.masks is not None and not self.masks.is_dir():
            raise UserError(what="--masks must be a folder", got=self.masks)
        bounds = self.limits()
        return PhotoOptions(
            unit_m=unit_m,
            to_capture=rigid,
            camera_axes=self.camera_axes,
            mask_folder=self.masks,
            mask_threshold=self.mask_threshold,
            bounds=bounds if bounds is not None and np.isfinite(bounds).all() else None,
        )

    def unit_m(self) -> float | None:
        """Length of the unit [m]; None where the flag is not given."""
        if self.unit is None:
            return None
        if self.unit in UNITS_M:
            return UNITS_M[self.unit]
        try:
            value = float(self.unit)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0.0):
            raise UserError(
                what="--unit must be m, cm, mm or a positive number of metres", got=repr(self.unit)
            )
        return value

    def transform(self) -> tuple[NDArray[np.float64] | None, float]:
        """Rigid transform into the capture frame, None if the same, and a scale before it."""
        return (None, 1.0) if self.to_radar is None else read_transform(self.to_radar)

    def limits(self) -> NDArray[np.float64] | None:
        """--bounds as smallest and largest coordinates, (2, 3) [m]."""
        if self.bounds is None:
            return None
        limits = np.array(self.bounds, dtype=np.float64).reshape(2, 3)
        if np.isnan(limits).any() or not (limits[0] < limits[1]).all():
            raise UserError(
                what="--bounds must be the smaller corner, then the larger one",
                got=" ".join(f"{value:g}" for value in self.bounds),
            )
        return limits


def parse_box(text: str) -> tuple[float, float, float] | None:
    """Side lengths of a text like 0.22x0.22x0.3; None for any other text."""
    if not re.fullmatch(r"[0-9.eE+-]+(x[0-9.eE+-]+){2}", text):
        return None
    try:
        x, y, z = (float(part) for part in text.split("x"))
    except ValueError:
        return None
    return x, y, z
