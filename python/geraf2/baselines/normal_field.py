"""Normals voxel by voxel from the antennas' contributions, integrated to a relative distance.

In the manner of mmNorm (Dodds et al., 2025), from its published description alone: every antenna
that contributes to a voxel votes for the normal that points at it; the field of normals is the
gradient of a distance known up to a constant; the constant is the one whose isosurface explains
the measured signals best when it is simulated. That work views from one side with the box cropped
out; here the planes around the turntable add their votes. Written without sight of its code.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from skimage.filters import threshold_otsu

from geraf2._bounds import Bounded, CellM, MarginM, Power
from geraf2._types import Floats, Ints, Progress
from geraf2.baselines.heat import counted_voxels, grid_inside
from geraf2.baselines.level import LevelConfig, best_level, isosurface
from geraf2.baselines.poisson import solve_gradient
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.imaging.volume import pose_image
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Capture, Grid, LosPrior, Pose

# Share of the largest weight that every voxel has: keeps the potential smooth where nothing echoes.
_MIN_WEIGHT = 1e-3


@dataclass(frozen=True, kw_only=True)
class NormalFieldConfig(Bounded):
    """Constants of the normal-field inversion."""

    spacing_m: CellM = 0.0025
    """Distance of voxels [m]."""
    crop_m: MarginM = 0.012
    """The box is cropped out: voxels nearer to a known wall have no normals [m]."""
    weight_power: Power = 2.0
    """A voxel weighs as its votes' length to this power."""
    level: LevelConfig = field(default_factory=LevelConfig)
    """How the level is chosen, around the mean level of the brightest voxels."""


def normal_field_surface(
    capture: Capture,
    prior: LosPrior,
    config: NormalFieldConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> TriangleMesh:
    """Isosurface of a distance integrated from voxel normals, where its voxels have echoes.

    Of an isosurface the triangles whose votes are above Otsu's threshold are the surface: elsewhere
    the potential is only smooth. The level is the one whose surface explains the
    signals best.

    prior: outside of the box, with known walls.
    """
    config = config or NormalFieldConfig()
    grid = grid_inside(prior, config.spacing_m)
    counted = counted_voxels(prior, grid, config.crop_m, num_threads=num_threads)
    votes = np.zeros((3, *grid.shape))
    for number, pose in enumerate(capture.poses):
        votes += antenna_votes(capture, pose, grid, num_threads=num_threads)
        if progress is not None:
            progress(0.6 * (number + 1) / len(capture.poses))
    votes *= counted
    length = np.sqrt(np.square(votes).sum(axis=0))
    if not length.any():
        raise UserError(what="no voxel inside the box has an echo")
    normals = votes / np.where(length > 0.0, length, 1.0)
    weights = (length / length.max()) ** config.weight_power * counted + _MIN_WEIGHT
    distance = config.spacing_m * solve_gradient(list(normals), weights)
    relative = SdfGrid(grid=grid, values=distance.astype(np.float32))
    strong = counted & (length >= np.quantile(length[counted], 0.98))
    middle = float(np.average(relative.values[strong], weights=length[strong]))
    threshold = float(threshold_otsu(length[counted]))

    def with_echo(vertices: Floats, faces: Ints) -> Ints:
        middles = (vertices[faces].mean(axis=1) - np.asarray(grid.origin_m)) / grid.spacing_m
        echo = map_coordinates(length, middles.T, order=1, mode="nearest")
        return np.asarray(faces[echo > threshold])

    level = best_level(
        relative, counted, capture, middle, config.level, shown=with_echo, num_threads=num_threads
    )
    vertices, faces = isosurface(relative, counted, level)
    kept = with_echo(vertices, faces)
    if not len(kept):
        raise UserError(what="no part of the isosurface has an echo")
    return TriangleMesh(vertices=vertices, faces=faces).with_faces(kept)


def antenna_votes(
    capture: Capture, pose: Pose, grid: Grid, *, num_threads: int | None = None
) -> Floats:
    """Sum over antennas of their contribution to a voxel times the direction to them, (3, *shape).

    c_i(x) is the contribution of antenna i to P(x) = sum_i c_i(x); its part in phase with P counts:

        v(x) = 1/|P| Re( conj(P) sum_i c_i (a_i - x) ) / |a - x|

    with a_i the middle of transmitter and receiver, and their mean a in the last denominator, which
    differs from each antenna's own by less than a tenth. As c_i is linear in the signal, the sum
    over c_i a_i is the matched filter of the signals times a coordinate: four images in all.
    """

    def image(signal: NDArray[np.complex64]) -> NDArray[np.complex64]:
        return pose_image(pose, grid, capture.waveform, signal=signal, num_threads=num_threads)

    center = pose.phase_centers.mean(axis=0)
    plain = image(pose.signal)
    magnitude = np.abs(plain)
    phase = np.conj(plain) / np.where(magnitude > 0.0, magnitude, 1.0)
    offsets = pose.phase_centers - center
    axes = np.meshgrid(*grid.axes_m, indexing="ij", sparse=True)
    from_voxel = [center[k] - axes[k] for k in range(3)]
    distance = np.sqrt(sum(np.square(part) for part in from_voxel))
    votes = np.empty((3, *grid.shape))
    for k in range(3):
        moment = image((pose.signal * offsets[:, k : k + 1]).astype(np.complex64))
        votes[k] = ((phase * moment).real + magnitude * from_voxel[k]) / distance
    return votes
