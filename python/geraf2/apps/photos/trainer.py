"""Training of a surface on a grid that grows finer."""

import math
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy

from geraf2._types import Array, Bools
from geraf2.apps.photos.config import PhotoConfig
from geraf2.apps.photos.grid_smoothing import binomial_blur, close_body, quick_redistance
from geraf2.apps.photos.neural_surface import NeuralSurface
from geraf2.apps.photos.neus.rendering import Rendering
from geraf2.apps.photos.rays import PhotoRays, RayBatch, reduce_photos
from geraf2.apps.photos.visual_hull import Region
from geraf2.errors import UserError
from geraf2.ops import sdf_grid
from geraf2.scene import Grid
from geraf2.scene.photos import Camera, PhotoSet

_OPACITY_RIM = 1e-3
"""Keeps the logarithms of the cross entropy finite, as NeuS does."""
_N_FREE_POINTS = 2048
"""Points of the eikonal term, uniform in the region."""
_BENDING_EVERY = 4
"""Steps between pulls towards the neighbours' mean."""
_MARGIN_VOXELS = 3.0
"""Margin around the surface when the region shrinks, in voxels of the coarser grid."""


class PhotoTrainer:
    """Stages of growing resolution; sharpness by schedule, gradients smoothed.

    Sharpness grows within each stage from `first_sharpness` to `last_sharpness` over the voxel. The
    gradient to the values is smoothed by a binomial filter, which turns many small dents into one
    move of the surface (a Sobolev gradient; Renka and Neuberger 1995).
    """

    def __init__(
        self, photos: PhotoSet, region: Region, surface: NeuralSurface, config: PhotoConfig
    ) -> None:
        self.config, self._photos, self._rays_stage = config, photos, -1
        self.n_steps = sum(stage.n_steps for stage in config.stages)
        self.surface, self.step_number = surface, 0
        self.rays = self._stage_rays(0, region)
        self.generator = torch.Generator().manual_seed(config.seed)
        self._enter(surface)

    def _stage_rays(self, number: int, region: Region) -> PhotoRays:
        """Rays of photos whose pixels match the stage's feature spacing; full size in the last."""
        self._rays_stage, factor = number, 1
        if number + 1 < len(self.config.stages):
            apart = self.surface.field.grid.spacing_m / self.config.model.nodes_per_voxel
            factor = max(1, round(apart / _footprint_m(self._photos.cameras, region)))
        return PhotoRays(reduce_photos(self._photos, factor), region, seed=self.config.seed)

    def step(self) -> dict[str, float]:
        """Make one step; returns the terms of its loss."""
        self._prepare()
        terms = self._losses(self.rays.batch(self.config.rays_per_step, self.generator))
        values = {name: float(term.detach()) for name, term in terms.items()}
        for name, value in values.items():
            if not math.isfinite(value):
                raise UserError(
                    what=f"training from photos: the term {name!r} of the loss is {value}",
                    where=f"step {self.step_number + 1} of {self.n_steps}",
                    hint="the last checkpoint is whole; check poses and scale of the photos",
                )
        self.optimiser.zero_grad()
        torch.autograd.backward(torch.stack(list(terms.values())).sum())
        self._precondition()
        self.optimiser.step()
        self.step_number += 1
        return values

    def state(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and plain values from which `restore` continues bit by bit."""
        arrays, header = self.surface.state()
        arrays["generator"] = self.generator.get_state().numpy()
        for index, entry in self.optimiser.state_dict()["state"].items():
            for name, value in entry.items():
                arrays[f"optimiser.{index}.{name}"] = torch.as_tensor(value).numpy()
        # the region of the surface may have shrunk since the rays were chosen
        return arrays, header | {"step": self.step_number, "rays_region": asdict(self.rays.region)}

    def restore(self, arrays: dict[str, Array], header: dict[str, Any]) -> None:
        """Restore the state of a run with the same settings."""
        self.step_number = int(header["step"])
        self._enter(NeuralSurface.from_state(arrays, header))
        self.generator.set_state(torch.from_numpy(arrays["generator"]))
        parameters = [p for group in self.optimiser.param_groups for p in group["params"]]
        state: dict[int, dict[str, Tensor]] = {}
        for name, array in arrays.items():
            if name.startswith("optimiser."):
                _, index, key = name.split(".", 2)
                # the file has no scalars, only arrays of one element
                shape = () if key == "step" else parameters[int(index)].shape
                state.setdefault(int(index), {})[key] = torch.from_numpy(array).reshape(shape)
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": state, "param_groups": groups})

    def _enter(self, surface: NeuralSurface) -> None:
        """Continue with this surface and a new optimiser."""
        self.surface = surface
        config, field = self.config, surface.field
        distance_rate = config.distance_rate * field.grid.spacing_m
        groups: list[dict[str, Any]] = [
            {"params": [field.distance.values], "rate": distance_rate},
            {"params": [field.features.table], "rate": config.feature_rate},
            {"params": list(field.view.parameters()), "rate": config.network_rate},
        ]
        self.optimiser = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)

    def _stage(self) -> tuple[int, int]:
        """Return the current stage, and the step within it."""
        step = self.step_number
        for number, stage in enumerate(self.config.stages):
            if step < stage.n_steps:
                return number, step
            step -= stage.n_steps
        msg = f"step {self.step_number} is beyond the last, {self.n_steps}"
        raise ValueError(msg)

    def _prepare(self) -> None:
        """Enter the next stage where one begins; set rates and sharpness."""
        number, step = self._stage()
        stages, config = self.config.stages, self.config
        if step == 0 and number > 0:
            self._refine(number)
        if number != self._rays_stage:
            self.rays = self._stage_rays(number, self.rays.region)
        is_last = number == len(stages) - 1
        share = step / stages[number].n_steps
        last = config.final_sharpness if is_last else config.last_sharpness
        first = config.first_sharpness
        if number > 0:  # where the one before has ended, unless that is too sharp for this grid
            before = self.surface.region.grid(stages[number - 1].n_longest).spacing_m
            first = min(last, config.last_sharpness * self.surface.field.grid.spacing_m / before)
        sharpness = first * (last / first) ** share
        self.surface.inv_s = sharpness / self.surface.field.grid.spacing_m
        # The colour common to all directions is trained first: with few photos, a view-dependent
        # colour fits any shape.
        self.surface.field.view_dependent = number > 0 or len(stages) == 1
        falling = config.final_rate**share if is_last else 1.0
        for group in self.optimiser.param_groups:
            group["lr"] = group["rate"] * falling
        if number == 0 and share < config.colour_first:
            self.optimiser.param_groups[0]["lr"] = 0.0

    @torch.no_grad()
    def _refine(self, number: int) -> None:
        """Sample the signed distance on the stage's grid, over what is left of the region."""
        surface, field, before = self.surface, self.surface.field, self.surface.field.grid
        distance = field.distance.values.detach().numpy()
        body = close_body(distance, before.spacing_m) < 0.0
        if body.any():
            surface.region = _shrink_region(body, before, surface.region)
        grid = surface.region.grid(self.config.stages[number].n_longest)
        found = sdf_grid(distance, before, grid.points(), interpolation="cubic").value
        values = np.asarray(found, dtype=np.float32).reshape(grid.shape)
        field.regrid(grid, torch.from_numpy(quick_redistance(values, grid.spacing_m)))
        self._enter(surface)

    def _losses(self, batch: RayBatch) -> dict[str, Tensor]:
        """Colour, silhouette, and the eikonal term at samples and all over the region."""
        config = self.config
        rays = (batch.origins, batch.directions)
        near, far = self.surface.span(*rays)
        batch = batch.subset(far > near)
        rays = (batch.origins, batch.directions)
        rendering = self.surface.render_rays(rays, generator=self.generator)
        terms = self.photo_terms(rendering, batch)
        region = self.surface.region
        low, high = torch.tensor(region.low_m), torch.tensor(region.high_m)
        unit = torch.rand((_N_FREE_POINTS, 3), generator=self.generator)
        free = self.surface.field.surface_sample(low + (high - low) * unit).gradient
        slopes = rendering.gradient.reshape(-1, 3).norm(dim=1), free.norm(dim=1)
        eikonal = sum(((slope - 1.0) ** 2).mean() for slope in slopes)
        terms["eikonal"] = config.eikonal_weight * torch.as_tensor(eikonal)
        return terms

    def photo_terms(self, rendering: Rendering, batch: RayBatch) -> dict[str, Tensor]:
        """Colour and silhouette.

        The colour is divided by the opacity before the comparison, and weighted by it without
        gradient: otherwise a soft rim would be pushed outwards.

        Silhouettes pull only where a ray is on the wrong side of one half: a ray that grazes a face
        is never opaque while the density is soft.
        """
        colour = rendering.colour / rendering.opacity.clamp(min=_OPACITY_RIM)[:, None]
        share = batch.inside * rendering.opacity.detach()
        difference = (colour - batch.colours).abs().mean(dim=1)
        terms = {"colour": (difference * share).sum() / batch.inside.sum().clamp(min=1.0)}
        # Scaled, not clamped as in NeuS: a clamp has no gradient where the background is opaque,
        # and the surface would stay outside.
        bounded = _OPACITY_RIM + (1.0 - 2.0 * _OPACITY_RIM) * rendering.opacity.clamp(max=1.0)
        wrong = binary_cross_entropy(bounded, batch.inside, batch.known, reduction="none")
        terms["mask"] = self.config.mask_weight * torch.relu(wrong - math.log(2.0)).mean()
        return terms

    @torch.no_grad()
    def _precondition(self) -> None:
        """Smooth the gradient of the values, and draw them to their neighbours' mean."""
        values, config = self.surface.field.distance.values, self.config
        if values.grad is not None:
            values.grad = binomial_blur(values.grad, config.blur_passes)
        bends = config.bending > 0.0 and self.optimiser.param_groups[0]["lr"] > 0.0
        if bends and self.step_number % _BENDING_EVERY == 0:
            values.lerp_(binomial_blur(values.detach()), config.bending * _BENDING_EVERY)


def _shrink_region(body: Bools, grid: Grid, region: Region) -> Region:
    """Box about a body with a margin, within the region; empty space needs no refinement."""
    found = np.argwhere(body)
    low = np.asarray(grid.origin_m) + grid.spacing_m * (found.min(axis=0) - _MARGIN_VOXELS)
    high = np.asarray(grid.origin_m) + grid.spacing_m * (found.max(axis=0) + _MARGIN_VOXELS)
    return Region.from_corners(np.maximum(low, region.low_m), np.minimum(high, region.high_m))


def _footprint_m(cameras: tuple[Camera, ...], region: Region) -> float:
    """Size of a pixel at the middle of the region, the median over the photos [m]."""
    sizes = [
        float(np.linalg.norm(camera.position - region.center_m)) / float(camera.intrinsics[0, 0])
        for camera in cameras
    ]
    return float(np.median(sizes))
