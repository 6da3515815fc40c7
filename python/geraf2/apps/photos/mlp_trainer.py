"""Training of NeuS's networks with NeuS's schedule."""

import math

import torch
from torch import Tensor

from geraf2.apps.photos.config import MlpPhotoConfig
from geraf2.apps.photos.neural_surface import NeuralSurface
from geraf2.apps.photos.rays import PhotoRays, RayBatch
from geraf2.apps.photos.trainer import PhotoTrainer

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
