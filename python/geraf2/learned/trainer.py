"""Training of the paper's fields: both stages, and the distance they end with."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import label, maximum

from geraf2.fields import SdfGrid
from geraf2.learned import glint_level
from geraf2.learned.config import PaperConfig
from geraf2.learned.fields import LearnedSdfGrid
from geraf2.learned.glint_level import GlintDepths, GlintShift
from geraf2.learned.heatmaps import MeasuredMaps, measure_maps
from geraf2.learned.model import PaperModel, StartDistance, domain_of, make_renderer
from geraf2.learned.optimiser import make_optimiser, set_rates, take_over
from geraf2.learned.plane_draws import PlaneDraws
from geraf2.learned.plane_loss import PlaneLoss
from geraf2.learned.resources import PlaneThreads, training_device
from geraf2.learned.stages import TrainingStages
from geraf2.scene import Capture, LosPrior

_POWER_PLANES = 6


def without_wall_pieces(sdf: SdfGrid, outside: SdfGrid, crop_m: float, detail_m: float) -> SdfGrid:
    """Field without the flat pieces at the crop, which are echoes of the walls beyond it.

    outside: signed distance to the outside of the box, negative within.
    crop_m: depth below the outside at which the field is cut [m].
    detail_m: finest detail of the field; pieces that reach less deep below the cut go [m].
    """
    labels, n_pieces = label(sdf.values < 0.0)
    depth = -outside.sample(sdf.grid.points()).reshape(sdf.grid.shape) - crop_m
    deepest = maximum(depth, labels, np.arange(n_pieces + 1))
    is_flat = np.asarray(deepest) <= detail_m
    is_flat[0] = False  # label 0 is the outside
    turned = np.where(is_flat[labels], np.abs(sdf.values), sdf.values)
    return SdfGrid(grid=sdf.grid, values=turned.astype(sdf.values.dtype))


class StepReport(NamedTuple):
    """Terms of the loss and scalars of the model in one step."""

    stage: int
    step: int
    heatmap: float
    eikonal: float
    rsdf: float
    power: float
    inv_s: float


class PaperTrainer:
    """Trains the fields of one capture.

    prior: outside of the box; f_v is the distance to it.
    maps: measured heat maps of the capture; computed when None.

    Bit-identical for a given seed and number of threads, also when it was stopped and resumed. On
    a GPU the draws are the same, but sums are taken in any order. On a CPU the planes of a step are
    rendered in parallel, unless `config.field` is "mlp".
    """

    def __init__(
        self,
        capture: Capture,
        prior: LosPrior,
        config: PaperConfig,
        *,
        seed: int = 0,
        num_threads: int | None = None,
        maps: MeasuredMaps | None = None,
    ) -> None:
        self.capture, self.prior, self.config = capture, prior, config
        self.device = training_device(config)
        # The products of a network already use all threads.
        is_serial = self.device.type == "cuda" or config.field == "mlp"
        n_parallel = 1 if is_serial else min(config.n_planes, len(capture.poses))
        self.threads = PlaneThreads(n_parallel, num_threads=num_threads)
        self.domain = domain_of(prior, config)
        start = StartDistance(prior, config, num_threads=num_threads)
        renderer = make_renderer(
            capture.waveform, prior, config, num_threads=self.threads.n_of_plane
        )
        if maps is None:
            maps = measure_maps(capture, self.domain, num_threads=num_threads)
        self.draws = PlaneDraws(capture, config, renderer, maps, device=self.device, seed=seed)
        self.stages = TrainingStages(config)
        self.model = PaperModel(self.domain, config, seed=seed)
        self.stages.open_octaves(self.model.sdf)
        self.model.sdf.initialise(start, seed=seed)
        self.model.to(self.device)
        self.loss = PlaneLoss(capture, config, renderer, self.model, maps, self.stages)
        self.glint_shift: GlintShift | None = None
        """Shift of the last :meth:`distance`, with `glint_level`."""
        _fit_power(self.draws, self.loss)
        self.optimiser = make_optimiser(self.model, config, self.stages.current)

    def advance(self) -> StepReport:
        """Make one step, after the changes of stage and resolution that are due."""
        stages = self.stages
        if stages.stage == 1 and stages.step >= self.config.stage1.n_steps:
            self.begin_stage_2(self.optimiser)
        self._refine_grid()
        if self.config.sharpness == "scheduled":
            self.model.sharpness.set(stages.inv_s)
        stages.open_octaves(self.model.sdf)
        set_rates(self.optimiser, stages.progress, self.config.final_rate)
        terms = self.take_gradients()
        self._condition_gradients()
        self.optimiser.step()
        heatmap, eikonal, rsdf = (sum(term) / len(terms) for term in zip(*terms, strict=True))
        power, inv_s = self.model.power().item(), self.model.sharpness().item()
        report = StepReport(stages.stage, stages.step, heatmap, eikonal, rsdf, power, inv_s)
        stages.step += 1
        return report

    def begin_stage_2(self, earlier: torch.optim.Optimizer) -> None:
        """Start stage 2 after a stage 1, whose optimiser is `earlier`."""
        self.stages.stage, self.stages.step = 2, 0
        self.optimiser = make_optimiser(self.model, self.config, self.stages.current)
        take_over(self.optimiser, earlier)

    def distance(self) -> SdfGrid:
        """Trained distance on the grid of the mesh, without the remains of walls at the crop.

        With `glint_level` the zero level is moved to the depth of the measured glints.
        """
        sdf = self.model.sdf.sample_grid(self.domain.grid(self.config.mesh_n))
        detail_m = 2.0 * self.domain.half_side_m / (self.config.grid_n[-1] - 1)
        if self.config.glint_level:
            depths = glint_level.part_depths(sdf)
            glints = GlintDepths(self.draws, self.loss, self.threads)
            self.glint_shift = glints.find_shift(sdf, depths, glint_level.MAX_INWARD * detail_m)
            sdf = glint_level.moved(sdf, self.glint_shift.inward_m, depths)
        if self.config.region == "scene":
            return sdf
        vision = self.loss.renderer.vision.field
        return without_wall_pieces(sdf, vision, self.config.crop_m, detail_m)

    def take_gradients(self) -> list[tuple[float, float, float]]:
        """Give the parameters the mean gradient of the planes drawn; returns each plane's terms."""
        leaves = [group["params"][0] for group in self.optimiser.param_groups]
        # A generator: a plane is rendered while the next is drawn, in order.
        draws = (self.draws.draw(plane) for plane in self.draws.planes_of_step())
        found = self.threads.map(
            lambda draw: self.loss.gradient(draw, leaves, self.draws.n_planes), draws
        )
        self.optimiser.zero_grad()
        for number, leaf in enumerate(leaves):
            shares = [f.gradients[number] for f in found]
            present = [share for share in shares if share is not None]
            if present:
                leaf.grad = sum(present[1:], present[0])
        return [f.terms for f in found]

    def _refine_grid(self) -> None:
        """Resample the distance on the finer grid of its next level, where one is due."""
        sdf, wanted = self.model.sdf, self.stages.grid_n
        if self.stages.stage != 1 or not isinstance(sdf, LearnedSdfGrid):
            return
        if wanted > sdf.grid.shape[0]:
            sdf.upsample(wanted)
            self.optimiser = make_optimiser(self.model, self.config, self.stages.current)

    def _condition_gradients(self) -> None:
        """Refuse gradients that are not finite, and clip those of networks."""
        for group in self.optimiser.param_groups:
            gradient = group["params"][0].grad
            # A sum is finite where all are; three times as fast as testing each element.
            if gradient is not None:
                self.stages.require_finite(
                    f"the gradient to {group['name']}", gradient.sum().item()
                )
        if not isinstance(self.model.sdf, LearnedSdfGrid):
            torch.nn.utils.clip_grad_norm_(
                [g["params"][0] for g in self.optimiser.param_groups], self.config.max_gradient_norm
            )


@torch.no_grad()
def _fit_power(draws: PlaneDraws, loss: PlaneLoss) -> None:
    """Set the power scalar by least squares of the first heat maps against the measured."""
    numerator = denominator = 0.0
    with draws.aside():
        for plane in draws.planes[:: max(len(draws.planes) // _POWER_PLANES, 1)]:
            draw = draws.draw(plane)
            maps = loss.heat_maps(draw, loss.render(draw).signal)
            rendered, measured = (m.double() for m in maps)
            numerator += float((rendered * measured).sum())
            denominator += float(rendered.square().sum())
    if numerator > 0.0 and denominator > 0.0:
        loss.model.power.log_value.add_(math.log(numerator / denominator))


def run_steps(
    trainer: PaperTrainer,
    *,
    on_step: Callable[[StepReport], None] | None = None,
    max_steps: int | None = None,
) -> None:
    """Advance a training to its end, or by at most `max_steps` steps."""
    done = 0
    while not trainer.stages.is_done:
        if max_steps is not None and done >= max_steps:
            return
        report = trainer.advance()
        done += 1
        if on_step is not None:
            on_step(report)
