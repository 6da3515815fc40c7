"""Fields of the paper's method, their start, and the renderer of a scene."""

from dataclasses import replace

import numpy as np
from torch import nn

from geraf2._types import Floats
from geraf2.fields import NestedSets, SphereSolid
from geraf2.learned.config import PaperConfig
from geraf2.learned.fields import (
    CubeDomain,
    LearnedSdfGrid,
    Power,
    ReflectivityGrid,
    ReflectivityMlp,
    SdfField,
    SdfMlp,
    SdfMlpConfig,
    Sharpness,
)
from geraf2.learned.lensless import LenslessRenderer, VisionPrior
from geraf2.learned.ray_sampling import LenslessSampler
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior, Waveform

DOMAIN_MARGIN = 1.25
"""Side of the fields' cube relative to the prior's longest: holds the scene's boundary."""
CONTENT_MARGIN = 1.05
"""The same where the cube holds the content alone: half a voxel of air around it."""


class PaperModel(nn.Module):
    """Signed distance, reflectivity, power, sharpness."""

    sdf: SdfField

    def __init__(self, domain: CubeDomain, config: PaperConfig, *, seed: int = 0) -> None:
        super().__init__()
        if config.field == "grid":
            self.sdf = LearnedSdfGrid(domain, n_per_side=config.grid_n[0])
        else:
            self.sdf = SdfMlp(domain, SdfMlpConfig(fit_steps=config.mlp_fit_steps), seed=seed)
        self.reflectivity: nn.Module
        if config.field == "grid":
            self.reflectivity = ReflectivityGrid(domain, n_per_side=config.reflectivity_n)
        else:
            self.reflectivity = ReflectivityMlp(domain, seed=seed + 1)
        self.power = Power()
        self.sharpness = Sharpness(config.inv_s_start)


def domain_of(prior: LosPrior, config: PaperConfig) -> CubeDomain:
    """Cube in which the fields live: around the scene, or around the content."""
    if config.region == "content":
        return _cube(prior.crop(config.crop_m), CONTENT_MARGIN)
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
        self.vision = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
        ball = SphereSolid(
            radius_m=0.5 * config.start_radius * min(prior.size_m), center_m=prior.center_m
        )
        self._start = config.start
        self._ball = ball
        self._inner = None
        if prior.walls and not prior.is_turned:
            wall = prior.walls[0]
            if config.field != "mlp":
                # A thinner wall would fall between the voxels; its outer face stays.
                voxel_m = DOMAIN_MARGIN * max(prior.size_m) / (config.grid_n[-1] - 1)
                wall = replace(wall, thickness_m=max(wall.thickness_m, 1.5 * voxel_m))
            self._inner = NestedSets.from_walls([wall], ball)

    def __call__(self, points: Floats) -> Floats:
        """Distance at points (n, 3) [m] -> (n,) [m]."""
        if self._start == "vision":
            return self.vision.signed_distance(points)
        if self._start == "ball" or self._inner is None:
            # Outside the box that of the vision field; inside, the nearer one of ball and wall.
            ball = self._ball.signed_distance(points)
            outer = self.vision.signed_distance(points)
            if self._start == "ball":
                return ball
            return np.where(ball < 0.0, ball, np.minimum(ball, np.abs(outer)))
        return self._inner.signed_distance(points)


def make_renderer(
    waveform: Waveform, prior: LosPrior, config: PaperConfig, *, num_threads: int | None = None
) -> LenslessRenderer:
    """Lensless renderer of a scene, with its sampler and the frozen vision field."""
    delay_m = sum(wall.one_way_delay_m for wall in prior.walls) if config.wall_delay else 0.0
    vision = StartDistance(prior, config, num_threads=num_threads).vision
    return LenslessRenderer(
        LenslessSampler(
            prior,
            n_cells=config.n_cells,
            n_samples=config.n_samples,
            inner=prior.crop(config.crop_m) if config.region == "content" else None,
            num_threads=num_threads,
        ),
        VisionPrior(vision.signed_distance, scene_domain(prior)),
        waveform,
        config,
        wall_delay_m=delay_m,
    )
