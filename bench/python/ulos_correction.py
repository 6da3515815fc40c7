"""How much ULoS rendering changes of what a training of the paper's route renders.

    python bench/python/ulos_correction.py SCENE ... [--form corrected] [--steps 1 400 2000]

Equation 5 adds Phi(f(x(u'_s))) - Phi(f(x(u_s))) to the transmittance of a sample: x(u'_s) is where
the way from an antenna meets the scene's boundary, x(u_s) where the primary ray does. After so many
steps of stage 1 a row says how large that is, over all pairs of sample and group of antennas that
are rendered of every plane: root mean square, and share of the pairs in which it exceeds 0.05. `on`
takes f from the frozen vision field (ULoS rendering), `off` from the field under training. `most`
bounds `on`: the boundary is the box, grown, and Phi on it lies between its values at the middle of
a face and at a corner. `map` is what turning it off changes in the rendered heat maps,
|on - off| / |on|, for the same antennas, samples and targets; `jitter` is what drawing the samples
anew changes.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Floats
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.learned.config import PaperConfig
from geraf2.learned.trainer import PaperTrainer, PlaneDraw
from geraf2.scene import LosPrior
from paper_forms import FORMS, form_config
from paper_preset import Bench, make_bench, take_field


class Renderings:
    """Heat maps of a trainer's field, rendered with ULoS rendering or without."""

    def __init__(self, bench: Bench, trainer: PaperTrainer, *, ulos: bool) -> None:
        self.trainer = bench.trainer(replace(trainer.config, ulos=ulos))
        self.corrections = list[Floats]()
        self._shift = self.trainer.renderer._boundary_shift
        self.trainer.renderer._boundary_shift = self._keep  # type: ignore[method-assign, assignment]

    def _keep(self, *given: object) -> Tensor:
        found = self._shift(*given)  # type: ignore[arg-type]
        self.corrections.append(found.cpu().numpy())
        return found

    @torch.no_grad()
    def heat_map(self, draw: PlaneDraw) -> Tensor:
        """Of one draw of a plane."""
        signal = self.trainer._rendered(draw).signal
        return self.trainer._heatmaps(draw, draw.antennas, signal)[0]


def most(prior: LosPrior, margin: float, inv_s: float) -> float:
    """Bound of the correction with the vision field: Phi at a corner less Phi on a face."""
    sides = np.asarray(prior.size_m)
    distances = 0.5 * (margin - 1.0) * np.array([sides.min(), np.linalg.norm(sides)])
    face, corner = 1.0 / (1.0 + np.exp(-inv_s * distances))
    return float(corner - face)


def row(trainer: PaperTrainer, on: Renderings, off: Renderings) -> str:
    """Figures of the field as trained so far."""
    changes = []
    for renderings in (on, off):
        take_field(renderings.trainer, trainer)
        renderings.corrections.clear()
    for plane in trainer.planes:
        draw = on.trainer._draw(plane)
        again = draw._replace(rays=on.trainer._draw(plane).rays)
        reference = on.heat_map(draw)
        others = off.heat_map(draw), on.heat_map(again)
        changes.append([float((m - reference).norm() / reference.norm()) for m in others])
    shown = ""
    for renderings in (on, off):
        shift = np.concatenate(renderings.corrections)
        rms, share = np.sqrt(np.mean(shift**2)), np.mean(np.abs(shift) > 0.05)
        shown += f" {rms:8.4f} {share:7.3f}"
    inv_s = trainer.model.sharpness().item()
    bound = most(trainer.prior, trainer.sampler.config.margin, inv_s)
    turned, jitter = np.mean(changes, axis=0)
    return f"{inv_s:6.0f} {bound:6.3f}{shown} {turned:7.3f} {jitter:7.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--form", choices=list(FORMS), default="corrected")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 400, 2000])
    parser.add_argument("--seed", type=int, default=0)
    parser.set_defaults(cells=None, antennas=None, planes_a_step=PaperConfig().n_planes)
    options = parser.parse_args()
    stops = sorted(options.steps)
    options.steps = (stops[-1], 0)
    print(
        f"{'scene':14} {'steps':>6} {'s 1/m':>6} {'most':>6} {'on: rms':>8} {'> 0.05':>7} "
        f"{'off: rms':>8} {'> 0.05':>7} {'map':>7} {'jitter':>7}"
    )
    for scene in options.scenes:
        options.scene, options.los, options.truth = scene, scene / LOS_NAME, scene / TRUTH_NAME
        bench = make_bench(options, options.seed)
        trainer = bench.trainer(form_config(bench, options.form, options))
        on, off = (Renderings(bench, trainer, ulos=ulos) for ulos in (True, False))
        for n_steps in stops:
            while trainer.steps_done < n_steps:
                trainer.advance()
            print(f"{scene.name:14} {n_steps:6} {row(trainer, on, off)}", flush=True)


if __name__ == "__main__":
    main()
