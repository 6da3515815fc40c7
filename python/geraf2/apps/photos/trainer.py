"""Trainers of a surface from photos: their base class, and NeuS's networks and schedule."""

import math
from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy

from geraf2._types import Array
from geraf2.apps.photos.config import MlpPhotoConfig
from geraf2.apps.photos.neural_surface import NeuralSurface
from geraf2.apps.photos.neus.rendering import Rendering
from geraf2.apps.photos.rays import PhotoRays, RayBatch
from geraf2.errors import UserError

_OPACITY_RIM = 1e-3
"""Keeps the logarithms of the cross entropy finite, as NeuS does."""


class PhotoTrainer(ABC):
    """Losses, optimiser and random numbers; subclasses define the update of the field."""

    optimiser: torch.optim.Optimizer
    n_steps: int

    def __init__(self, rays: PhotoRays, surface: NeuralSurface, seed: int) -> None:
        self.rays, self.surface = rays, surface
        self.step_number = 0
        self.generator = torch.Generator().manual_seed(seed)

    @abstractmethod
    def prepare(self) -> None:
        """Set grid, rates and sharpness for the step to come."""

    @abstractmethod
    def losses(self, batch: RayBatch) -> dict[str, Tensor]:
        """Weighted terms of the loss, by name."""

    def precondition(self) -> None:  # noqa: B027 - some trainers change nothing
        """Change gradients and parameters before the optimiser does."""

    def step(self, n_rays: int) -> dict[str, float]:
        """Make one step; returns the terms of its loss."""
        self.prepare()
        terms = self.losses(self.rays.batch(n_rays, self.generator))
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
        self.precondition()
        self.optimiser.step()
        self.step_number += 1
        return values

    def photo_terms(
        self,
        rendering: Rendering,
        batch: RayBatch,
        mask_weight: float,
        *,
        solid: bool,
        lenient: bool = False,
    ) -> dict[str, Tensor]:
        """Colour, and silhouette where it is known.

        solid: the colour is divided by the opacity before the comparison, and weighted by it
            without gradient: otherwise a soft rim would be pushed outwards. Without, as in NeuS,
            the colour is compared directly.
        lenient: silhouettes pull only where a ray is on the wrong side of one half: a ray that
            grazes a face is never opaque while the density is soft.
        """
        if not self.rays.has_masks:
            return {"colour": (rendering.colour - batch.colours).abs().mean()}
        colour, opacity, share = rendering.colour, rendering.opacity, batch.inside
        if solid:
            colour = colour / opacity.clamp(min=_OPACITY_RIM)[:, None]
            share = share * opacity.detach()
        difference = (colour - batch.colours).abs().mean(dim=1)
        terms = {"colour": (difference * share).sum() / batch.inside.sum().clamp(min=1.0)}
        # Scaled, not clamped as in NeuS: a clamp has no gradient where the background is opaque,
        # and the surface would stay outside.
        bounded = _OPACITY_RIM + (1.0 - 2.0 * _OPACITY_RIM) * opacity.clamp(max=1.0)
        wrong = binary_cross_entropy(bounded, batch.inside, batch.known, reduction="none")
        if lenient:
            wrong = torch.relu(wrong - math.log(2.0))
        terms["mask"] = mask_weight * wrong.mean()
        return terms

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

    @abstractmethod
    def _enter(self, surface: NeuralSurface) -> None:
        """Continue with this surface and a new optimiser."""


_SHARPNESS_RATE = 10.0
"""The sharpness is exp(10 v): log s moves ten times as fast as v."""


class MlpTrainer(PhotoTrainer):
    """Adam with a warm-up and a cosine; the sharpness is learned.

    Wang et al., NeuS, 2021, section 4.1 and appendix, which the paper adopts unchanged.
    """

    def __init__(self, rays: PhotoRays, surface: NeuralSurface, config: MlpPhotoConfig) -> None:
        super().__init__(rays, surface, config.seed)
        self.config, self.n_steps = config, config.n_steps
        self._enter(surface)

    def _enter(self, surface: NeuralSurface) -> None:
        self.surface = surface
        self.optimiser = torch.optim.Adam(
            [{"params": list(surface.modules().parameters())}, {"params": [surface.log_inv_s]}]
        )

    def prepare(self) -> None:
        """Set the rates."""
        config, step = self.config, self.step_number
        if step < config.warmup_steps:
            factor = step / config.warmup_steps
        else:
            n_falling = max(config.n_steps - config.warmup_steps, 1)
            cosine = 0.5 * (1.0 + math.cos(math.pi * (step - config.warmup_steps) / n_falling))
            factor = config.final_rate + (1.0 - config.final_rate) * cosine
        for group, scale in zip(self.optimiser.param_groups, (1.0, _SHARPNESS_RATE), strict=True):
            group["lr"] = config.rate * factor * scale

    def losses(self, batch: RayBatch) -> dict[str, Tensor]:
        """Colour, silhouette, and the eikonal term at the samples within the ball."""
        config = self.config
        anneal = 1.0
        if not self.rays.has_masks and config.anneal_steps > 0:
            anneal = min(1.0, self.step_number / config.anneal_steps)
        rendering = self.surface.render_rays(
            (batch.origins, batch.directions),
            inv_s=self.surface.log_inv_s.exp(),
            anneal=anneal,
            generator=self.generator,
        )
        terms = self.photo_terms(rendering, batch, config.mask_weight, solid=False)
        slope = rendering.gradient.norm(dim=2)
        terms["eikonal"] = config.eikonal_weight * ((slope - 1.0) ** 2).mean()
        return terms
