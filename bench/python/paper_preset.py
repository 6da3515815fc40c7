"""What `--preset paper` reaches on a scene, row by row, and where the time of a step goes.

    python bench/python/paper_preset.py SCENE --los LOS --truth TRUTH [--only NAME ...]
    OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive python bench/python/paper_preset.py \\
        SCENE --los LOS --truth TRUTH --only step step-preset step-mlp step-mlp-grid
    python bench/python/paper_preset.py SCENE --los LOS --truth TRUTH --only levels

Rows of one kind differ in one setting: the named one. Meshes are taken at the zero level, without
alignment; `level` is where the surface would have to be cut to lie right in the median. CPU seconds
are those of the process (user and system), so that they hold on a busy machine too. `levels` trains
nothing: it puts the true surface into the field, moved by a few millimetres, and prints where each
term of the loss is least (paper_levels.py).
"""

import argparse
import cProfile
import pstats
import resource
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from geraf2.evaluation import MeshMetrics, OracleScore, evaluate_mesh, oracle_matched_filter
from geraf2.fields import SdfGrid
from geraf2.imaging.volume import image_volume
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.learned.checkpoints import load_model, model_arrays
from geraf2.learned.config import CorrectedPaperConfig, PaperConfig, StageConfig
from geraf2.learned.fields import SdfMlp
from geraf2.learned.heatmaps import MeasuredMaps
from geraf2.learned.resources import training_bytes
from geraf2.learned.trainer import PaperTrainer
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, Grid, LosPrior, load_capture
from geraf2.surfaces.extraction import cropped_content
from paper_levels import level_forms, level_rows

HEADER = (
    f"{'row':26} {'F1 15':>7} {'F1 5':>7} {'F1 2':>7} {'CD':>7} {'volume':>7} {'level mm':>9} "
    f"{'loss':>8} {'CPU s':>7}"
)
LEVELS_M = np.arange(-0.016, 0.0161, 0.004)
N_SCORED = 10000


@dataclass
class Bench:
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

    def run_stage_one(self, name: str, config: PaperConfig) -> PaperTrainer:
        trainer = self.trainer(replace(config, stage2=replace(config.stage2, n_steps=0)))
        self._run(name, trainer)
        return trainer

    def run_stage_two(self, name: str, config: PaperConfig, after: PaperTrainer) -> None:
        self._run(name, self.second_stage(config, after))

    def second_stage(self, config: PaperConfig, after: PaperTrainer) -> PaperTrainer:
        """Make a trainer that goes on from the end of a stage 1, the same for every row."""
        trainer = self.trainer(config)
        load_model(trainer.model, model_arrays(after.model), "stage 1")
        trainer.begin_stage_2(after.optimiser)
        return trainer

    def _run(self, name: str, trainer: PaperTrainer) -> None:
        start, losses = time.process_time(), [0.0]
        while not trainer.stages.is_done:
            losses.append(trainer.advance().heatmap)
        cpu_s = time.process_time() - start
        loss = float(np.mean(losses[-200:]))
        print(f"{name:26} {self.score(trainer)} {loss:8.4f} {cpu_s:7.0f}", flush=True)

    def metrics(self, trainer: PaperTrainer, sdf: SdfGrid, n_samples: int) -> MeshMetrics | None:
        """Of the zero level; None where there is none."""
        mesh, _ = cropped_content(sdf, self.prior, trainer.config.crop_m)
        if not mesh.faces.shape[0]:
            return None
        return evaluate_mesh(mesh, self.truth, n_samples=n_samples)

    def score(self, trainer: PaperTrainer) -> str:
        sdf = sampled(trainer)
        zero = self.metrics(trainer, sdf, N_SCORED)
        if zero is None:
            return f"{'no zero level':49}"
        biases = {}
        for level_m in LEVELS_M:
            moved = SdfGrid(grid=sdf.grid, values=sdf.values - np.float32(level_m))
            at_level = self.metrics(trainer, moved, 1000)
            if at_level is not None and at_level.surface_bias_m is not None:
                biases[float(level_m)] = abs(at_level.surface_bias_m)
        level = min(biases, key=biases.__getitem__)
        return (
            f"{zero.f1(0.015):7.3f} {zero.f1(0.005):7.3f} {zero.f1(0.002):7.3f} "
            f"{zero.chamfer_1e3_m2:7.3f} {zero.size.volume_ratio or np.nan:7.3f} "
            f"{1e3 * level:+9.0f}"
        )


def take_field(into: PaperTrainer, trained: PaperTrainer) -> None:
    """Give a trainer what another has trained so far, and its place in the schedule."""
    load_model(into.model, model_arrays(trained.model), "the trained field")
    into.stages.stage, into.stages.step = trained.stages.stage, trained.stages.step
    if into.config.sharpness == "scheduled":
        into.model.sharpness.set(into.stages.inv_s)


def sampled(trainer: PaperTrainer) -> SdfGrid:
    """What has been trained so far, on the grid of its mesh."""
    return trainer.distance()


