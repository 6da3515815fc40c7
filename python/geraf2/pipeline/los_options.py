"""Options for photos and meshes of the box, of all jobs that read them."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from geraf2._bounds import Arg, Bounded, CountOrZero, Seed
from geraf2.errors import UserError
from geraf2.io.photo_files import UNITS_M
from geraf2.io.transform_file import read_transform

Bounds = tuple[float, float, float, float, float, float]
CameraAxes = Literal["format", "opencv", "opengl"]
PhotoPreset = Literal["quick", "default"]


@dataclass(frozen=True, kw_only=True)
class LosOptions(Bounded):
    """Options for reading photos of the box, and for the surface trained on them."""

    unit: str | None = None
    """Unit of the poses: m, cm, mm, or its length in metres. By default the source's, else m."""
    to_radar: Path | None = None
    """Transform from the poses' frame to the capture's: a file with a 4 x 4 matrix (text, JSON,
    npy; in metres, with a scale if needed), or a scene calibrated with this prior."""
    camera_axes: CameraAxes = "format"
    """Camera axes of the poses, if they differ from those of their format."""
    masks: Path | None = None
    """Folder of masks with the names of the photos, bright inside the box."""
    mask_threshold: Annotated[float, Interval(ge=0.0, lt=255.0)] | None = None
    """Or: largest brightness of the background, 0 to 255."""
    bounds: Bounds | None = None
    """Coordinates x0 y0 z0 x1 y1 z1 of the capture frame around the box [m]; `-inf` and `inf` leave
    a side open. The rest is cut off, for example the table below z0."""
    preset: PhotoPreset = "default"
    """Grids of the training: fine ones (minutes), or coarse ones for a first look (quick)."""
    hold_out: CountOrZero = 0
    """Exclude every N-th photo from the training and compare it with the surface; 0: none."""
    seed: Annotated[Seed, Arg(hidden=True)] = 0
    """Seed of the training."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.unit is not None:
            _unit_length_m(self.unit)
        self.limits()

    def placement(self) -> tuple[NDArray[np.float64] | None, float | None]:
        """Transform to the capture frame, None if it is the same, and the unit before it [m].

        The unit is None where the source states it.
        """
        unit_m = None if self.unit is None else _unit_length_m(self.unit)
        if self.to_radar is None:
            return None, unit_m
        rigid, scale = read_transform(self.to_radar)
        return rigid, unit_m if scale == 1.0 else scale * (unit_m or 1.0)

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


def _unit_length_m(unit: str) -> float:
    """Length of a unit, which is a name or a number of metres [m]."""
    try:
        value = UNITS_M[unit] if unit in UNITS_M else float(unit)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise UserError(
            what="--unit must be m, cm, mm or a positive number of metres", got=repr(unit)
        )
    return value
