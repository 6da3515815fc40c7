"""Where the noise in the gradient of a step of `--preset paper` comes from.

    python bench/python/paper_noise.py SCENE [--form corrected] [--steps 1000] [--draws 48]

Trains for a while, a plane a step, then draws the gradient of L_MF to the distance grid again and
again at that field: all anew, and with one source drawn anew while the others stay. `share` is the
variance left by that source alone over the variance of all (law of total variance: shares of
sources that act together add up to more than one). `signal` is the squared length of the mean
gradient over the variance of one draw: below one, a step is more noise than gradient; its rows
raise one number of a step, with the processor time that it costs.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Floats, Ints
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.learned.config import PaperConfig
from geraf2.learned.heatmaps import TargetChooser
from geraf2.learned.trainer import PaperTrainer
from geraf2.scene import Pose
from paper_forms import FORMS, form_config
from paper_preset import Bench, make_bench, take_field

SOURCES = ("plane", "window and antennas", "rays and samples", "targets")
LARGER: dict[str, dict[str, Any]] = {
    "one plane": {},
    "2 planes": {"n_planes": 2},
    "2 x targets": {"n_targets": 1024},
    "2 x antennas": {"n_antennas": 256},
    "2 x rays": {"n_cells": 28},
    "2 x samples": {"n_samples": 64},
    "2 x looks": {"n_looks": 16},
}


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


class Targets:
    """A chooser with draws of its own."""

    def __init__(self, chooser: TargetChooser) -> None:
        self._chooser, self.seed = chooser, 0

    def choose(self, plane: int, n_targets: int, generator: torch.Generator) -> Tensor:
        del generator
        return self._chooser.choose(plane, n_targets, seeded(self.seed))


class SeededTrainer(PaperTrainer):
    """A trainer whose draws have a seed each."""

    def __init__(self, bench: Bench, config: PaperConfig) -> None:
        self._seeds = dict.fromkeys(SOURCES, 0)
        super().__init__(bench.capture, bench.prior, config, maps=bench.maps.get(config.region))

    def gradient(self, seeds: dict[str, int]) -> Floats:
        """Of one step, at the present field."""
        self._seeds = seeds
        assert isinstance(self.targets, Targets)
        self.targets.seed = seeds["targets"]
        self.generator = seeded(seeds["plane"])
        self._take_gradients()
        gradient = self.model.sdf.get_parameter("values").grad
        assert gradient is not None
        return gradient.double().numpy().reshape(-1).copy()

    def draw_antennas(self, pose: Pose) -> Ints:
        self.generator = seeded(self._seeds["window and antennas"])
        antennas = super().draw_antennas(pose)
        self.generator = seeded(self._seeds["rays and samples"])
        return antennas


def seeded_trainer(bench: Bench, at: PaperTrainer, **changes: Any) -> SeededTrainer:
    """At the same field, with other numbers of draws."""
    trainer = SeededTrainer(bench, replace(at.config, **changes))
    take_field(trainer, at)
    trainer.targets = Targets(trainer.targets)  # type: ignore[assignment]
    return trainer


def signal_and_variance(gradients: Floats) -> tuple[float, float]:
    """Squared length of the mean, without bias, and the variance of a draw, of (n, n_values)."""
    n = len(gradients)
    variance = float(gradients.var(axis=0, ddof=1).sum())
    return float((gradients.mean(axis=0) ** 2).sum()) - variance / n, variance


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--form", choices=list(FORMS), default="corrected")
    parser.add_argument("--steps", type=int, default=1000, help="of training before")
    parser.add_argument("--draws", type=int, default=48)
    parser.add_argument("--cells", type=int, default=20)
    parser.add_argument("--antennas", type=int, default=128)
    parser.set_defaults(planes_a_step=1)
    options = parser.parse_args()
    options.los, options.truth = options.scene / LOS_NAME, options.scene / TRUTH_NAME
    n_steps, options.steps = options.steps, (2 * options.steps, 0)
    bench = make_bench(options, 0)
    at = bench.trainer(form_config(bench, options.form, options))
    for _ in range(n_steps):
        at.advance()
    trainer = seeded_trainer(bench, at)
    draws = range(options.draws)
    _, variance = signal_and_variance(
        np.array([trainer.gradient(dict.fromkeys(SOURCES, 1000 + i)) for i in draws])
    )
    print(f"{'drawn anew':22} {'share':>7}")
    n_outer = max(options.draws // 8, 2)
    for source in SOURCES:
        left = []
        for i in range(n_outer):
            fixed = dict.fromkeys(SOURCES, 2000 + i)
            found = [trainer.gradient({**fixed, source: 3000 + 8 * i + j}) for j in range(8)]
            left.append(signal_and_variance(np.array(found))[1])
        print(f"{source:22} {np.mean(left) / variance:7.2f}", flush=True)
    print(f"{'a step of':22} {'signal':>7} {'CPU ms':>7} {'signal / CPU s':>15}")
    for name, changes in LARGER.items():
        larger = seeded_trainer(bench, at, **changes)
        start = time.process_time()
        found = [larger.gradient(dict.fromkeys(SOURCES, 1000 + i)) for i in draws]
        cpu_s = (time.process_time() - start) / options.draws
        signal, variance = signal_and_variance(np.array(found))
        ratio = signal / variance
        print(f"{name:22} {ratio:7.3f} {1e3 * cpu_s:7.1f} {ratio / cpu_s:15.2f}", flush=True)


if __name__ == "__main__":
    main()
