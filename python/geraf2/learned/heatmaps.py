"""Measured heat maps of all planes on a coarse grid: scale, targets, dark rays."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from geraf2._types import Bools, Floats, Ints
from geraf2.errors import UserError
from geraf2.imaging.volume import pose_image
from geraf2.learned.fields import CubeDomain
from geraf2.learned.ray_sampling import LenslessSampler
from geraf2.ops import sdf_grid
from geraf2.ops.point_images import point_images
from geraf2.scene import Capture, Grid, Pose, Waveform

COARSE_SPACING_M = 0.006
"""Spacing of the maps; the resolution of a full aperture is 4 to 6 mm at 0.4 m."""
_SAMPLES_OF_A_CELL = 24


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredMaps:
    """|P| of each plane's full aperture."""

    grid: Grid
    """Grid of the maps."""
    volumes: NDArray[np.float32]
    """(n_planes, x, y, z)."""
    scale: float
    """Mean over planes of the largest value: one unit of the loss."""


def measure_maps(
    capture: Capture, domain: CubeDomain, *, num_threads: int | None = None
) -> MeasuredMaps:
    """Image every plane on a coarse grid; UserError for a plane that is not finite."""
    grid = domain.grid(int(np.ceil(2.0 * domain.half_side_m / COARSE_SPACING_M)) + 1)
    volumes = np.empty((len(capture.poses), *grid.shape), dtype=np.float32)
    for number, pose in enumerate(capture.poses):
        if not np.isfinite(pose.signal).all():
            raise UserError(
                what=f"plane {number} ({pose.name}) has samples that are not finite",
                expected="finite ADC samples",
                got=f"{int((~np.isfinite(pose.signal)).sum())} NaN or infinite samples",
                hint="leave the plane out or import it again",
            )
        image = pose_image(pose, grid, capture.waveform, num_threads=num_threads)
        volumes[number] = np.abs(image)
    scale = float(volumes.reshape(len(volumes), -1).max(axis=1).mean())
    if not scale > 0.0:
        raise UserError(what="the capture holds no echoes: all samples are zero")
    return MeasuredMaps(grid=grid, volumes=volumes, scale=scale)


def bright_rays(
    maps: MeasuredMaps,
    plane: int,
    sampler: LenslessSampler,
    axes: Floats,
    *,
    dark_plane: float,
    dark_scene: float,
) -> Bools:
    """Whether the ray of each cell of a plane's disc is kept, (n_rays,).

    A dark ray is left out: the plane's map stays below `dark_plane` of its peak all along the ray,
    while the map of all planes somewhere exceeds `dark_scene` of its peak. A surface there reflects
    this plane's waves elsewhere, so that darkness is no evidence against it.
    """
    origins, directions = sampler.cell_rays(axes)
    reach = 2.0 * float(np.linalg.norm(origins[0] - sampler.center))
    depths = (np.arange(_SAMPLES_OF_A_CELL) + 0.5) / _SAMPLES_OF_A_CELL * reach
    points = (origins[:, None] + depths[:, None] * directions[:, None]).reshape(-1, 3)
    shape = (sampler.n_rays, _SAMPLES_OF_A_CELL)
    own = np.asarray(sdf_grid(maps.volumes[plane], maps.grid, points).value).reshape(shape)
    total = maps.volumes.sum(axis=0)
    scene = np.asarray(sdf_grid(total, maps.grid, points).value).reshape(shape)
    is_dark = own.max(axis=1) < dark_plane * maps.volumes[plane].max()
    is_dark &= scene.max(axis=1) > dark_scene * total.max()
    return np.asarray(~is_dark)


class TargetChooser:
    """Sampler of targets: some where a plane's map is bright, the others uniform."""

    def __init__(self, maps: MeasuredMaps, within: Bools, bright_share: float) -> None:
        """`within` marks the voxels of the maps that may be chosen, grid.shape."""
        self._spacing = maps.grid.spacing_m
        points = torch.from_numpy(maps.grid.points())
        chosen = torch.from_numpy(np.flatnonzero(within.reshape(-1)))
        self._positions = points[chosen]
        volumes = torch.from_numpy(maps.volumes.reshape(len(maps.volumes), -1))
        # Drawn by power: with magnitudes half of the targets would lie on side lobes.
        power = torch.cumsum(volumes[:, chosen].double().square(), dim=1)
        self._reached = power / power[:, -1:].clamp(min=torch.finfo(power.dtype).tiny)
        self._bright_share = bright_share

    def choose(self, plane: int, n_targets: int, generator: torch.Generator) -> Tensor:
        """Targets of a plane, (n_targets, 3) [m], float64."""
        n_bright = round(self._bright_share * n_targets)
        n_voxels = self._positions.shape[0]
        picks = []
        if n_bright:
            # Bit-identical to torch.multinomial with replacement, without its sum over all voxels.
            drawn = torch.rand(n_bright, generator=generator, dtype=torch.float64)
            picks.append(torch.searchsorted(self._reached[plane], drawn).clamp(max=n_voxels - 1))
        if n_targets > n_bright:
            picks.append(torch.randint(n_voxels, (n_targets - n_bright,), generator=generator))
        positions = self._positions[torch.cat(picks)]
        jitter = torch.rand(positions.shape, generator=generator, dtype=torch.float64) - 0.5
        return positions + self._spacing * jitter


def heat_maps(
    pose: Pose,
    waveform: Waveform,
    antennas: Ints,
    rendered: Tensor,
    targets: Floats,
    *,
    floor: float,
) -> tuple[Tensor, Tensor]:
    """Heat maps of rendered and measured signals of the same antennas.

    Each is the root of the power summed over the independent signals.

    antennas: of the plane, (n_antennas,).
    rendered: complex (n_looks, n_antennas, n_samples).
    targets: (n_targets, 3) [m].
    floor: added below the root, which has no derivative at zero.
    """
    images = point_images(
        rendered,
        torch.from_numpy(pose.signal[antennas])[None].to(rendered.device),
        *(pose.tx_positions[antennas], pose.rx_positions[antennas], targets, waveform),
    )
    rendered_map, measured_map = (
        torch.sqrt(torch.view_as_real(image).square().sum(dim=(0, 2)) + floor**2)
        for image in images
    )
    return rendered_map, measured_map
