"""Visual hull of the silhouettes: region and first signed distance."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from geraf2._types import Bools, Floats, Floats32
from geraf2._validation import require_positive
from geraf2.apps.photos.formats.masks import close_cracks
from geraf2.apps.photos.grid_smoothing import steps_to_outline
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.scene import Grid
from geraf2.scene.photos import Camera, PhotoSet

_CHUNK = 1 << 16
_UNSEEN_M = -1e6
"""Distance assigned by a photo to a point outside of its picture: no constraint."""
_REGION_VOXELS = 64
"""Voxels along a side of the cube in which the hull is searched."""
_VIEWS_PER_MISTAKE = 100
"""Silhouettes of which one may be wrong at a point."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """Upright box in which the surface lies."""

    low_m: tuple[float, float, float]
    """Smallest coordinates [m]."""
    high_m: tuple[float, float, float]
    """Largest coordinates [m]."""

    def __post_init__(self) -> None:
        for name in ("low_m", "high_m"):
            # plain numbers: a tensor of NumPy's would be of double precision
            object.__setattr__(self, name, triple(getattr(self, name)))
        for axis, side in zip("xyz", self.sides_m, strict=True):
            require_positive(f"side along {axis} of the region", side)

    @classmethod
    def from_corners(cls, low: Floats, high: Floats) -> "Region":
        """Region of its smallest and largest coordinates, (3,) each [m]."""
        return cls(low_m=tuple(low), high_m=tuple(high))

    @property
    def center_m(self) -> tuple[float, float, float]:
        """Middle [m]."""
        return triple(0.5 * (a + b) for a, b in zip(self.low_m, self.high_m, strict=True))

    @property
    def sides_m(self) -> tuple[float, float, float]:
        """Lengths of the sides [m]."""
        return triple(b - a for a, b in zip(self.low_m, self.high_m, strict=True))

    @property
    def radius_m(self) -> float:
        """Half of the diagonal [m]."""
        return 0.5 * float(np.linalg.norm(self.sides_m))

    def grid(self, n_longest: int) -> Grid:
        """Grid over the box, with so many voxels along its longest side."""
        sides = np.subtract(self.high_m, self.low_m)
        spacing = float(sides.max()) / (n_longest - 1)
        shape = np.maximum(np.ceil(sides / spacing - 1e-6).astype(int) + 1, 4)
        return Grid.centered(self.center_m, spacing, shape)


class VisualHull:
    """Signed distance to the largest body that fits all silhouettes.

    The silhouette of a photo gives each point at depth z its signed distance to the outline in the
    picture, times z over the focal length; the hull is their maximum (positive outside), less the
    largest of each 100. Points that most photos do not show are outside. Baumgart 1974; Laurentini,
    The visual hull concept, 1994.
    """

    def __init__(self, photos: PhotoSet) -> None:
        if photos.masks is None:
            msg = "photos must have masks for a visual hull, got none"
            raise ValueError(msg)
        self._cameras = photos.cameras
        self._distances = [silhouette_distance(close_cracks(mask)) for mask in photos.masks]
        self._rank = len(photos) - 1 - len(photos) // _VIEWS_PER_MISTAKE

    def distance(self, points: Floats) -> Floats32:
        """Signed distance at points (n, 3) [m], (n,) [m]."""
        parts = np.array_split(points, range(_CHUNK, len(points), _CHUNK))
        return np.concatenate([self._distance(part) for part in parts])

    def _distance(self, points: Floats) -> Floats32:
        pairs = zip(self._cameras, self._distances, strict=True)
        left = np.stack([_outline_distance(*pair, points) for pair in pairs])
        hull = np.partition(left, self._rank, axis=0)[self._rank]
        # Points that most photos do not show are no part of the body.
        seldom = 2 * np.count_nonzero(left > _UNSEEN_M, axis=0) < len(self._cameras)
        return np.asarray(np.where(seldom, np.abs(hull), hull))


def _outline_distance(camera: Camera, distance: Floats32, points: Floats) -> Floats32:
    pixels = camera.project(points)
    shown = camera.contains(pixels)
    depth = (points[shown] - camera.position) @ camera.view_direction
    focal = 0.5 * (camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    positions = pixels[shown, ::-1].T - 0.5
    found = ndimage.map_coordinates(distance, positions, order=1, mode="nearest")
    left = np.full(points.shape[0], _UNSEEN_M, dtype=np.float32)
    left[shown] = found * depth / focal
    return left


def silhouette_distance(mask: Bools) -> Floats32:
    """Distance of pixels' middles from the outline, negative inside, (height, width) [pixel]."""
    size = float(max(mask.shape))
    if mask.all() or not mask.any():
        return np.full(mask.shape, -size if mask.any() else size, dtype=np.float32)
    return steps_to_outline(mask).astype(np.float32)


def find_region(photos: PhotoSet, hull: VisualHull) -> Region:
    """Box around the hull.

    UserError where the silhouettes have no common body.
    """
    focus = photos.focus()
    assert photos.masks is not None
    half = max(
        _mask_radius(camera, mask, focus)
        for camera, mask in zip(photos.cameras, photos.masks, strict=True)
    )
    if half <= 0.0:
        raise UserError(what="all masks are empty", expected="an object in some of the photos")
    low, high = focus - half, focus + half
    # twice: the second time in the box that the first has found, with smaller voxels
    for _ in range(2):
        grid = Region.from_corners(low, high).grid(_REGION_VOXELS)
        inside = hull.distance(grid.points()).reshape(grid.shape) < grid.spacing_m
        if not inside.any():
            raise UserError(
                what="the silhouettes of the photos have no common body",
                expected="poses in which all photos show the same object",
                hint="check frame, unit and handedness of the poses, and the masks",
            )
        found = np.argwhere(inside)
        low = np.asarray(grid.origin_m) + grid.spacing_m * (found.min(axis=0) - 1.5)
        high = np.asarray(grid.origin_m) + grid.spacing_m * (found.max(axis=0) + 1.5)
    return Region.from_corners(low, high)


def _mask_radius(camera: Camera, mask: Bools, focus: Floats) -> float:
    """Distance from the focus to the farthest ray through the mask [m]."""
    edge = mask & ~ndimage.binary_erosion(mask)
    pixels = np.argwhere(edge)[:, ::-1] + 0.5
    if pixels.shape[0] == 0:
        return 0.0
    origins, directions = camera.rays(pixels)
    return float(np.linalg.norm(np.cross(directions, focus - origins), axis=1).max())
