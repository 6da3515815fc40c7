"""Coloured surface on grids, for CPUs."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

from geraf2._validation import require_each, require_least, require_positive
from geraf2.apps.photos.neus.feature_grid import FeatureGrid
from geraf2.fields.sdf_field import CubeDomain, SdfSample
from geraf2.learned.fields.learned_sdf_grid import LearnedSdfGrid
from geraf2.ops import sdf_grid
from geraf2.scene import Grid

_MIN_WEIGHT = 1e-4
"""Samples of less weight get no colour: sixteen of them are below one step of eight bits."""
_MIN_OPACITY = 1e-3
"""Guards the mean over a ray that misses the surface."""
_N_HARMONICS = 8


@dataclass(frozen=True, kw_only=True)
class ColouredGridConfig:
    """Size of the colour's part."""

    n_features: int = 8
    """Features of a node; the first three are the view-independent colour."""
    nodes_per_voxel: float = 1.5
    """Nodes of features along a voxel of the signed distance."""
    band_voxels: float = 4.0
    """Distance from the first surface up to which nodes have features, in voxels."""
    later_band_voxels: float = 2.5
    """The same on later grids, where the surface is nearly right."""
    width: int = 64
    """Neurons of each of the two hidden layers of the view-dependent part."""

    def __post_init__(self) -> None:
        require_least(self, n_features=3, width=1)
        require_each(require_positive, self, "nodes_per_voxel", "band_voxels", "later_band_voxels")


class ColouredGrid(nn.Module):
    """Signed distance and features on grids; one small network a ray, not a sample.

    The features of a ray's samples are averaged by weight, and the network turns their mean, the
    mean normal and the direction into a colour ("deferred" shading, Hedman et al. 2021). The
    view-independent colour is separate from the view-dependent part, which starts at zero.

    domain: cube about the region.
    grid, values: voxels of the signed distance, and the distance at them, grid.shape [m].
    """

    def __init__(
        self, domain: CubeDomain, grid: Grid, values: Tensor, config: ColouredGridConfig
    ) -> None:
        super().__init__()
        self.config = config
        self.distance = LearnedSdfGrid(domain, n_per_side=2)
        self.distance.regrid(grid, values)
        self.features = self._features(config.band_voxels)
        n_in = config.n_features + 3 + _N_HARMONICS
        self.view = nn.Sequential(
            nn.Linear(n_in, config.width),
            nn.ReLU(),
            nn.Linear(config.width, config.width),
            nn.ReLU(),
            nn.Linear(config.width, 3),
        )
        last = self.view[-1]
        nn.init.zeros_(torch.as_tensor(last.weight))
        nn.init.zeros_(torch.as_tensor(last.bias))
        self.view_dependent = True

    @property
    def grid(self) -> Grid:
        """Voxels of the signed distance."""
        return self.distance.grid

    def _features(self, band_voxels: float) -> FeatureGrid:
        nodes = refine_grid(self.grid, self.config.nodes_per_voxel)
        distance = self.value(torch.from_numpy(nodes.points())).numpy()
        near = np.abs(distance) < band_voxels * self.grid.spacing_m
        return FeatureGrid(nodes, near.reshape(nodes.shape), self.config.n_features)

    def regrid(self, grid: Grid, values: Tensor) -> None:
        """Replace grid and values, and carry the colour over to nodes about the new surface.

        Parameters are replaced; create a new optimiser.
        """
        old = self.features
        self.distance.regrid(grid, values)
        self.features = self._features(self.config.later_band_voxels)
        self.features.copy_from(old)

    def value(self, points: Tensor) -> Tensor:
        """Trilinear signed distance (n_points,) [m]; no gradient, half the time of tricubic."""
        return torch.as_tensor(sdf_grid(self.distance.values.detach(), self.grid, points).value)

    def surface_sample(self, points: Tensor) -> SdfSample:
        """Tricubic signed distance [m] and gradient at points (n, 3) [m]."""
        sample: SdfSample = self.distance(points)
        return sample

    def shade(
        self, points: Tensor, directions: Tensor, sample: SdfSample, weight: Tensor
    ) -> Tensor:
        """Colour of rays, not yet composed with the background.

        The colour sends no gradient to the normal.

        points: samples of each ray, (n_rays, n, 3) [m].
        directions: unit vectors from the camera, (n_rays, 3).
        sample: `surface_sample` at these points, ray by ray.
        weight: weight of each sample, (n_rays, n).

        Returns (n_rays, 3), each at most the sum of the ray's weights.
        """
        n_rays, n_samples = weight.shape
        flat = weight.reshape(-1)
        kept = torch.nonzero(flat.detach() > _MIN_WEIGHT)[:, 0]
        ray, kept_weight = kept // n_samples, flat[kept][:, None]
        features = self.features(points.reshape(-1, 3)[kept])
        total = features.new_zeros((n_rays, features.shape[1]))
        total = total.index_add(0, ray, kept_weight * features)
        opacity = weight.sum(dim=1, keepdim=True)
        mean = total / opacity.clamp(min=_MIN_OPACITY)
        logits = mean[:, :3]
        if self.view_dependent:
            gradient = sample.gradient.detach()[kept]
            normal = gradient.new_zeros((n_rays, 3))
            normal = normalize(normal.index_add(0, ray, kept_weight.detach() * gradient), dim=1)
            seen = torch.cat([mean, normal, _harmonics(directions)], dim=1)
            logits = logits + self.view(seen)
        return opacity * torch.sigmoid(logits)


def refine_grid(grid: Grid, factor: float) -> Grid:
    """Grid over the same box with `factor` nodes a voxel."""
    shape = [max(2, round((n - 1) * factor) + 1) for n in grid.shape]
    spacing = max(
        (n - 1) * grid.spacing_m / (m - 1) for n, m in zip(grid.shape, shape, strict=True)
    )
    return Grid(origin_m=grid.origin_m, spacing_m=spacing, shape=(shape[0], shape[1], shape[2]))


def _harmonics(directions: Tensor) -> Tensor:
    """Real spherical harmonics of degrees 1 and 2 of unit vectors, unnormalised, (n, 8)."""
    x, y, z = directions.unbind(dim=1)
    parts = [x, y, z, x * y, y * z, x * z, x * x - y * y, 3.0 * z * z - 1.0]
    return torch.stack(parts, dim=1)
