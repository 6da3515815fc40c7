"""Point cloud of the strongest returns: where each plane's back-projected image peaks in depth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from geraf2._bounds import Bounded, CellM, Decibels, MarginM
from geraf2._types import Bools, Floats, Progress
from geraf2.baselines.heat import counted_voxels, grid_inside
from geraf2.errors import UserError
from geraf2.imaging.volume import plane_images
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Capture, Grid, LosPrior, Pose


@dataclass(frozen=True, kw_only=True)
class BackProjectionConfig(Bounded):
    """Constants of the back-projection point cloud."""

    spacing_m: CellM = 0.0025
    """Distance of voxels [m]."""
    crop_m: MarginM = 0.012
    """The box is cropped out: voxels nearer to a known wall do not count [m]."""
    dynamic_range_db: Decibels = 12.0
    """Points weaker than this below their plane's strongest are left out [dB]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedCloud:
    """Points with the viewing directions of their planes."""

    positions: Floats
    """(n_points, 3) [m]."""
    normals: Floats
    """Unit vectors towards the scan plane, (n_points, 3)."""
    strengths: Floats
    """|P| there, (n_points,)."""


def back_projection_cloud(
    capture: Capture,
    prior: LosPrior,
    config: BackProjectionConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> OrientedCloud:
    """Positions where a plane's full-aperture image is largest along the viewing direction.

    One voxel at a time: larger than one step nearer and one step farther, then a parabola through
    the three; at least `dynamic_range_db` below the plane's largest value.

    prior: outside of the box, with known walls.
    """
    config = config or BackProjectionConfig()
    grid = grid_inside(prior, config.spacing_m)
    counted = counted_voxels(prior, grid, config.crop_m, num_threads=num_threads)
    images = plane_images(capture, grid, num_threads=num_threads, progress=progress)
    clouds = [
        _peaks_in_depth(np.abs(image), grid, counted, pose, config)
        for pose, image in zip(capture.poses, images, strict=True)
    ]
    cloud = OrientedCloud(
        positions=np.concatenate([c.positions for c in clouds]),
        normals=np.concatenate([c.normals for c in clouds]),
        strengths=np.concatenate([c.strengths for c in clouds]),
    )
    if not len(cloud.positions):
        raise UserError(what="no plane's image peaks inside the box")
    return cloud


def _peaks_in_depth(
    heat: NDArray[np.float32], grid: Grid, counted: Bools, pose: Pose, config: BackProjectionConfig
) -> OrientedCloud:
    looking = pose.axes[0]
    least = float(heat[counted].max()) * 10.0 ** (-config.dynamic_range_db / 20.0)
    index = np.argwhere(counted & (heat > least))
    here = heat[tuple(index.T)].astype(np.float64)

    def beside(steps: float) -> Floats:
        positions = (index + steps * looking).T
        return np.asarray(map_coordinates(heat, positions, order=1, mode="nearest"), np.float64)

    near, far = beside(-1.0), beside(1.0)
    peak = (here > near) & (here >= far)
    bend = np.maximum(2.0 * here - near - far, 1e-30)[peak]  # 1e-30: a flat top stays where it is
    shift = np.clip(0.5 * (far - near)[peak] / bend, -0.5, 0.5)
    positions = index[peak] + shift[:, None] * looking
    return OrientedCloud(
        positions=np.asarray(grid.origin_m) + grid.spacing_m * positions,
        normals=np.broadcast_to(-looking, positions.shape),
        strengths=here[peak],
    )


def cloud_as_mesh(cloud: OrientedCloud, side_m: float) -> TriangleMesh:
    """Each point as an equilateral triangle that faces the plane that saw it.

    All are equally large, so that samples drawn by area are samples of the points: what measures
    meshes measures the cloud.

    side_m: side of each triangle [m].
    """
    n = len(cloud.positions)
    helper = np.where(np.abs(cloud.normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(helper, cloud.normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(cloud.normals, across)
    angles = np.pi / 2.0 + 2.0 * np.pi / 3.0 * np.arange(3)
    radius = side_m / np.sqrt(3.0)
    corners = cloud.positions[:, None, :] + radius * (
        np.cos(angles)[:, None] * across[:, None, :] + np.sin(angles)[:, None] * up[:, None, :]
    )
    return TriangleMesh(vertices=corners.reshape(-1, 3), faces=np.arange(3 * n).reshape(n, 3))
