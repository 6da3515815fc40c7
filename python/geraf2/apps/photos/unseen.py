"""Parts of a surface that no photo shows, closed by a surface of least area."""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from geraf2._types import Bools, Floats
from geraf2.apps.photos.grid_smoothing import binomial_blur, quick_redistance
from geraf2.ops import sdf_grid
from geraf2.scene import Grid
from geraf2.scene.photos import Camera

_BAND_VOXELS = 1.5
"""Nodes up to this distance from the zero level represent the surface."""
_LIFT_VOXELS = 2.0
"""Distance from the surface at which the ray to a camera begins, to avoid self-occlusion."""
_MIN_COSINE = 0.2
"""Cosine between normal and camera below which a surface is not seen (78 degrees)."""
_PADDING = 6
"""Voxels added at the rim, which would otherwise bend distances near it."""
_MIN_PHOTOS = 2
"""Photos that must show a point: a single one does not fix its depth."""
RIM_VOXELS = 2
"""Margin around seen nodes in which the surface stays, so that a box keeps its edges."""
_N_STEPS = 48
"""Largest number of steps along the ray to a camera."""
_PASSES_PER_REDISTANCE = 8
"""Passes of the filter, less than a voxel of motion, before distances are renewed."""
_N_PASSES = 800
"""Passes of the filter, heat for t = 1/4 voxel^2 each: holes of 25 voxels decay to 4 %."""


def seen_nodes(
    values: NDArray[np.float32], grid: Grid, cameras: tuple[Camera, ...]
) -> tuple[Bools, Bools]:
    """Nodes near the zero level, and those of them that two cameras see, grid.shape each.

    A node is seen if it lies within the picture, if the surface there faces the camera, and if the
    signed distance is positive along the ray.
    """
    band = np.abs(values) < _BAND_VOXELS * grid.spacing_m
    points = grid.points()[band.ravel()]
    sample = sdf_grid(values, grid, points)
    normals = np.asarray(sample.gradient, dtype=np.float64)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    distance = np.asarray(sample.value, dtype=np.float64)
    starts = points + (_LIFT_VOXELS * grid.spacing_m - distance)[:, None] * normals
    n_seen = np.zeros(points.shape[0], dtype=np.int64)
    for camera in cameras:
        towards = camera.position - starts
        away = np.linalg.norm(towards, axis=1)
        towards /= away[:, None]
        pixels = camera.project(starts)
        shown = camera.contains(pixels)
        facing = (normals * towards).sum(axis=1) > _MIN_COSINE
        ask = np.nonzero(shown & facing & (n_seen < _MIN_PHOTOS))[0]
        n_seen[ask] += _is_free(values, grid, starts[ask], towards[ask], away[ask])
    found = np.zeros(values.shape, dtype=bool)
    found[band] = n_seen >= _MIN_PHOTOS
    return band, found


def _is_free(
    values: NDArray[np.float32], grid: Grid, starts: Floats, towards: Floats, away: Floats
) -> Bools:
    """Whether each ray from a start to its camera is free, by sphere tracing."""
    free = np.ones(starts.shape[0], dtype=bool)
    travelled = np.zeros(starts.shape[0])
    size = grid.spacing_m * float(np.linalg.norm(grid.shape))
    going = np.arange(starts.shape[0])
    for _ in range(_N_STEPS):
        points = starts[going] + travelled[going, None] * towards[going]
        distance = np.asarray(sdf_grid(values, grid, points).value, dtype=np.float64)
        free[going[distance <= 0.0]] = False
        travelled[going] += np.maximum(distance, 0.5 * grid.spacing_m)
        going = going[(distance > 0.0) & (travelled[going] < np.minimum(away[going], size))]
        if going.size == 0:
            break
    return free


def close_unseen(
    values: NDArray[np.float32],
    grid: Grid,
    cameras: tuple[Camera, ...],
    rim_voxels: int = RIM_VOXELS,
) -> NDArray[np.float32]:
    """Signed distance whose unseen parts have shrunk to least area between the seen ones.

    Silhouettes leave a bulge at hidden parts, for instance below a box on a table. Motion by mean
    curvature removes it: each pass of a filter over a signed distance moves its zero level by the
    curvature (Merriman, Bence and Osher 1994). Nodes whose nearest surface is seen stay, with
    `rim_voxels` around them; use 0 where only silhouettes fix the surface, which bulges at once
    beyond the seen part.
    """
    inner = (slice(_PADDING, -_PADDING),) * 3
    grid, values = _padded(grid, values)
    band, seen = seen_nodes(values, grid, cameras)
    if not seen.any() or not (band & ~seen).any():
        return values[inner]
    _, nearest = ndimage.distance_transform_edt(~band, return_indices=True)
    # Isolated seen nodes are noise of the test, and would hold the bulge.
    held = ndimage.binary_opening(seen, np.ones((2, 2, 2)))
    if rim_voxels and held.any():
        held = band & ndimage.binary_dilation(held, np.ones((3, 3, 3)), iterations=rim_voxels)
    free = torch.from_numpy(~held[tuple(nearest)])
    now: Tensor = torch.from_numpy(values)
    for number in range(1, _N_PASSES + 1):
        now = torch.where(free, binomial_blur(now), now)
        if number % _PASSES_PER_REDISTANCE == 0:
            again = torch.from_numpy(quick_redistance(now.numpy(), grid.spacing_m))
            now = torch.where(free, again, now)
    if 2 * int((now < 0.0).sum()) < np.count_nonzero(values < 0.0):
        return np.ascontiguousarray(values[inner])  # the seen part is too small
    return np.ascontiguousarray(now.numpy()[inner])


def _padded(grid: Grid, values: NDArray[np.float32]) -> tuple[Grid, NDArray[np.float32]]:
    """Grid and values with a margin in which the distance grows by a voxel a node."""
    nx, ny, nz = (n + 2 * _PADDING for n in grid.shape)
    x, y, z = (first - _PADDING * grid.spacing_m for first in grid.origin_m)
    padded = np.pad(values, _PADDING, mode="edge")
    inside = np.pad(np.zeros(values.shape, dtype=bool), _PADDING, constant_values=True)
    beyond = ndimage.distance_transform_edt(inside) * grid.spacing_m
    larger = Grid(origin_m=(x, y, z), spacing_m=grid.spacing_m, shape=(nx, ny, nz))
    # the surface is closed at the rim
    margin = np.maximum(padded, 0.0) + beyond
    return larger, np.where(inside, margin, padded).astype(np.float32)
