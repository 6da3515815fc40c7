"""Forms of the amplitude of `--preset paper`, trained on several scenes with several seeds.

    python bench/python/paper_forms.py SCENE ... --steps 600 0 --seeds 0 1 --forms paper corrected

A scene is a folder of `geraf2 simulate`, with its truth and its box. Zero level, nothing aligned,
the box cropped. `median` is the median signed distance of the surface to the truth [mm], positive
outside. With steps of stage 2 there is a row after either stage. After the rows the mean of each
form, and its standard deviation over seeds: the root of the mean over scenes of the variance over
seeds. FILE.csv of `--rows` keeps the rows: what it holds is not trained again.
"""

import argparse
import csv
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from geraf2.evaluation import evaluate_mesh
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.learned.checkpoints import load_model, model_arrays
from geraf2.learned.config import CorrectedPaperConfig, PaperConfig, StageConfig
from geraf2.learned.heatmaps import MeasuredMaps
from geraf2.learned.trainer import PaperTrainer
from geraf2.scene import Capture, LosPrior, load_capture
from geraf2.surfaces.extraction import cropped_content

CORRECTED = {
    name: getattr(CorrectedPaperConfig(), name)
    for name in (
        *("two_way", "spreading", "lobe_power", "wall_delay", "bright_targets"),
        *("inv_s_start", "grid_rate", "region", "n_cells", "glint_level"),
    )
}
FORMS: dict[str, dict[str, Any]] = {
    "paper": {},
    "corrected": CORRECTED,
    "corrected, level as trained": CORRECTED | {"glint_level": False},
}
NAMES = ("F1 15", "F1 5", "CD", "median")
N_SCORED = 10000


@dataclass
class Bench:
    """A scene, and the trainers of its forms."""

    capture: Capture
    prior: LosPrior
    truth: TriangleMesh
    base: PaperConfig
    seed: int
    maps: dict[str, MeasuredMaps] = field(default_factory=dict)
    """By region."""

    def trainer(self, config: PaperConfig) -> PaperTrainer:
        known = self.maps.get(config.region)
        trainer = PaperTrainer(self.capture, self.prior, config, maps=known, seed=self.seed)
        self.maps[config.region] = trainer.loss.maps
        return trainer

    def second_stage(self, config: PaperConfig, after: PaperTrainer) -> PaperTrainer:
        """Make a trainer that continues from the end of a stage 1, the same for every row."""
        trainer = self.trainer(config)
        load_model(trainer.model, model_arrays(after.model), "stage 1")
        trainer.begin_stage_2(after.optimiser)
        return trainer


def make_bench(scene: Path, options: argparse.Namespace, seed: int) -> Bench:
    """Scene, and settings of the command line."""
    capture, paper = load_capture(scene), PaperConfig()
    prior = replace(LosPrior.from_mesh(read_mesh(scene / LOS_NAME)), walls=capture.walls)
    base = replace(
        paper,
        n_cells=options.cells or paper.n_cells,
        n_antennas=options.antennas or paper.n_antennas,
        n_planes=options.planes_a_step,
        n_clusters=1,
        stage1=StageConfig(n_steps=options.steps[0]),
        stage2=replace(paper.stage2, n_steps=options.steps[1]),
    )
    return Bench(capture, prior, read_mesh(scene / TRUTH_NAME), base, seed)


def add_density_arguments(parser: argparse.ArgumentParser) -> None:
    """How finely a step samples; the form's own where nothing is given."""
    parser.add_argument("--cells", type=int)
    parser.add_argument("--antennas", type=int)
    parser.add_argument("--planes-a-step", type=int, default=PaperConfig().n_planes)


def form_config(bench: Bench, form: str, options: argparse.Namespace) -> PaperConfig:
    """Settings of a form; what the command line gives goes before."""
    config = replace(bench.base, **FORMS[form])
    if form.startswith("corrected"):
        second = replace(CorrectedPaperConfig().stage2, n_steps=config.stage2.n_steps)
        config = replace(config, stage2=second)
    return config if options.cells is None else replace(config, n_cells=options.cells)


