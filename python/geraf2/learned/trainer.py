"""The two stages of the paper's training, one step after the other."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import label, maximum
from torch import Tensor

from geraf2._types import Floats, Ints
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.learned import glint_level
from geraf2.learned.config import PaperConfig, StageConfig
from geraf2.learned.fields import LearnedSdfGrid, SdfField, SdfMlp, SdfMlpGrid
from geraf2.learned.fields.learning_rate import set_rates
from geraf2.learned.glint_level import GlintShift
from geraf2.learned.heatmaps import (
    MeasuredMaps,
    TargetChooser,
    bright_rays,
    heat_maps,
    measure_maps,
)
from geraf2.learned.losses import depth_loss, eikonal_loss, heatmap_loss
from geraf2.learned.model import (
    PaperModel,
    StartDistance,
    blur,
    domain_of,
    make_optimiser,
    scene_domain,
    take_over,
)
from geraf2.learned.plane_threads import PlaneThreads
from geraf2.learned.rendering.lensless import LenslessRenderer, RenderedSignal, VisionPrior
from geraf2.learned.rendering.sampling import LenslessSampler, PrimaryRays, SamplingConfig
from geraf2.ops import ray_march
from geraf2.scene import Capture, LosPrior, Pose, Waveform

_POWER_PLANES = 6


def make_renderer(
    waveform: Waveform, prior: LosPrior, config: PaperConfig, *, num_threads: int | None = None
) -> LenslessRenderer:
    """Sampler, frozen vision field and renderer as a config says."""
    delay_m = sum(wall.one_way_delay_m for wall in prior.walls) if config.wall_delay else 0.0
    vision = StartDistance(prior, config, num_threads=num_threads).vision
    return LenslessRenderer(
        LenslessSampler(
            prior,
            SamplingConfig(n_cells=config.n_cells, n_samples=config.n_samples),
            inner=prior.cropped(config.crop_m) if config.region == "content" else None,
            num_threads=num_threads,
        ),
        VisionPrior(vision.signed_distance, scene_domain(prior)),
        waveform,
        config,
        wall_delay_m=delay_m,
    )


def training_device(config: PaperConfig) -> torch.device:
    """Device that a config asks for; UserError for a GPU that torch does not have."""
    has_gpu = torch.cuda.is_available()
    if config.device == "cuda" and not has_gpu:
        raise UserError(
            what="torch has no GPU here",
            where="--paper.device cuda",
            hint="use --paper.device auto, or install a torch with CUDA",
        )
    return torch.device("cuda" if has_gpu and config.device != "cpu" else "cpu")


def without_wall_pieces(sdf: SdfGrid, outside: SdfGrid, crop_m: float, detail_m: float) -> SdfGrid:
    """Turn outward the pieces of a field that lie flat at the crop: echoes of walls beyond it.

    outside: signed distance to the outside of the box, negative within.
    crop_m: how far below that the field is cut [m].
    detail_m: the least detail of the field; a piece that reaches no deeper below the cut goes [m].
    """
    labels, n_pieces = label(sdf.values < 0.0)
    depth = -outside.sample(sdf.grid.points()).reshape(sdf.grid.shape) - crop_m
    deepest = maximum(depth, labels, np.arange(n_pieces + 1))
    is_flat = np.asarray(deepest) <= detail_m
    is_flat[0] = False  # what is no piece
    turned = np.where(is_flat[labels], np.abs(sdf.values), sdf.values)
    return SdfGrid(grid=sdf.grid, values=turned.astype(sdf.values.dtype))


class StepReport(NamedTuple):
    """What one step found."""

    stage: int
    step: int
    heatmap: float
    eikonal: float
    rsdf: float
    power: float
    inv_s: float


class PlaneDraw(NamedTuple):
    """What a step draws of a plane."""

    plane: int
    antennas: Ints
    rays: PrimaryRays
    targets: Tensor


class PlaneGradient(NamedTuple):
    """What one plane adds to a step."""

    terms: tuple[float, float, float]
    """Heat map, eikonal, depth."""
    gradients: tuple[Tensor | None, ...]
    """To the trainer's leaves, in their order."""


