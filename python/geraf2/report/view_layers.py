"""Layers of the 3D view beside surfaces: faces of the box, and slices of volumes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Array, Floats
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.geometry.transforms import triple
from geraf2.io.array_layouts import read_arrays
from geraf2.scene import Grid

RANGE_DB = 30.0
"""Range of a heat map's colours, below its largest magnitude [dB]."""
_DISTANCE_MM = 20.0
_MAX_VOXELS = 48  # along a side: 0.15 MB in a page
_FACES = tuple(
    (f"{sign}{axis}", k, s) for k, axis in enumerate("xyz") for s, sign in enumerate("-+")
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Volume:
    """Values on a grid, shown as slices."""

    label: str
    """Name in the list."""
    grid: Grid
    """Positions of the values."""
    values: Array
    """At voxel centres, grid.shape."""
    unit: str
    limits: tuple[float, float]
    """Values at the ends of the colour map."""
    colour_map: str
    """Name of a colour map of matplotlib."""

    @property
    def is_signed(self) -> bool:
        """Whether zero lies between the limits; such a volume is shown opaque."""
        return self.limits[0] < 0.0 < self.limits[1]


@dataclass(frozen=True, kw_only=True)
class BoxFace:
    """A face of the box that the scan shows."""

    name: str
    """Direction from the middle of the box, as "+x"."""
    corners_m: Floats
    """In turn, (4, 3) [m]."""
    sigma_m: float | None
    """Standard deviation of its position; None where it was not seen [m]."""


def heat_map(volume: Array, grid: Grid) -> Volume:
    """Return a matched-filter image in decibels below its largest magnitude."""
    magnitude = np.abs(np.asarray(volume))
    relative = magnitude / max(float(magnitude.max(initial=0.0)), 1e-30)
    decibels = 20.0 * np.log10(np.maximum(relative, 1e-6))
    limits = (-RANGE_DB, 0.0)
    return Volume(
        label="heat map", grid=grid, values=decibels, unit="dB", limits=limits, colour_map="inferno"
    )


def signed_distance(sdf: SdfGrid) -> Volume:
    """Distance to the surface in millimetres, negative inside."""
    scale: dict[str, Any] = {"limits": (-_DISTANCE_MM, _DISTANCE_MM), "colour_map": "RdBu"}
    values = 1e3 * sdf.values
    return Volume(label="signed distance", grid=sdf.grid, values=values, unit="mm", **scale)


def read_heat_map(path: Path) -> Volume:
    """Heat map of an `image.npz`; UserError where it is none."""
    layouts = {"volume": "float x y z", "origin_m": "float 3", "spacing_m": "float"}
    stored = read_arrays(path, layouts)
    nx, ny, nz = stored["volume"].shape
    origin_m = triple(stored["origin_m"])
    try:
        grid = Grid(origin_m=origin_m, spacing_m=float(stored["spacing_m"]), shape=(nx, ny, nz))
    except ValueError as error:
        raise UserError(what=f"no volume on a grid: {error}", where=path) from None
    return heat_map(stored["volume"], grid)


def coarsen(volume: Volume) -> tuple[Array, Floats, float]:
    """Blocks of voxels, so that no side is longer than a page holds.

    The largest of a heat map, of which weak values are transparent; the mean of signed values.

    Returns the values, the position of the first one [m], and the spacing [m].
    """
    step = -(-max(volume.grid.shape) // _MAX_VOXELS)
    padding = [(0, -n % step) for n in volume.grid.shape]
    whole = np.pad(volume.values, padding, mode="edge")
    n = np.asarray(whole.shape) // step
    blocks = whole.reshape(n[0], step, n[1], step, n[2], step)
    origin = np.asarray(volume.grid.origin_m) + 0.5 * (step - 1) * volume.grid.spacing_m
    joined = blocks.mean(axis=(1, 3, 5)) if volume.is_signed else blocks.max(axis=(1, 3, 5))
    return joined, origin, step * volume.grid.spacing_m


def box_faces(numbers: Mapping[str, Any]) -> list[BoxFace]:
    """Faces of the box that the scan shows; none where it shows no box.

    numbers: of the stage `box` in run.json.
    """
    found = numbers.get("faces")
    if found is None or any(found.get(name, {}).get("offset_m") is None for name, _, _ in _FACES):
        return []
    axes = np.asarray(numbers["axes"], dtype=np.float64)
    normals = np.array([(2 * s - 1) * axes[k] for _, k, s in _FACES])
    offsets = np.array([found[name]["offset_m"] for name, *_ in _FACES])
    faces = []
    for number, (name, k, _) in enumerate(_FACES):
        first, second = (2 * axis for axis in range(3) if axis != k)
        planes = [[number, first + i, second + j] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
        corners = np.linalg.solve(normals[planes], offsets[planes][..., None])[..., 0]
        is_seen = found[name]["seen"] != "not"
        sigma = found[name].get("sigma_m") if is_seen else None
        faces.append(BoxFace(name=name, corners_m=corners, sigma_m=sigma))
    return faces