def matched_filter(bench: Bench) -> OracleScore:
    """Best that a threshold on the matched filter could give."""
    half = 0.5 * max(bench.prior.size_m)
    grid = Grid.cube(bench.prior.center_m, half, round(2 * half / 0.004) + 1)
    volume = image_volume(bench.capture, grid)
    return oracle_matched_filter(volume, grid, bench.prior, bench.truth, crop_m=bench.base.crop_m)


def matched_filter_row(bench: Bench) -> None:
    start = time.process_time()
    score = matched_filter(bench)
    cpu_s = time.process_time() - start
    print(
        f"{'matched filter, oracle':26} {score.f1_15mm:7.3f} {score.f1_5mm:7.3f} "
        f"{score.f1_2mm:7.3f} {score.chamfer_1e3_m2:7.3f} {'':7} {'':9} {'':8} {cpu_s:7.0f}",
        flush=True,
    )


def step_rows(bench: Bench, config: PaperConfig, n_steps: int) -> None:
    """Time of a training step by part, from the profiler: native kernels, everything else."""
    seconds_of = _step_seconds(bench, config, n_steps)
    trainer = bench.trainer(config)
    trainer.advance()
    profile = cProfile.Profile(time.process_time)  # wall time counts other programs
    profile.enable()
    for _ in range(n_steps):
        trainer.advance()
    profile.disable()
    total_s, wall = seconds_of.cpu, seconds_of.wall
    stats = pstats.Stats(profile)
    native: dict[str, float] = {}
    for (_, _, name), row in stats.stats.items():  # type: ignore[attr-defined]
        if "geraf2._core" in name:
            native[name.split(".")[-1].rstrip(">}")] = row[2] / n_steps
    n_rays = trainer.draws.sampler.n_rays
    n_antennas = config.n_antennas // config.bank
    print(
        f"step, {config.field} field: {1e3 * total_s:.1f} ms of {n_rays} rays x "
        f"{config.n_samples} samples x {n_antennas} antennas x {config.n_planes} planes "
        "(median CPU time, one thread)\n"
        f"  by the clock {1e3 * wall[1]:.1f} ms, two threads {1e3 * wall[2]:.1f} ms: "
        f"{wall[1] / wall[2]:.2f} times as fast"
    )
    if isinstance(trainer.model.sdf, SdfMlp):
        bound_s = matrix_bound_s(trainer.model.sdf, n_rays * config.n_samples)
        print(
            f"  its matrix products alone: {1e3 * bound_s:.0f} ms; the step takes "
            f"{total_s / bound_s:.2f} times as long"
        )
    for name, seconds in sorted(native.items(), key=lambda item: -item[1]):
        print(f"  {name:38} {1e3 * seconds:8.1f} ms {100 * seconds / total_s:5.1f} %")
    share = sum(native.values()) / total_s
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    estimate_mib = training_bytes(config, bench.capture, 2) / 2**20
    print(f"  largest resident set {peak_mib:.0f} MiB, estimated before {estimate_mib:.0f} MiB")
    print(
        f"  {'native in all':38} {1e3 * share * total_s:8.1f} ms {100 * share:5.1f} %", flush=True
    )


class StepSeconds(NamedTuple):
    """Medians of a step."""

    cpu: float
    """CPU time of one thread."""
    wall: dict[int, float]
    """By the clock, for each number of threads; says nothing where other programs run."""


def _step_seconds(bench: Bench, config: PaperConfig, n_steps: int) -> StepSeconds:
    """Time steps of one and of two threads in turn."""
    trainers, wall = {}, dict[int, list[float]]()
    for n_threads in (1, 2):
        torch.set_num_threads(n_threads)
        trainers[n_threads] = bench.trainer(config)  # keeps this number
        trainers[n_threads].advance()
        wall[n_threads] = []
    cpu = []
    for _ in range(n_steps):
        for n_threads, trainer in trainers.items():
            torch.set_num_threads(n_threads)
            start, start_cpu = time.perf_counter(), time.process_time()
            trainer.advance()
            wall[n_threads].append(time.perf_counter() - start)
            if n_threads == 1:
                cpu.append(time.process_time() - start_cpu)
    torch.set_num_threads(1)
    return StepSeconds(float(np.median(cpu)), {n: float(np.median(s)) for n, s in wall.items()})


def matrix_bound_s(network: SdfMlp, n_points: int) -> float:
    """CPU time of the six products a layer of value, gradient and the derivatives of both."""
    total_s = 0.0
    for layer in network.layers:
        weight = torch.as_tensor(layer.weight).detach().clone()
        inner = torch.rand(n_points, weight.shape[1])
        outer = torch.rand(n_points, weight.shape[0])
        products = (
            lambda x=inner, w=weight: x @ w.T,
            lambda y=outer, w=weight: y @ w,
            lambda x=inner, y=outer: y.T @ x,
        )
        for product in products:
            product()
            times = []
            for _ in range(3):
                start = time.process_time()
                product()
                times.append(time.process_time() - start)
            # each of the three occurs twice: along the value, and along the gradient
            total_s += 2.0 * float(np.median(times))
    return total_s