@dataclass
class Remembered:
    """Antennas of a plane whose signals earlier steps rendered."""

    antennas: Ints
    signal: Tensor


class PaperTrainer:
    """Trains the fields of one capture.

    prior: outside of the box; f_v is the distance to it.
    config: every choice.
    planes: indices of the planes to train on; all when None.
    seed: of networks and samples.

    Notes
    -----
    Bit-identical for a given seed and number of threads, also when it was stopped and resumed. On
    a GPU draws are the same, sums are not: they are taken in any order. On a CPU the planes of a
    step are rendered side by side, unless `config.field` is "mlp".
    """

    def __init__(
        self,
        capture: Capture,
        prior: LosPrior,
        config: PaperConfig,
        *,
        planes: list[int] | None = None,
        seed: int = 0,
        num_threads: int | None = None,
        maps: MeasuredMaps | None = None,
    ) -> None:
        self.capture, self.prior, self.config = capture, prior, config
        self.device = training_device(config)
        self.planes = list(range(len(capture.poses))) if planes is None else list(planes)
        self.n_drawn = min(config.n_planes, len(self.planes))
        # A network's products have threads of their own, and its weights are computed once a call.
        alone = self.device.type == "cuda" or config.field == "mlp"
        self.threads = PlaneThreads(1 if alone else self.n_drawn, num_threads=num_threads)
        self.domain = domain_of(prior, config)
        start = StartDistance(prior, config, num_threads=num_threads)
        self.renderer = make_renderer(
            capture.waveform, prior, config, num_threads=self.threads.n_of_plane
        )
        self.sampler, self.vision = self.renderer.sampler, self.renderer.vision
        self.maps = (
            measure_maps(capture, self.domain, num_threads=num_threads) if maps is None else maps
        )
        deep_m = config.crop_m if config.region == "content" else 0.0
        # Voxels of the maps that may be targets.
        self.within = self.vision.field.sample(self.maps.grid.points()) < -deep_m
        self.targets = TargetChooser(self.maps, self.within, config.bright_targets)
        # Rays of each plane that are drawn: those of its map that are bright where any map is.
        self.bright = (
            {
                plane: bright_rays(
                    self.maps,
                    plane,
                    self.sampler,
                    capture.poses[plane].axes,
                    dark_plane=config.dark_plane,
                    dark_scene=config.dark_scene,
                )
                for plane in self.planes
            }
            if config.dark_scene > 0.0 and config.dark_plane > 0.0
            else {}
        )
        self.generator = torch.Generator().manual_seed(seed)
        self.model = PaperModel(self.domain, config, seed=seed)
        self.stage, self.step_in_stage = 1, 0
        self._set_octaves()
        self.model.sdf.initialise(start, seed=seed)
        self.model.to(self.device)
        self.model.sdf.refresh()
        self.remembered: dict[int, list[Remembered]] = {}
        self.glint_shift: GlintShift | None = None
        self._start_power()
        self.optimiser = make_optimiser(self.model, config, self.stage_config)

    @property
    def stage_config(self) -> StageConfig:
        """Of the stage that runs."""
        return self.config.stage1 if self.stage == 1 else self.config.stage2

    @property
    def total_steps(self) -> int:
        """Of both stages."""
        return self.config.stage1.n_steps + self.config.stage2.n_steps

    @property
    def steps_done(self) -> int:
        """In both stages."""
        return self.step_in_stage + (0 if self.stage == 1 else self.config.stage1.n_steps)

    @property
    def is_done(self) -> bool:
        """Whether both stages are over."""
        return self.steps_done >= self.total_steps

    def advance(self) -> StepReport:
        """Make one step: go to the next stage or level where it is due, render, compare, train."""
        if self.stage == 1 and self.step_in_stage >= self.config.stage1.n_steps:
            self.begin_stage_2(self.optimiser)
        self._set_level()
        self._set_sharpness()
        self._set_octaves()
        set_rates(
            self.optimiser,
            self.step_in_stage / max(self.stage_config.n_steps, 1),
            self.config.final_rate,
        )
        report = self._step()
        self.step_in_stage += 1
        return report

    def begin_stage_2(self, earlier: torch.optim.Optimizer) -> None:
        """Go on from the end of a stage 1, whose optimiser is `earlier`."""
        self.stage, self.step_in_stage = 2, 0
        self.optimiser = make_optimiser(self.model, self.config, self.stage_config)
        take_over(self.optimiser, earlier)

    def distance(self) -> SdfGrid:
        """Trained distance on the grid of the mesh, without what walls leave at the crop.

        With `glint_level` the zero level lies as deep as the glints.
        """
        self.model.sdf.refresh()
        sdf = self.model.sdf.sample_grid(self.domain.grid(self.config.mesh_n))
        detail_m = 2.0 * self.domain.half_side_m / (self.config.grid_n[-1] - 1)
        if self.config.glint_level:
            depths = glint_level.part_depths(sdf)
            most_m = glint_level.MOST_INWARD * detail_m
            self.glint_shift = self.find_glint_shift(sdf, depths, most_m)
            sdf = glint_level.moved(sdf, self.glint_shift.inward_m, depths)
        if self.config.region == "scene":
            return sdf
        return without_wall_pieces(sdf, self.vision.field, self.config.crop_m, detail_m)

    def find_glint_shift(
        self, sdf: SdfGrid, depths: NDArray[np.float32], most_m: float
    ) -> GlintShift:
        """By how much to move the surface of a distance to the measured depth of its glints.

        Of each plane a few windows of antennas, and the place beside the surface where both maps
        are bright.

        depths: as in :func:`geraf2.learned.glint_level.moved` [m].
        most_m: inward the surface is moved by that at most [m].
        """
        places = self.maps.grid.points()[self.within.reshape(-1)]
        places = places[np.abs(sdf.sample(places)) < glint_level.BESIDE_M]
        shift = GlintShift()
        if not places.size:  # no surface
            return shift
        for _ in range(glint_level.N_ROUNDS):
            field = LearnedSdfGrid(self.domain)
            now = glint_level.moved(sdf, shift.inward_m, depths)
            field.regrid(now.grid, torch.from_numpy(now.values))
            find = partial(self._glint_depth, field=field.to(self.device), places=places)
            with self._draws_aside():
                self.generator.manual_seed(glint_level.SEED)
                found = [
                    d for plane in self.planes for d in self.threads.map(find, self._windows(plane))
                ]
            shift = shift.after([depth for depth in found if depth is not None], most_m)
        return shift

    def _windows(self, plane: int) -> list[list[PlaneDraw]]:
        """Windows of antennas of a plane, each with several draws of rays."""
        windows = []
        for _ in range(glint_level.N_WINDOWS):
            draws = [self._draw(plane) for _ in range(glint_level.N_DRAWS)]
            windows.append([draw._replace(antennas=draws[0].antennas) for draw in draws])
        return windows

    @torch.no_grad()
    def _glint_depth(self, draws: list[PlaneDraw], field: SdfField, places: Floats) -> float | None:
        """How far the glint of a window is rendered behind the measured one [m]."""
        first = draws[0]
        signals = [self._rendered(draw, glint_level.INV_S, field).signal for draw in draws]
        rendered, measured = self._powers(first, signals[0], places)
        glint = places[int((rendered * measured).argmax())]
        window = self.capture.poses[first.plane].phase_centers[first.antennas].mean(axis=0)
        line = glint_level.line_of_sight(glint, window)
        powers = [self._powers(first, signal, line) for signal in signals]
        rendered = np.sum([own for own, _ in powers], axis=0)
        return glint_level.depth_difference(rendered, powers[0][1])

    def _powers(self, draw: PlaneDraw, signal: Tensor, places: Floats) -> tuple[Floats, Floats]:
        """Powers of the rendered and of the measured map at places (n, 3) [m], (n,) each."""
        parts = np.array_split(places, -(-len(places) // glint_level.PLACES_AT_ONCE))
        maps = [
            self._heatmaps(draw._replace(targets=torch.from_numpy(part)), draw.antennas, signal)
            for part in parts
        ]
        rendered, measured = (
            torch.cat(m).double().square().cpu().numpy() for m in zip(*maps, strict=True)
        )
        return rendered, measured

    @contextmanager
    def _draws_aside(self) -> Iterator[None]:
        """Draw what the training does not know of: its next draws stay as they are."""
        state = self.generator.get_state()
        try:
            yield
        finally:  # a run that is stopped meanwhile saves the generator
            self.generator.set_state(state)

    def _set_level(self) -> None:
        sdf = self.model.sdf
        if self.stage != 1 or not isinstance(sdf, LearnedSdfGrid | SdfMlpGrid):
            return
        levels, n_steps = self.config.grid_n, max(self.config.stage1.n_steps, 1)
        wanted = levels[min(len(levels) * self.step_in_stage // n_steps, len(levels) - 1)]
        if wanted > sdf.grid.shape[0]:
            sdf.upsample(wanted)
            if isinstance(sdf, LearnedSdfGrid):
                self.optimiser = make_optimiser(self.model, self.config, self.stage_config)

    @property
    def _progress(self) -> float:
        """Share of stage 1 that is over."""
        if self.stage == 2:
            return 1.0
        return self.step_in_stage / max(self.config.stage1.n_steps, 1)

    def _set_octaves(self) -> None:
        sdf, first, last = self.model.sdf, self.config.octaves_start, self.config.octaves_end
        network = sdf.network if isinstance(sdf, SdfMlpGrid) else sdf
        if isinstance(network, SdfMlp):
            network.open_octaves(first + self._progress * (last - first))

    def _set_sharpness(self) -> None:
        if self.config.sharpness != "scheduled":
            return
        progress = self._progress
        low, high = math.log(self.config.inv_s_start), math.log(self.config.inv_s_end)
        self.model.sharpness.set(math.exp(low + progress * (high - low)))

    def _step(self) -> StepReport:
        """One step of the optimiser along the mean gradient of several planes."""
        terms = self._take_gradients()
        self._condition_gradients()
        self.optimiser.step()
        heatmap, eikonal, rsdf = (sum(term) / len(terms) for term in zip(*terms, strict=True))
        return StepReport(
            stage=self.stage,
            step=self.step_in_stage,
            heatmap=heatmap,
            eikonal=eikonal,
            rsdf=rsdf,
            power=self.model.power().item(),
            inv_s=self.model.sharpness().item(),
        )

    def _draw_planes(self) -> list[int]:
        """Planes of a step: neighbours in the scan lie as far apart as they can."""
        n = len(self.planes)
        first = int(torch.randint(n, (1,), generator=self.generator))
        return [self.planes[(first + k * n // self.n_drawn) % n] for k in range(self.n_drawn)]

    def _take_gradients(self) -> list[tuple[float, float, float]]:
        """Give the parameters the mean gradient of the planes drawn; each plane's terms."""
        self.model.sdf.refresh()
        # Drawn one after the other; the first is rendered while the second is drawn.
        draws = (self._draw(plane) for plane in self._draw_planes())
        found = self.threads.map(self._gradient, draws)
        self.optimiser.zero_grad()
        for number, leaf in enumerate(self._leaves):
            shares = [f.gradients[number] for f in found]
            present = [share for share in shares if share is not None]
            if present:
                leaf.grad = sum(present[1:], present[0])
        self.model.sdf.pull_back()
        return [f.terms for f in found]

    @property
    def _leaves(self) -> list[Tensor]:
        """What a plane's gradient is taken to: leaves of the distance, and other parameters."""
        others = [g for g in self.optimiser.param_groups if not g["name"].startswith("sdf.")]
        return [*self.model.sdf.leaves(), *(p for g in others for p in g["params"])]

    def _draw(self, plane: int) -> PlaneDraw:
        """Draw antennas, rays and targets of a plane, in this order."""
        pose = self.capture.poses[plane]
        antennas = self.draw_antennas(pose)
        rays = self.sampler.sample(pose.axes, self.generator, keep=self.bright.get(plane))
        targets = self.targets.choose(plane, self.config.n_targets, self.generator)
        return PlaneDraw(plane, antennas, rays.to(self.device), targets)

    def _gradient(self, draw: PlaneDraw) -> PlaneGradient:
        """Render a plane; its share of the gradient, and its terms of the loss."""
        config, stage = self.config, self.stage_config
        rendered, antennas, signal = self._render(draw)
        maps = self._heatmaps(draw, antennas, signal, rendered.signal.shape[1])
        heatmap = heatmap_loss(*maps, self.maps.scale, config.charbonnier)
        eikonal = eikonal_loss(rendered.gradient)
        rsdf = heatmap.new_zeros(())
        if stage.rsdf_weight > 0.0:
            rsdf = self._depth_alignment(rendered, draw.rays)
        loss = heatmap + config.eikonal_weight * eikonal + stage.rsdf_weight * rsdf
        for name, term in (("heat map", heatmap), ("eikonal", eikonal), ("depth", rsdf)):
            self._require_finite(name, term)
        share = loss / self.n_drawn
        gradients = torch.autograd.grad(share, self._leaves, allow_unused=True)
        return PlaneGradient((heatmap.item(), eikonal.item(), rsdf.item()), gradients)

    def _rendered(
        self, draw: PlaneDraw, inv_s: float | None = None, field: SdfField | None = None
    ) -> RenderedSignal:
        """Render one part of a plane's antennas; sharpness [1/m], distance: the model's if None."""
        pose, antennas = self.capture.poses[draw.plane], draw.antennas
        free, sharpness = self.stage_config.train_reflectivity, self.model.sharpness()
        return self.renderer.render(
            self.model.sdf if field is None else field,
            self.model.reflectivity if free else None,
            self.model.power(),
            sharpness if inv_s is None else torch.full_like(sharpness, inv_s),
            draw.rays,
            pose.tx_positions[antennas],
            pose.rx_positions[antennas],
        )

    def _render(self, draw: PlaneDraw) -> tuple[RenderedSignal, Ints, Tensor]:
        """Render one part of a plane's antennas and put the remembered ones beside it."""
        rendered, earlier = self._rendered(draw), self.remembered.get(draw.plane, [])
        all_antennas = np.concatenate([draw.antennas, *(e.antennas for e in earlier)])
        all_signals = torch.cat([rendered.signal, *(e.signal for e in earlier)], dim=1)
        if self.config.bank > 1:
            now = Remembered(draw.antennas, rendered.signal.detach())
            self.remembered[draw.plane] = [now, *earlier][: self.config.bank - 1]
        return rendered, all_antennas, all_signals

    def draw_antennas(self, pose: Pose) -> Ints:
        """Draw antennas of a plane, or of a random window of it, ascending."""
        config = self.config
        candidates = np.arange(pose.n_antennas)
        if config.window_m > 0.0:
            places = pose.phase_centers @ np.asarray(pose.axes)[1:].T
            low, high = places.min(axis=0), places.max(axis=0)
            half = 0.5 * np.minimum(config.window_m, high - low)
            share = torch.rand(2, generator=self.generator, dtype=torch.float64).numpy()
            middle = low + half + share * (high - low - 2.0 * half)
            candidates = np.flatnonzero((np.abs(places - middle) <= half + 1e-6).all(axis=1))
        n_fresh = max(min(config.n_antennas, pose.n_antennas) // config.bank, 1)
        drawn = torch.randperm(len(candidates), generator=self.generator)[:n_fresh]
        return np.sort(candidates[drawn.numpy()])

    def _heatmaps(
        self, draw: PlaneDraw, antennas: Ints, signal: Tensor, n_fresh: int | None = None
    ) -> tuple[Tensor, Tensor]:
        """Heat maps of rendered and of measured signals; gradients go to the first n_fresh."""
        pose = self.capture.poses[draw.plane]
        return heat_maps(
            *(pose, self.capture.waveform, antennas, signal, draw.targets.numpy()),
            floor=1e-6 * self.maps.scale,
            n_fresh=n_fresh,
        )

    def _depth_alignment(self, rendered: RenderedSignal, rays: PrimaryRays) -> Tensor:
        """Depth of the vision field along the same rays against the rendered one."""
        points, step, offset = rays.points, rays.step, rays.offset
        if self.config.region == "content":  # f_v meets the box before the content's samples begin
            n_samples = step.shape[1]
            step = ((offset + step.sum(dim=1)) / n_samples)[:, None].expand(step.shape)
            middle = torch.cumsum(step, dim=1) - 0.5 * step
            points = rays.starts[:, None] + middle[..., None] * rays.direction
            offset = torch.zeros_like(offset)
        shape = step.shape
        value, gradient = self.vision.sample(points.reshape(-1, 3))
        cosine = (gradient @ rays.direction).reshape(shape)
        with torch.no_grad():
            inv_s = self.model.sharpness().detach()
            march = ray_march(value.reshape(shape), cosine, step, inv_s, two_way="none")
        weight = torch.as_tensor(march.weight)
        if self.config.rsdf_region == "ray":
            depth = torch.as_tensor(march.depth) + offset * weight.sum(dim=1)
            return depth_loss(rendered.depth, depth)
        # Only where f_v sees the outer face; both depths are those of what lies there.
        middle = rays.offset[:, None] + torch.cumsum(rays.step, dim=1) - 0.5 * rays.step
        near = (value.reshape(shape) > -self.config.crop_m).to(weight.dtype)
        tiny = 1e-3
        radar, vision = (
            (w * near * middle).sum(dim=1) / ((w * near).sum(dim=1) + tiny)
            for w in (rendered.weight, weight)
        )
        return depth_loss(radar, vision)

    @torch.no_grad()
    def _start_power(self) -> None:
        """Set the power scalar by least squares of the first heat maps against the measured."""
        numerator = denominator = 0.0
        with self._draws_aside():
            for plane in self.planes[:: max(len(self.planes) // _POWER_PLANES, 1)]:
                draw = self._draw(plane)
                maps = self._heatmaps(draw, draw.antennas, self._rendered(draw).signal)
                rendered, measured = (m.double() for m in maps)
                numerator += float((rendered * measured).sum())
                denominator += float(rendered.square().sum())
        if numerator > 0.0 and denominator > 0.0:
            self.model.power.log_value.add_(math.log(numerator / denominator))

    def _condition_gradients(self) -> None:
        """Refuse gradients that are not finite; blur those of a grid, cut off those of networks."""
        for group in self.optimiser.param_groups:
            parameter = group["params"][0]
            # A sum is finite where all are, in a third of the time of looking at each.
            if parameter.grad is not None and not math.isfinite(parameter.grad.sum().item()):
                self._fail(f"the gradient to {group['name']}")
        if isinstance(self.model.sdf, LearnedSdfGrid):
            values = self.model.sdf.values
            if values.grad is not None and self.config.grid_smoothing > 0.0:
                values.grad = blur(values.grad, self.config.grid_smoothing)
        else:
            torch.nn.utils.clip_grad_norm_(
                [g["params"][0] for g in self.optimiser.param_groups], self.config.max_gradient_norm
            )

    def _require_finite(self, name: str, term: Tensor) -> None:
        if not math.isfinite(term.item()):
            self._fail(f"the {name} term of the loss")

    def _fail(self, what: str) -> None:
        raise UserError(
            what=f"{what} is not finite in stage {self.stage}, step {self.step_in_stage}",
            expected="a finite number",
            hint="the last checkpoint is kept; lower the learning rates and go on with --resume",
        )


def run_steps(
    trainer: PaperTrainer,
    *,
    on_step: Callable[[StepReport], None] | None = None,
    max_steps: int | None = None,
) -> None:
    """Advance until both stages are over, or a bound is met."""
    done = 0
    while not trainer.is_done:
        if max_steps is not None and done >= max_steps:
            return
        report = trainer.advance()
        done += 1
        if on_step is not None:
            on_step(report)
