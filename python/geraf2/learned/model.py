"""The networks of the paper's method, their start, and their optimiser."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from geraf2._types import Floats
from geraf2.fields import MeshSolid, NestedSets, SphereSolid
from geraf2.learned.config import FULL_RATE_STEPS, PaperConfig, StageConfig
from geraf2.learned.fields import (
    CubeDomain,
    LearnedSdfGrid,
    LearnedSdfGridConfig,
    Power,
    ReflectivityGrid,
    ReflectivityGridConfig,
    ReflectivityMlp,
    SdfField,
    SdfMlp,
    SdfMlpConfig,
    SdfMlpGrid,
    Sharpness,
)
from geraf2.scene import LosPrior

DOMAIN_MARGIN = 1.25
"""Side of the fields' cube relative to the prior's longest: holds the scene's boundary."""
CONTENT_MARGIN = 1.05
"""The same where the cube holds the content alone: half a voxel of air around it."""


class PaperModel(nn.Module):
    """Signed distance, reflectivity, power, sharpness."""

    sdf: SdfField

    def __init__(self, domain: CubeDomain, config: PaperConfig, *, seed: int = 0) -> None:
        super().__init__()
        network, n_first = SdfMlpConfig(fit_steps=config.mlp_fit_steps), config.grid_n[0]
        if config.field == "grid":
            self.sdf = LearnedSdfGrid(domain, LearnedSdfGridConfig(n_per_side=n_first))
        elif config.field == "mlp-grid":
            self.sdf = SdfMlpGrid(domain, network, n_per_side=n_first, seed=seed)
        else:
            self.sdf = SdfMlp(domain, network, seed=seed)
        self.reflectivity: nn.Module
        if config.field == "grid":
            self.reflectivity = ReflectivityGrid(
                domain, ReflectivityGridConfig(n_per_side=config.reflectivity_n)
            )
        else:
            self.reflectivity = ReflectivityMlp(domain, seed=seed + 1)
        self.power = Power()
        self.sharpness = Sharpness(config.inv_s_start)


def domain_of(prior: LosPrior, config: PaperConfig) -> CubeDomain:
    """Cube in which the fields live: around the scene, or around the content."""
    if config.region == "content":
        return _cube(prior.cropped(config.crop_m), CONTENT_MARGIN)
    return scene_domain(prior)


def scene_domain(prior: LosPrior) -> CubeDomain:
    """Cube around the box that holds the scene's boundary."""
    return _cube(prior, DOMAIN_MARGIN)


def _cube(prior: LosPrior, margin: float) -> CubeDomain:
    return CubeDomain(center_m=prior.center_m, half_side_m=0.5 * margin * max(prior.size_m))


class StartDistance:
    """Signed distance that the field starts from; see PaperConfig.start."""

    def __init__(
        self, prior: LosPrior, config: PaperConfig, *, num_threads: int | None = None
    ) -> None:
        self.vision = MeshSolid(prior.mesh, num_threads=num_threads)
        ball = SphereSolid(
            radius_m=0.5 * config.start_radius * min(prior.size_m), center_m=prior.center_m
        )
        self._start = config.start
        self._ball = ball
        self._inner = None
        if prior.walls:
            wall = prior.walls[0]
            if config.field != "mlp":
                # A thinner wall falls between the voxels; its outer face, which the scan sees and
                # the vision field knows, stays where it is.
                voxel_m = DOMAIN_MARGIN * max(prior.size_m) / (config.grid_n[-1] - 1)
                wall = replace(wall, thickness_m=max(wall.thickness_m, 1.5 * voxel_m))
            self._inner = NestedSets.from_walls([wall], ball)

    def __call__(self, points: Floats) -> Floats:
        """Distance at points (n, 3) [m] -> (n,) [m]."""
        if self._start == "vision":
            return self.vision.signed_distance(points)
        if self._start == "ball" or self._inner is None:
            # Outside the box the vision field holds; inside, what is nearer of ball and wall.
            ball = self._ball.signed_distance(points)
            outer = self.vision.signed_distance(points)
            if self._start == "ball":
                return ball
            return np.where(ball < 0.0, ball, np.minimum(ball, np.abs(outer)))
        return self._inner.signed_distance(points)


class _Named(NamedTuple):
    name: str
    parameter: Tensor
    rate: float
    decay: float


def trained_parameters(
    model: PaperModel, config: PaperConfig, stage: StageConfig
) -> Iterator[_Named]:
    """Parameters that a stage trains, each with its rate and weight decay."""
    for name, parameter in model.named_parameters():
        part = name.split(".")[0]
        is_grid = config.field == "grid"
        if part == "reflectivity" and not stage.train_reflectivity:
            continue
        if part == "sharpness" and config.sharpness == "scheduled":
            continue
        if part == "sdf":
            rate = config.mlp_rate
            if isinstance(model.sdf, LearnedSdfGrid):
                # Finer voxels see fewer points a step, hence noisier gradients.
                rate = config.grid_rate * config.grid_n[0] / model.sdf.grid.shape[0]
                # Adam's steps are as long by noise as by signal: more of them carve more.
                rate *= min(FULL_RATE_STEPS / max(config.stage1.n_steps, 1), 1.0)
            rate *= stage.shape_rate
        elif part == "power":
            rate = config.power_rate
        elif part == "reflectivity" and is_grid:
            rate = 10.0 * config.other_rate  # logits of a grid: no other weight multiplies them
        else:
            rate = config.other_rate
        is_network = not is_grid and part in ("sdf", "reflectivity")
        yield _Named(name, parameter, rate, config.weight_decay if is_network else 0.0)


def make_optimiser(model: PaperModel, config: PaperConfig, stage: StageConfig) -> torch.optim.AdamW:
    """AdamW with a group a parameter, so that each has its own rate."""
    groups = [
        {"params": [p], "lr": rate, "weight_decay": decay, "name": name, "base_rate": rate}
        for name, p, rate, decay in trained_parameters(model, config, stage)
    ]
    return torch.optim.AdamW(groups, eps=1e-10)


def take_over(optimiser: torch.optim.Optimizer, earlier: torch.optim.Optimizer) -> None:
    """Go on with what another optimiser knows of parameters of the same name.

    Adam that begins anew knows nothing of a parameter's gradients: its first steps are as long as
    its rate allows, by noise as by signal, and undo what small rates had settled.
    """
    known = {group["name"]: earlier.state.get(group["params"][0]) for group in earlier.param_groups}
    for group in optimiser.param_groups:
        state = known.get(group["name"])
        if state:
            optimiser.state[group["params"][0]] = {k: v.clone() for k, v in state.items()}


def blur(volume: Tensor, width: float) -> Tensor:
    """Blur a volume (x, y, z) by a Gaussian of standard deviation `width` [voxels].

    Edges are repeated outward. Descending along blurred gradients is descent in a smoother
    metric (Renka and Neuberger 1995), as used for surfaces by Nicolet et al. 2021.
    """
    reach = max(math.ceil(2.5 * width), 1)
    places = torch.arange(-reach, reach + 1, dtype=volume.dtype, device=volume.device)
    kernel = torch.exp(-0.5 * (places / width).square())
    kernel = kernel / kernel.sum()
    out = volume[None, None]
    for axis in range(3):
        shape, padding = [1, 1, 1], [0] * 6
        shape[axis] = kernel.numel()
        padding[4 - 2 * axis] = padding[5 - 2 * axis] = reach
        padded = torch.nn.functional.pad(out, padding, mode="replicate")
        out = torch.nn.functional.conv3d(padded, kernel.reshape(1, 1, *shape))
    return out[0, 0]
