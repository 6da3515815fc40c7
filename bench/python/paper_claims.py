"""What the paper claims of its second stage, L_RSDF and ULoS rendering, on painted objects.

    python bench/python/paper_claims.py scenes OUT [--figures NAME ...] [--planes 18] [--world]
    python bench/python/paper_claims.py train OUT/SCENE ... --seeds 0 1 [--form corrected] \
        [--early 400] [--moved] [--calibrate] [--rows FILE.csv]

`scenes` simulates objects whose reflectivity varies: patches of 3 cm with 0.3 of the amplitude of
metal beside patches of metal, in a carton with 0.45 dB of loss a crossing. With `--world` it takes
everything that docs/world.md calls plausible instead, drawn anew for every object; train
such scans with `--calibrate`, which corrects them as the first stage of every preset does.

`train` trains a first stage and continues it by several methods for as many steps. Each method is
compared with the first stage, and with the first stage continued for as long at the same rate,
scene by scene: mean over seeds, then mean over scenes with its 95 % interval (Student's t), and in
how many scenes it is better. `--early N` scores a first stage after its first N steps, too.
`--moved` scores each method again, with its level moved to the glints. FILE.csv keeps the rows
of one set of scenes: what it holds is not trained again. The rows behind docs/paper-results.md are
paper_claims.csv and, of scans of a plausible world, paper_claims_world.csv.
"""

import argparse
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from scipy.stats import t as student

from geraf2._types import Floats
from geraf2.calibration.driver import calibrate
from geraf2.learned.config import PaperConfig
from geraf2.learned.trainer import PaperTrainer
from paper_forms import (
    FORMS,
    NAMES,
    Bench,
    Rows,
    add_density_arguments,
    form_config,
    make_bench,
    scored,
)

Found = dict[str, list[float]]
"""Scores of each method."""
FIRST, ON, ULOS = "stage 1", "stage 1, longer", "stage 1, ULoS off"
FIRSTS = (FIRST, ULOS)
WHOLE = ", whole rate"
MOVED = ", moved"
WIDTH = 41
"""Of a method's name when printed."""
SECOND: dict[str, dict[str, Any]] = {
    ON: {"rsdf_weight": 0.0, "train_reflectivity": False},
    "stage 2, lambda 1": {"rsdf_weight": 1.0},
    "stage 2, lambda 0.1": {"rsdf_weight": 0.1},
    "stage 2, lambda 0": {"rsdf_weight": 0.0},
    "stage 2, lambda 1, frozen": {"rsdf_weight": 1.0, "train_reflectivity": False},
}
SECOND |= {name + WHOLE: SECOND[name] | {"shape_rate": 1.0} for name in (ON, "stage 2, lambda 0.1")}
PAINT = """
patch_loss_db = 10.5
patch_length_m = 0.03
wall_loss_db = 0.45
"""
PLAUSIBLE = 'preset = "plausible"\n'
SPEC = """
[figure]
name = "{name}"
height_m = 0.12
turn_deg = 25.0
[[walls]]
size_m = [0.22, 0.22, 0.22]
[scan]
n_poses = {planes}
spacing_m = 0.004
[disturbance]
snr_db = 20.0
[world]
"""


def make_scenes(out: Path, figures: list[str], planes: int, *, world: bool) -> None:
    out.mkdir(parents=True, exist_ok=True)
    text = SPEC + (PLAUSIBLE if world else PAINT)
    for name in figures:
        spec, seed = out / f"{name}.toml", crc32(name.encode()) if world else 0
        spec.write_text(text.format(name=name, planes=planes), encoding="utf-8")
        if not (out / name).exists():
            program = Path(sys.executable).with_name("geraf2")
            run = [str(program), "simulate", str(spec), str(out / name), "--threads", "1"]
            subprocess.run([*run, "--seed", str(seed)], check=True)
            print(out / name, flush=True)


def after(name: str, n_steps: int) -> str:
    """Name of a method after its first steps."""
    return f"{name}, first {n_steps} steps"


@dataclass(frozen=True)
class Scoring:
    """What is scored of a training."""

    early: list[int]
    """Steps of a first stage."""
    moved: bool
    """The level moved to the glints beside the one of the form."""

    @property
    def levels(self) -> tuple[str, ...]:
        """What is added to a method's name."""
        return ("", MOVED) if self.moved else ("",)

    def stops(self, name: str) -> dict[str, int | None]:
        """After how many steps a training is scored, by what that is called; None: at its end."""
        early = self.early if name in FIRSTS else []
        return {after(name, n): n for n in early} | {name: None}

    def names(self, name: str) -> list[str]:
        """Methods that share one training."""
        return [route + level for route in self.stops(name) for level in self.levels]

    def figures(self, bench: Bench, name: str, trainer: PaperTrainer) -> Found:
        """Train to the end, and score."""
        found, form = Found(), trainer.config
        for route, n_steps in self.stops(name).items():
            for level in self.levels:
                moves = form.glint_level or level == MOVED
                trainer.config = replace(form, glint_level=moves)
                found[route + level] = scored(bench, trainer, n_steps=n_steps)
        return found


def train(bench: Bench, base: PaperConfig, routes: list[str], scoring: Scoring) -> Found:
    """Train methods, one of them FIRST, of one scene and seed."""
    alone = replace(base, stage2=replace(base.stage2, n_steps=0))
    first = bench.trainer(alone)
    found = scoring.figures(bench, FIRST, first)
    for name in routes:
        if name in SECOND:
            config = replace(base, stage2=replace(base.stage2, **SECOND[name]))
            found |= scoring.figures(bench, name, bench.second_stage(config, first))
        if name == ULOS:
            found |= scoring.figures(bench, name, bench.trainer(replace(alone, ulos=False)))
    return found


