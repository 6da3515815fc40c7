"""Lensless rendering: opacity once per ray, transmittance and lobe per group of antennas."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Floats
from geraf2.fields.learned import CubeDomain, Distance, SdfField
from geraf2.fields.sdf_grid import SdfGrid
from geraf2.ops import ray_march, sdf_grid, signal_tracer
from geraf2.rendering.clusters import antenna_clusters
from geraf2.rendering.config import RenderConfig
from geraf2.rendering.sampling import LenslessSampler, PrimaryRays
from geraf2.scene import Waveform


class VisionPrior:
    """The frozen distance field f_v of the outside of the box, on a grid.

    distance: signed distance to the outside of the box, negative within [m].
    domain: where it is needed.
    n_per_side: voxels along a side.
    """

    def __init__(self, distance: Distance, domain: CubeDomain, n_per_side: int = 65) -> None:
        grid = domain.grid(n_per_side)
        values = np.asarray(distance(grid.points()), dtype=np.float32)
        self.field = SdfGrid(grid=grid, values=values.reshape(grid.shape))
        self._values = torch.from_numpy(self.field.values)

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Value (n,) [m] and gradient (n, 3) at points (n, 3) [m]; no gradient to anything."""
        sample = sdf_grid(self._values.to(points.dtype), self.field.grid, points.detach())
        return torch.as_tensor(sample.value), torch.as_tensor(sample.gradient)


class RenderedSignal(NamedTuple):
    """What a step of lensless rendering gives."""

    signal: Tensor
    """Complex (n_looks, n_antennas, n_samples)."""
    gradient: Tensor
    """Of the distance at the samples, (n_points, 3), for the eikonal term."""
    depth: Tensor
    """Expected depth of each ray from where it enters the scene, (n_rays,) [m]."""
    weight: Tensor
    """One-way weights, (n_rays, n_samples)."""


class LenslessRenderer:
    """Signals of antennas from a learned distance, by equations 3 to 5 of the paper.

    sampler: of primary rays; its boundary is where transmittance is corrected.
    vision: frozen f_v.
    config: forms.
    wall_delay_m: by which walls lengthen each way to a sample and each way back [m].
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
        weight = torch.as_tensor(march.weight)
        depth = torch.as_tensor(march.depth) + rays.offset * weight.sum(dim=1)
        turned = gradient if self.config.normal_gradient else gradient.detach()
        # Where the distance does not fall along the ray there is no opacity, and nothing to render.
        opaque = torch.nonzero(alpha.detach().reshape(-1) != 0.0)[:, 0]
        points, turned = points[opaque], turned[opaque]
        normals = torch.nn.functional.normalize(turned, dim=1, eps=1e-6)
        base = power / (4.0 * math.pi) ** 2 * alpha.reshape(-1)[opaque]
        if reflectivity is not None:
            base = base * reflectivity(points)
        groups = antenna_clusters(0.5 * (tx + rx), self.config.n_clusters)
        centers = np.stack([0.5 * (tx[g] + rx[g]).mean(axis=0) for g in groups])
        shift = self._boundary_shift(field, inv_s, rays, opaque, centers)
        one_way, look = transmittance.reshape(-1)[opaque], self._look_of(shape)[opaque]
        parts = []
        for number, group in enumerate(groups):
            amplitude = self._amplitude(
                base, one_way, shift[number], points, normals, centers[number]
            )
            parts.append(self._looks(amplitude, points, normals, tx[group], rx[group], look))
        order = torch.from_numpy(np.argsort(np.concatenate(groups), kind="stable"))
        signal = torch.cat(parts, dim=1)[:, order]
        return RenderedSignal(signal, gradient, depth, weight)

    def _look_of(self, shape: torch.Size) -> Tensor:
        """Look that each sample of all rays is dealt out to, (n_rays n_samples,)."""
        # Neighbours go to different looks, along a ray and from ray to ray.
        ray, sample = np.indices(shape).reshape(2, -1)
        return torch.from_numpy((sample + 5 * ray) % self.config.n_looks)

    def _looks(
        self,
        amplitude: Tensor,
        points: Tensor,
        normals: Tensor,
        tx: Floats,
        rx: Floats,
        look: Tensor,
    ) -> Tensor:
        """Signals of the samples' shares, (n_looks, n_antennas, n_samples)."""
        # Where a clamp makes the amplitude zero, there is no gradient either.
        echoes = amplitude.detach() != 0.0
        signals = []
        for number in range(self.config.n_looks):
            mine = torch.nonzero(echoes & (look == number))[:, 0]
            signals.append(
                signal_tracer(
                    amplitude[mine], points[mine], tx, rx, self._delayed, normals=normals[mine]
                )
            )
        return torch.stack(signals)

    def _amplitude(
        self,
        base: Tensor,
        transmittance: Tensor,
        shift: Tensor,
        points: Tensor,
        normals: Tensor,
        center: Floats,
    ) -> Tensor:
        config = self.config
        corrected = (transmittance + shift).clamp(min=0.0)
        amplitude = base * (corrected.square() if config.two_way == "squared" else corrected)
        way = points - points.new_tensor(center)
        length = torch.linalg.vector_norm(way, dim=1)
        if config.lobe_power != 1.0:
            # The tracer has one power of w_o . w_r = 2 cos^2 - 1 for each antenna; the others are
            # those of the group's middle.
            cosine = (normals * way).sum(dim=1) / length
            lobe = (2.0 * cosine.square() - 1.0).clamp(min=0.0)
            amplitude = amplitude * lobe.pow(config.lobe_power - 1.0)
        if config.spreading == "two-way":
            reference = float(np.linalg.norm(center - self.sampler.center))
            amplitude = amplitude * (reference / length).square()
        return amplitude

    @torch.no_grad()
    def _boundary_shift(
        self, field: SdfField, inv_s: Tensor, rays: PrimaryRays, chosen: Tensor, centers: Floats
    ) -> Tensor:
        """Phi(f(x(u'_s))) - Phi(f(x(u_s))) of each group and chosen sample, (n_groups, n)."""
        points = rays.points.reshape(-1, 3)[chosen]
        n_samples = rays.step.shape[1]
        starts = self.sampler.secondary_starts(centers, points.numpy().astype(np.float64))
        secondary = torch.from_numpy(starts.reshape(-1, 3)).to(points.dtype)
        if self.config.ulos:
            first, second = self.vision.sample(rays.starts)[0], self.vision.sample(secondary)[0]
        else:
            first, second = field.value(rays.starts), field.value(secondary)
        phi_first = torch.sigmoid(inv_s * first)[chosen // n_samples]
        phi_second = torch.sigmoid(inv_s * second).reshape(len(centers), -1)
        return phi_second - phi_first
