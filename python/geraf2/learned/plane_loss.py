"""Loss of one plane: the terms of equations 13 and 16 of the paper."""

from typing import NamedTuple

import torch
from torch import Tensor

from geraf2.learned.config import PaperConfig
from geraf2.learned.fields import SdfField
from geraf2.learned.heatmaps import MeasuredMaps, heat_maps
from geraf2.learned.lensless import LenslessRenderer, RenderedSignal
from geraf2.learned.model import PaperModel
from geraf2.learned.plane_draws import PlaneDraw
from geraf2.learned.ray_sampling import PrimaryRays
from geraf2.learned.stages import TrainingStages
from geraf2.ops import ray_march
from geraf2.ops.lensless import length_defect
from geraf2.scene import Capture


def charbonnier(difference: Tensor, width: float) -> Tensor:
    """Mean of sqrt(d^2 + width^2) - width: quadratic near zero, linear beyond `width`."""
    return (torch.sqrt(difference.square() + width * width) - width).mean()


def heatmap_loss(rendered: Tensor, measured: Tensor, scale: float, width: float) -> Tensor:
    """L_MF: Charbonnier of the difference of two heat maps (n_targets,), in units of `scale`."""
    return charbonnier((rendered - measured) / scale, width)


def eikonal_loss(gradient: Tensor) -> Tensor:
    """L_GRAD: mean of (|grad f| - 1)^2 over samples (n, 3). Gropp et al. 2020, equation 2."""
    return length_defect(gradient)


def depth_loss(radar: Tensor, vision: Tensor) -> Tensor:
    """L_RSDF: mean |d_v - d_r| of expected depths along primary rays (n_rays,) [m].

    Equations 14 and 15 of the paper, with d = integral of u rho T du.
    """
    return (vision - radar).abs().mean()


class PlaneGradient(NamedTuple):
    """Contribution of one plane to a step."""

    terms: tuple[float, float, float]
    """Heat map, eikonal, depth."""
    gradients: tuple[Tensor | None, ...]
    """Gradients to the given leaves, in their order."""


class PlaneLoss:
    """Renders draws of planes and compares them with the measured signals.

    maps: their scale is the unit of the heat map term.
    stages: of the training; the current stage weighs the terms.
    """

    def __init__(
        self,
        capture: Capture,
        config: PaperConfig,
        renderer: LenslessRenderer,
        model: PaperModel,
        maps: MeasuredMaps,
        stages: TrainingStages,
    ) -> None:
        self.capture, self.config, self.renderer = capture, config, renderer
        self.model, self.maps, self.stages = model, maps, stages

    def gradient(self, draw: PlaneDraw, leaves: list[Tensor], share: int) -> PlaneGradient:
        """Terms of a plane's loss, and the gradient of that loss divided by `share`."""
        config, stage = self.config, self.stages.current
        rendered = self.render(draw)
        heatmap = heatmap_loss(
            *self.heat_maps(draw, rendered.signal), self.maps.scale, config.charbonnier
        )
        eikonal = eikonal_loss(rendered.gradient)
        rsdf = heatmap.new_zeros(())
        if stage.rsdf_weight > 0.0:
            rsdf = self.depth_alignment(rendered, draw.rays)
        loss = heatmap + config.eikonal_weight * eikonal + stage.rsdf_weight * rsdf
        terms = (heatmap.item(), eikonal.item(), rsdf.item())
        for name, term in zip(("heat map", "eikonal", "depth"), terms, strict=True):
            self.stages.require_finite(f"the {name} term of the loss", term)
        return PlaneGradient(terms, torch.autograd.grad(loss / share, leaves, allow_unused=True))

    def render(
        self, draw: PlaneDraw, inv_s: float | None = None, field: SdfField | None = None
    ) -> RenderedSignal:
        """Signals of the drawn antennas.

        inv_s: sharpness [1/m]; the model's when None.
        field: signed distance; the model's when None.
        """
        pose, antennas = self.capture.poses[draw.plane], draw.antennas
        sharpness = self.model.sharpness()
        return self.renderer.render(
            self.model.sdf if field is None else field,
            self.model.reflectivity if self.stages.current.train_reflectivity else None,
            self.model.power(),
            sharpness if inv_s is None else torch.full_like(sharpness, inv_s),
            draw.rays,
            pose.tx_positions[antennas],
            pose.rx_positions[antennas],
        )

    def heat_maps(self, draw: PlaneDraw, signal: Tensor) -> tuple[Tensor, Tensor]:
        """Heat maps of rendered and of measured signals."""
        pose = self.capture.poses[draw.plane]
        return heat_maps(
            *(pose, self.capture.waveform, draw.antennas, signal, draw.targets.numpy()),
            floor=1e-6 * self.maps.scale,
        )

    def depth_alignment(self, rendered: RenderedSignal, rays: PrimaryRays) -> Tensor:
        """L_RSDF: rendered depth against that of the vision field along the same rays."""
        points, step, offset = rays.points, rays.step, rays.offset
        if self.config.region == "content":  # the vision surface lies before the content's samples
            n_samples = step.shape[1]
            step = ((offset + step.sum(dim=1)) / n_samples)[:, None].expand(step.shape)
            middle = torch.cumsum(step, dim=1) - 0.5 * step
            points = rays.starts[:, None] + middle[..., None] * rays.direction
            offset = torch.zeros_like(offset)
        shape = step.shape
        value, gradient = self.renderer.vision.sample(points.reshape(-1, 3))
        cosine = (gradient @ rays.direction).reshape(shape)
        with torch.no_grad():
            inv_s = self.model.sharpness().detach()
            march = ray_march(value.reshape(shape), cosine, step, inv_s, two_way="none")
        weight = torch.as_tensor(march.weight)
        depth = torch.as_tensor(march.depth) + offset * weight.sum(dim=1)
        return depth_loss(rendered.depth, depth)