def calibrated(bench: Bench) -> Bench:
    """Capture and prior corrected as the first stage of every preset does it."""
    found = calibrate(bench.capture, bench.prior)
    return replace(bench, capture=found.capture, prior=found.prior)


def compared(rows: dict[tuple[str, str], list[list[float]]]) -> None:
    """Print means, and differences with their intervals."""
    scenes, names = sorted({scene for scene, _ in rows}), dict.fromkeys(name for _, name in rows)
    print(f"\n{'mean':{WIDTH}} " + " ".join(f"{n:>7}" for n in NAMES))
    means = {n: np.array([np.mean(rows[s, n], axis=0) for s in scenes]) for n in names}
    for name, values in means.items():
        print(f"{name:{WIDTH}} " + " ".join(f"{v:7.3f}" for v in values.mean(axis=0)))
    print("\ndifference, mean and 95 % interval over scenes; scenes in which it is better")
    for name, values in means.items():
        for against in references(name):
            if against in means:
                change = difference(values, means[against])
                print(f"{name:{WIDTH}} {f'less {against}':{WIDTH}} {change}")


def references(name: str) -> tuple[str, ...]:
    """Methods that a method is compared with."""
    if name.endswith(MOVED):
        return tuple(route + MOVED for route in references(name.removesuffix(MOVED)))
    if name.startswith(ULOS):
        return (name.replace(ULOS, FIRST),)
    if name not in SECOND:  # a first stage
        return ()
    if name.startswith(ON):
        return (FIRST,)
    return (ON + WHOLE if name.endswith(WHOLE) else ON, FIRST)


def difference(values: Floats, against: Floats) -> str:
    """Of F1 5 mm and CD of every scene, (n_scenes, 4) each: mean, interval, how many are better."""
    shown, n = [], len(values)
    for k, sign in ((1, 1.0), (2, -1.0)):
        change = values[:, k] - against[:, k]
        half = student.ppf(0.975, n - 1) * change.std(ddof=1) / n**0.5 if n > 1 else np.nan
        better = int((sign * change > 0.0).sum())
        shown.append(f"{NAMES[k]} {change.mean():+.4f} +- {half:.4f}, {better} of {n}")
    return ";  ".join(shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("scenes")
    making.add_argument("out", type=Path)
    figures = ["bunny", "elephant", "deer", "chicken", "dog", "jug", "llama", "shoe"]
    making.add_argument("--figures", nargs="+", default=figures)
    making.add_argument("--planes", type=int, default=18)
    making.add_argument("--world", action="store_true")
    training = commands.add_parser("train")
    training.add_argument("scenes", type=Path, nargs="+")
    training.add_argument("--steps", type=int, nargs=2, default=(1000, 300), metavar=("S1", "S2"))
    training.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    training.add_argument("--form", choices=list(FORMS), default="corrected")
    training.add_argument("--ways", nargs="+", choices=[*SECOND, ULOS], default=[*SECOND, ULOS])
    training.add_argument("--early", type=int, nargs="*", default=[], metavar="N")
    training.add_argument("--moved", action="store_true")
    training.add_argument("--calibrate", action="store_true")
    training.add_argument("--rows", type=Path)
    add_density_arguments(training)
    options = parser.parse_args()
    if options.command == "scenes":
        make_scenes(options.out, options.figures, options.planes, world=options.world)
        return
    options.early.sort()
    if not all(0 < n < options.steps[0] for n in options.early):
        parser.error(f"--early takes steps between 0 and the {options.steps[0]} of the first stage")
    if options.moved and FORMS[options.form].get("glint_level"):
        parser.error(f"--moved asks for a form whose level is as trained, not for {options.form}")
    scoring = Scoring(options.early, options.moved)
    routes = list(dict.fromkeys([FIRST, *options.routes]))
    kept = Rows(options.rows)
    print(f"{'scene':14} seed {'route':{WIDTH}} " + " ".join(f"{n:>7}" for n in NAMES))
    rows: dict[tuple[str, str], list[list[float]]] = {}
    for scene in options.scenes:
        bench = None
        for seed in options.seeds:
            start = time.process_time()
            missing = [
                route
                for route in routes
                if any((scene.name, seed, n) not in kept.known for n in scoring.names(route))
            ]
            if missing:
                if bench is None:
                    bench = make_bench(scene, options, seed)
                    bench = calibrated(bench) if options.calibrate else bench
                bench.seed = seed
                base = form_config(bench, options.form, options)
                for name, values in train(bench, base, missing, scoring).items():
                    if (scene.name, seed, name) not in kept.known:
                        kept.keep(scene.name, seed, name, values)
            for name in (name for route in routes for name in scoring.names(route)):
                values = kept.known[scene.name, seed, name]
                rows.setdefault((scene.name, name), []).append(values)
                shown = " ".join(f"{v:7.3f}" for v in values)
                print(f"{scene.name:14} {seed:4} {name:{WIDTH}} {shown}", flush=True)
            print(f"{'':14} {seed:4} {time.process_time() - start:.0f} CPU s", flush=True)
    compared(rows)


if __name__ == "__main__":
    main()