def stage_one_rows(base: PaperConfig) -> dict[str, PaperConfig]:
    return {
        "stage 1": base,
        "stage 1, unbiased": replace(base, two_way="unbiased"),
        "stage 1, spreading": replace(base, spreading="two-way"),
        "stage 1, unbiased, spreading": replace(base, two_way="unbiased", spreading="two-way"),
        "stage 1, ULoS off": replace(base, ulos=False),
        "stage 1, whole plane": replace(base, window_m=0.0),
        "stage 1, one look": replace(base, n_looks=1),
        "stage 1, vision start": replace(base, start="vision"),
        "stage 1, lobe 1": replace(base, lobe_power=1.0),
    }


def stage_two_rows(base: PaperConfig) -> dict[str, PaperConfig]:
    def second(**changes: Any) -> PaperConfig:
        return replace(base, stage2=replace(base.stage2, **changes))

    return {
        "stage 2, lambda 0": second(rsdf_weight=0.0),
        "stage 2, lambda 0.1": second(rsdf_weight=0.1),
        "stage 2, lambda 1": base,
        "stage 2, lambda 10": second(rsdf_weight=10.0),
        "stage 2, frozen": second(train_reflectivity=False),
        "stage 2, lambda 1, wall": replace(base, rsdf_region="wall"),
    }


def add_scene_arguments(parser: argparse.ArgumentParser, n_steps: tuple[int, int]) -> None:
    """Scene, and how long and how finely it is trained."""
    parser.add_argument("scene", type=Path)
    parser.add_argument("--los", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--steps", type=int, nargs=2, default=n_steps, metavar=("S1", "S2"))
    parser.add_argument("--cells", type=int, default=20, help="cells along the disc's square")
    parser.add_argument("--antennas", type=int, default=128)
    parser.add_argument("--planes-a-step", type=int, default=PaperConfig().n_planes)


def make_bench(options: argparse.Namespace, seed: int) -> Bench:
    """Scene and settings of `add_scene_arguments`; cells and antennas None: the preset's own."""
    capture = load_capture(options.scene)
    prior = replace(LosPrior.from_mesh(read_mesh(options.los)), walls=capture.walls)
    paper = PaperConfig()
    base = replace(
        paper,
        n_cells=options.cells or paper.n_cells,
        n_antennas=options.antennas or paper.n_antennas,
        n_planes=options.planes_a_step,
        n_clusters=1,
        stage1=StageConfig(n_steps=options.steps[0]),
        stage2=replace(paper.stage2, n_steps=options.steps[1]),
    )
    return Bench(capture, prior, read_mesh(options.truth), base, seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_scene_arguments(parser, (1400, 400))
    parser.add_argument("--only", nargs="*", help="names of rows; all when not given")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--draws", type=int, default=4, help="of windows and targets, for levels")
    parser.add_argument("--level-rows", nargs="*", help="rows of levels; all when not given")
    options = parser.parse_args()
    bench = make_bench(options, options.seed)
    base = bench.base
    first, second = stage_one_rows(base), stage_two_rows(base)
    names = ["matched filter", *first, *second, "levels", "step", "step-preset"]
    names += ["step-mlp", "step-mlp-grid"]
    unknown = set(options.only or ()) - set(names)
    if unknown:
        parser.error(f"no such row: {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    wanted = options.only or names
    print(f"seed {options.seed}, {options.steps[0]} + {options.steps[1]} steps")
    print(HEADER)
    if "matched filter" in wanted:
        matched_filter_row(bench)
    common = None
    if "stage 1" in wanted or any(name in wanted for name in second):
        common = bench.run_stage_one("stage 1", first["stage 1"])
    for name, config in second.items():
        if name in wanted and common is not None:
            bench.run_stage_two(name, config, common)
    for name, config in first.items():
        if name in wanted and name != "stage 1":
            bench.run_stage_one(name, config)
    if "levels" in wanted:
        truth = MeshScene(bench.truth.vertices, bench.truth.faces)
        trainers = {name: bench.trainer(config) for name, config in level_forms(base).items()}
        level_rows(trainers, truth, options.draws, options.level_rows)
    # The step that the paper describes: 512 antennas of the whole plane rendered, one signal.
    full = replace(
        PaperConfig(), mlp_fit_steps=0, n_planes=1, window_m=0.0, n_antennas=1024, bank=2, n_looks=1
    )
    if "step" in wanted:
        step_rows(bench, full, 15)
    if "step-preset" in wanted:
        step_rows(bench, PaperConfig(), 15)
    if "step-mlp" in wanted:
        step_rows(bench, replace(full, field="mlp"), 3)
    if "step-mlp-grid" in wanted:
        voxels = replace(CorrectedPaperConfig(), field="mlp-grid", grid_n=(25,), mlp_fit_steps=0)
        step_rows(bench, voxels, 5)


if __name__ == "__main__":
    main()
