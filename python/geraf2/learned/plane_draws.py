"""Random draws of a training step: planes, antennas, rays and targets."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Ints
from geraf2.learned.config import PaperConfig
from geraf2.learned.heatmaps import MeasuredMaps, TargetChooser, bright_rays
from geraf2.learned.lensless import LenslessRenderer
from geraf2.learned.ray_sampling import PrimaryRays
from geraf2.scene import Capture, Pose


class PlaneDraw(NamedTuple):
    """Antennas, rays and targets of one plane in one step."""

    plane: int
    antennas: Ints
    rays: PrimaryRays
    targets: Tensor


class PlaneDraws:
    """Source of all random draws of a training, from one generator.

    renderer: its sampler draws the rays, its vision field bounds the targets.
    maps: measured heat maps; bright voxels are preferred as targets.
    device: where rays are needed.
    """

    def __init__(
        self,
        capture: Capture,
        config: PaperConfig,
        renderer: LenslessRenderer,
        maps: MeasuredMaps,
        *,
        device: torch.device,
        seed: int = 0,
    ) -> None:
        self.capture, self.config, self.planes = capture, config, range(len(capture.poses))
        self.n_planes = min(config.n_planes, len(self.planes))
        """Planes of a step."""
        self.device = device
        self.sampler = renderer.sampler
        depth_m = config.crop_m if config.region == "content" else 0.0
        self.within = renderer.vision.field.sample(maps.grid.points()) < -depth_m
        """Voxels of the maps that may be targets."""
        self.targets = TargetChooser(maps, self.within, config.bright_targets)
        self.bright = {}
        """Rays of each plane that may be drawn, see :func:`bright_rays`; empty: all."""
        if config.dark_scene > 0.0 and config.dark_plane > 0.0:
            dark = {"dark_plane": config.dark_plane, "dark_scene": config.dark_scene}
            for plane in self.planes:
                axes = capture.poses[plane].axes
                self.bright[plane] = bright_rays(maps, plane, self.sampler, axes, **dark)
        self.generator = torch.Generator().manual_seed(seed)

    def planes_of_step(self) -> list[int]:
        """Planes of a step: evenly spaced in the scan from a random first one."""
        n = len(self.planes)
        first = int(torch.randint(n, (1,), generator=self.generator))
        return [(first + k * n // self.n_planes) % n for k in range(self.n_planes)]

    def draw(self, plane: int) -> PlaneDraw:
        """Draw antennas, rays and targets of a plane, in this order."""
        pose = self.capture.poses[plane]
        antennas = self.draw_antennas(pose)
        rays = self.sampler.sample(pose.axes, self.generator, keep=self.bright.get(plane))
        targets = self.targets.choose(plane, self.config.n_targets, self.generator)
        return PlaneDraw(plane, antennas, rays.to(self.device), targets)

    def draw_antennas(self, pose: Pose) -> Ints:
        """Antennas of a plane, or of a random window of it, ascending."""
        config = self.config
        candidates = np.arange(pose.n_antennas)
        if config.window_m > 0.0:
            positions = pose.phase_centers @ np.asarray(pose.axes)[1:].T
            low, high = positions.min(axis=0), positions.max(axis=0)
            half = 0.5 * np.minimum(config.window_m, high - low)
            share = torch.rand(2, generator=self.generator, dtype=torch.float64).numpy()
            middle = low + half + share * (high - low - 2.0 * half)
            candidates = np.flatnonzero((np.abs(positions - middle) <= half + 1e-6).all(axis=1))
        drawn = torch.randperm(len(candidates), generator=self.generator)[: config.n_antennas]
        return np.sort(candidates[drawn.numpy()])

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Restore the generator afterwards, so that the training's next draws stay the same."""
        state = self.generator.get_state()
        try:
            yield
        finally:  # an interrupted run saves the generator
            self.generator.set_state(state)
