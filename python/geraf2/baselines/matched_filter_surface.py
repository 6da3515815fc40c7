"""Matched filter summed over the planes, a threshold, a Poisson surface.

The paper's baseline in its own words: "we sum outputs across views, threshold the heatmap, and
apply Poisson surface reconstruction". Which threshold, and how the points get normals, it leaves
open; here the threshold does not use the truth.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from skimage.filters import threshold_otsu

from geraf2._bounds import Bounded, CellM, LengthM, MarginM, Positive
from geraf2._types import Bools, Floats, Progress
from geraf2.baselines.heat import counted_voxels, grid_inside
from geraf2.baselines.poisson import poisson_surface
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.imaging.volume import plane_images
from geraf2.scene import Capture, Grid, LosPrior


@dataclass(frozen=True, kw_only=True)
class MatchedFilterConfig(Bounded):
    """Constants of the matched-filter surface."""

    spacing_m: CellM = 0.0025
    """Distance of voxels [m]."""
    crop_m: MarginM = 0.012
    """The box is cropped out: voxels nearer to a known wall do not count [m]."""
    threshold_scale: Positive = 1.3
    """Threshold in units of Otsu's, which parts the heat of the voxels that count in two."""
    normal_reach_m: LengthM = 0.008
    """Points within this fit the plane that gives a point its normal [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeatSum:
    """Heat of each voxel, summed over all planes."""

    grid: Grid
    """Where."""
    heat: NDArray[np.float32]
    """Sum over planes of |P|, grid.shape."""
    strongest: NDArray[np.int32]
    """Plane with the largest |P|, grid.shape."""


def matched_filter_surface(
    capture: Capture,
    prior: LosPrior,
    config: MatchedFilterConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SdfGrid:
    """Poisson surface through the voxels whose summed heat exceeds a threshold.

    Normals are those of the plane through each point's neighbours, towards the scan plane in whose
    image the voxel is brightest.

    prior: outside of the box, with known walls.
    """
    config = config or MatchedFilterConfig()
    grid = grid_inside(prior, config.spacing_m)
    counted = counted_voxels(prior, grid, config.crop_m, num_threads=num_threads)
    total = sum_heat(capture, grid, num_threads=num_threads, progress=progress)
    threshold = config.threshold_scale * float(threshold_otsu(total.heat[counted]))
    return surface_above(capture, total, counted, threshold, config.normal_reach_m)


def surface_above(
    capture: Capture, total: HeatSum, counted: Bools, threshold: float, normal_reach_m: float
) -> SdfGrid:
    """Poisson surface through the voxels that count and are hotter than a threshold.

    capture: for the viewing directions of its planes.
    total: heat of all planes.
    counted: voxels that are not cropped, (x, y, z) of the grid.
    normal_reach_m: see :class:`MatchedFilterConfig`.
    """
    chosen = counted & (total.heat > threshold)
    if not chosen.any():
        raise UserError(what="no voxel is above the threshold", got=f"{threshold:g}")
    points = total.grid.points()[chosen.ravel()]
    looking = np.stack([pose.axes[0] for pose in capture.poses])
    toward = -looking[total.strongest[chosen]]
    normals = plane_normals(points, toward, normal_reach_m)
    return poisson_surface(points, normals, total.grid)


def sum_heat(
    capture: Capture,
    grid: Grid,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> HeatSum:
    """Sum of the planes' heat maps, and which plane sees each voxel brightest."""
    heat = np.zeros(grid.shape, dtype=np.float32)
    best = np.zeros(grid.shape, dtype=np.float32)
    strongest = np.zeros(grid.shape, dtype=np.int32)
    images = plane_images(capture, grid, num_threads=num_threads, progress=progress)
    for number, image in enumerate(images):
        magnitude = np.abs(image)
        heat += magnitude
        brighter = magnitude > best
        best[brighter], strongest[brighter] = magnitude[brighter], number
    return HeatSum(grid=grid, heat=heat, strongest=strongest)


def plane_normals(points: Floats, toward: Floats, reach_m: float) -> Floats:
    """Fit a plane to each point's neighbours; its normal, on the side of `toward`.

    points: (n_points, 3) [m].
    toward: side of each normal, (n_points, 3); the normal itself where a point has
        fewer than three neighbours.
    reach_m: neighbours lie within this [m].
    """
    # The sums below follow the order of the pairs, which follows the size of the leaves.
    pairs = KDTree(points, leafsize=16).query_pairs(reach_m, output_type="ndarray")
    first = np.concatenate([pairs[:, 0], pairs[:, 1], np.arange(len(points))])
    second = np.concatenate([pairs[:, 1], pairs[:, 0], np.arange(len(points))])
    count = np.bincount(first, minlength=len(points)).astype(np.float64)

    def sums(values: Floats) -> Floats:
        return np.asarray(np.bincount(first, values, minlength=len(points)))

    # About one point of all, or the squares of positions far from the origin would round.
    near = points - points.mean(axis=0)
    mean = np.stack([sums(near[second, k]) for k in range(3)], axis=1) / count[:, None]
    spread = np.empty((len(points), 3, 3))
    for i in range(3):
        for j in range(3):
            product = near[second, i] * near[second, j]
            spread[:, i, j] = sums(product) / count - mean[:, i] * mean[:, j]
    normals = np.linalg.eigh(spread)[1][:, :, 0]
    normals[np.einsum("nk,nk->n", normals, toward) < 0.0] *= -1.0
    lonely = count < 4
    normals[lonely] = toward[lonely]
    return np.asarray(normals)
