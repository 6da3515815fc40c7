"""Lensless rendering: opacity per ray, transmittance and lobe per group of antennas."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Floats, Ints
from geraf2.fields.sdf_grid import SdfGrid
from geraf2.learned.config import RenderConfig
from geraf2.learned.fields import CubeDomain, Distance, SdfField
from geraf2.learned.ray_sampling import LenslessSampler, PrimaryRays
from geraf2.ops import EchoForm, ray_march, sdf_grid
from geraf2.ops.lensless import echo_amplitudes, facing_samples, trace_pairs
from geraf2.scene import Waveform
from geraf2.surfaces.clusters import antenna_clusters


class VisionPrior:
    """Frozen distance field f_v of the outside of the box, on a grid.

    distance: signed distance to the outside of the box, negative within [m].
    domain: cube of the grid.
    n_per_side: voxels along a side.
    """

    def __init__(self, distance: Distance, domain: CubeDomain, n_per_side: int = 65) -> None:
        grid = domain.grid(n_per_side)
        values = np.asarray(distance(grid.points()), dtype=np.float32)
        self.field = SdfGrid(grid=grid, values=values.reshape(grid.shape))
        self._values = torch.from_numpy(self.field.values)

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Value (n,) [m] and gradient (n, 3) at points (n, 3) [m]; not differentiable."""
        self._values = self._values.to(points)  # moves to the device of the points
        sample = sdf_grid(self._values, self.field.grid, points.detach())
        return torch.as_tensor(sample.value), torch.as_tensor(sample.gradient)


class RenderedSignal(NamedTuple):
    """Result of lensless rendering."""

    signal: Tensor
    """Complex (n_looks, n_antennas, n_samples)."""
    gradient: Tensor
    """Gradient of the distance at the samples, (n_points, 3), for the eikonal term."""
    depth: Tensor
    """Expected depth of each ray from where it enters the scene, (n_rays,) [m]."""


class LenslessRenderer:
    """Signals of antennas from a learned distance, by equations 3 to 5 of the paper.

    sampler: of primary rays; its boundary is where transmittance is corrected.
    vision: frozen f_v.
    config: form of the amplitude.
    wall_delay_m: one-way excess path of the walls [m].
    """

    def __init__(
        self,
        sampler: LenslessSampler,
        vision: VisionPrior,
        waveform: Waveform,
        config: RenderConfig | None = None,
        *,
        wall_delay_m: float = 0.0,
    ) -> None:
        self.sampler = sampler
        self.vision = vision
        self.waveform = waveform
        self._delayed = replace(waveform, path_bias_m=waveform.path_bias_m + 2.0 * wall_delay_m)
        self.config = config if config is not None else RenderConfig()

    def render(
        self,
        field: SdfField,
        reflectivity: Callable[[Tensor], Tensor] | None,
        power: Tensor,
        inv_s: Tensor,
        rays: PrimaryRays,
        tx: Floats,
        rx: Floats,
    ) -> RenderedSignal:
        """Signals of antennas at tx, rx (n_antennas, 3) [m] from samples on primary rays.

        `reflectivity` maps points (n, 3) [m] to (n,); None stands for 1. `power` and `inv_s`
        [1/m] are tensors of one element. Differentiable to the parameters of all.
        """
        points = rays.points.reshape(-1, 3)
        value, gradient = field(points)
        shape = rays.step.shape
        march = ray_march(
            value.reshape(shape),
            (gradient @ rays.direction).reshape(shape),
            rays.step,
            inv_s,
            two_way="none",
        )
        alpha, transmittance = torch.as_tensor(march.alpha), torch.as_tensor(march.transmittance)
        depth = torch.as_tensor(march.depth)
        depth = depth + rays.offset * torch.as_tensor(march.weight).sum(dim=1)
        groups = antenna_clusters(0.5 * (tx + rx), self.config.n_clusters)
        centers = np.stack([0.5 * (tx[g] + rx[g]).mean(axis=0) for g in groups])
        spreads = self.config.spreading == "two-way"
        form = EchoForm(
            centers=centers,
            lobe_power=self.config.lobe_power,
            two_way_power=2 if self.config.two_way == "squared" else 1,
            references=np.linalg.norm(centers - self.sampler.center, axis=1) if spreads else None,
        )
        # Samples where the distance does not fall along the ray have no opacity.
        positions = points.detach().cpu().numpy().astype(np.float64)
        pairs = facing_samples(alpha, gradient, positions, form, n_looks=self.config.n_looks)
        origins = np.take(form.centers, pairs.group(), axis=0)
        shift = self._boundary_shift(field, inv_s, rays, pairs.sample, origins)
        # An amplitude clamped to zero has no gradient.
        seen = torch.from_numpy(pairs.sample).to(points.device)
        before = transmittance.detach().reshape(-1).index_select(0, seen)
        lit = ~(before + shift <= 0.0)
        pairs = pairs.keep(lit.cpu().numpy())
        turned = gradient if self.config.normal_gradient else gradient.detach()
        amplitude, normals = echo_amplitudes(
            alpha, transmittance, turned, positions, pairs, shift[lit], form
        )
        amplitude = amplitude * (power / (4.0 * math.pi) ** 2)
        if reflectivity is not None:
            used, which = np.unique(pairs.sample, return_inverse=True)
            rho = reflectivity(points[torch.from_numpy(used).to(points.device)])
            of_pair = torch.from_numpy(which).to(points.device)
            amplitude = amplitude * rho.index_select(0, of_pair)
        signal = trace_pairs(amplitude, positions, normals, pairs, tx, rx, groups, self._delayed)
        return RenderedSignal(signal, gradient, depth)

    @torch.no_grad()
    def _boundary_shift(
        self, field: SdfField, inv_s: Tensor, rays: PrimaryRays, samples: Ints, origins: Floats
    ) -> Tensor:
        """Phi(f(x(u'_s))) - Phi(f(x(u_s))) of samples seen from origins (n, 3) [m], (n,)."""
        positions = rays.points.reshape(-1, 3).cpu().numpy()
        ends = np.take(positions, samples, axis=0).astype(np.float64)
        # Where the straight paths from the antennas enter the scene.
        secondary = torch.from_numpy(self.sampler.boundary.first_meetings(origins, ends))
        starts = torch.cat([rays.starts, secondary.to(rays.starts)])
        value = self.vision.sample(starts)[0] if self.config.ulos else field.value(starts)
        phi = torch.sigmoid(inv_s * value)
        n_rays, n_samples = rays.step.shape
        of_ray = torch.from_numpy(samples // n_samples).to(phi.device)
        return phi[n_rays:] - phi.index_select(0, of_ray)