def scored(bench: Bench, trainer: PaperTrainer, *, n_steps: int | None = None) -> list[float]:
    """Train to the end, or until so many steps are done, and score: NAMES."""
    while not trainer.stages.is_done and trainer.stages.steps_done != n_steps:
        trainer.advance()
    mesh, _ = cropped_content(trainer.distance(), bench.prior, trainer.config.crop_m)
    if not mesh.faces.shape[0]:
        return [0.0, 0.0, float("nan"), float("nan")]
    found = evaluate_mesh(mesh, bench.truth, n_samples=N_SCORED)
    bias_m = found.surface_bias_m
    median = float("nan") if bias_m is None else 1e3 * bias_m
    return [found.f1(0.015), found.f1(0.005), found.chamfer_1e3_m2, median]


class Rows:
    """Scores of a scene, a seed and a method of training, kept in a file if one is named."""

    def __init__(self, path: Path | None) -> None:
        self.path, self.known = path, dict[tuple[str, int, str], list[float]]()
        if path is not None and path.exists():
            with path.open(newline="", encoding="utf-8") as file:
                for scene, seed, name, *values in csv.reader(file):
                    self.known[scene, int(seed), name] = [float(v) for v in values]

    def keep(self, scene: str, seed: int, name: str, values: list[float]) -> None:
        self.known[scene, seed, name] = values
        if self.path is not None:
            with self.path.open("a", newline="", encoding="utf-8") as file:
                csv.writer(file).writerow([scene, seed, name, *values])


def shown(values: Any) -> str:
    """Scores of a row."""
    f1_15, f1_5, chamfer, median = values
    return f"{f1_15:7.3f} {f1_5:7.3f} {chamfer:7.3f} {median:+7.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--steps", type=int, nargs=2, default=(600, 0), metavar=("S1", "S2"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--forms", nargs="+", choices=list(FORMS), default=["paper", "corrected"])
    add_density_arguments(parser)
    parser.add_argument("--rows", type=Path, help="FILE.csv")
    options = parser.parse_args()
    print(f"{options.steps[0]} + {options.steps[1]} steps")
    print(f"{'scene':14} {'form':26} seed " + " ".join(f"{n:>7}" for n in NAMES) + "   CPU s")
    kept = Rows(options.rows)
    second = (", stage 2",) if options.steps[1] else ()
    rows_of = {form: (form, *(form + suffix for suffix in second)) for form in options.forms}
    found: dict[str, list[list[list[float]]]] = {n: [] for form in rows_of.values() for n in form}
    for scene in options.scenes:
        bench = None
        for form, names in rows_of.items():
            for name in names:
                found[name].append([])
            for seed in options.seeds:
                start = time.process_time()
                if any((scene.name, seed, name) not in kept.known for name in names):
                    bench = bench or make_bench(scene, options, 0)
                    bench.seed = seed
                    trainer = bench.trainer(form_config(bench, form, options))
                    for name, n_steps in zip(names, np.cumsum(options.steps), strict=False):
                        kept.keep(
                            scene.name, seed, name, scored(bench, trainer, n_steps=int(n_steps))
                        )
                for name in names:
                    found[name][-1].append(kept.known[scene.name, seed, name])
                    row = f"{scene.name:14} {name:26} {seed:4} {shown(found[name][-1][-1])}"
                    print(f"{row} {time.process_time() - start:7.0f}", flush=True)
    for form, rows in found.items():
        values = np.array(rows)  # (n_scenes, n_seeds, n_figures)
        print(f"{'mean':14} {form:26}      {shown(values.mean(axis=(0, 1)))}")
        if len(options.seeds) > 1:
            spread = np.sqrt(values.var(axis=1, ddof=1).mean(axis=0))
            print(f"{'spread':14} {form:26}      {shown(spread)}")


if __name__ == "__main__":
    main()
