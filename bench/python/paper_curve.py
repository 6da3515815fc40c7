"""F1 of `--preset paper` against its CPU time: equation 4, and the forms that centre its level.

    python bench/python/paper_curve.py SCENE --los LOS --truth TRUTH --out docs/paper-curve.png

Stage 1, then stage 2, one thread if OMP_NUM_THREADS says so; every tenth of a stage the mesh at the
zero level is taken and scored, as `paper_preset.py` does. The time is that of the process (user and
system) in training steps; heat maps before the first and the scoring are not in it. Beside the
picture lies the same as JSON. `unbiased` is T alpha for T^2 alpha together with the spreading of
equation 2, which the signals have: see docs/paper-method.md for either alone (`--forms`).
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from geraf2.learned.trainer import PaperTrainer
from paper_preset import (
    N_SCORED,
    Bench,
    add_scene_arguments,
    make_bench,
    matched_filter,
    sampled,
)

mpl.use("Agg")
from matplotlib import pyplot as plt  # the backend must be chosen first

PARTS = 10
FORMS: dict[str, dict[str, Any]] = {
    "equation 4": {},
    "unbiased": {"two_way": "unbiased", "spreading": "two-way"},
    "unbiased weight alone": {"two_way": "unbiased"},
    "spreading alone": {"spreading": "two-way"},
}
COLOURS = dict(zip(FORMS, ("tab:blue", "tab:orange", "tab:green", "tab:red"), strict=True))


def score(bench: Bench, trainer: PaperTrainer) -> dict[str, float]:
    """F1 and Chamfer distance of the zero level; zero and NaN where there is none."""
    found = bench.metrics(trainer, sampled(trainer), N_SCORED)
    if found is None:
        return {"f1_15_mm": 0.0, "f1_5_mm": 0.0, "chamfer_1e3_m2": float("nan")}
    return {
        "f1_15_mm": found.f1(0.015),
        "f1_5_mm": found.f1(0.005),
        "chamfer_1e3_m2": found.chamfer_1e3_m2,
    }


def run(bench: Bench, form: str, seed: int) -> list[dict[str, Any]]:
    """Scores along a training."""
    bench.seed = seed
    config = replace(bench.base, **FORMS[form])
    trainer = bench.trainer(config)
    steps = {1: config.stage1.n_steps, 2: config.stage2.n_steps}
    marks = {
        (stage, round(part * n / PARTS)) for stage, n in steps.items() for part in range(PARTS + 1)
    }
    points, cpu_s, losses = [], 0.0, []
    while not trainer.is_done:
        start = time.process_time()
        report = trainer.advance()
        cpu_s += time.process_time() - start
        losses.append(report.heatmap)
        mark = (report.stage, report.step + 1)
        if mark in marks:
            point = {"stage": mark[0], "step": mark[1], "cpu_s": cpu_s}
            points.append(point | score(bench, trainer) | {"loss": float(np.mean(losses[-100:]))})
            shown = {k: round(v, 3) for k, v in points[-1].items()}
            print(f"{form}, seed {seed}", shown, flush=True)
    return points


def draw(curves: list[dict[str, Any]], oracle: dict[str, float], out: Path) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), constrained_layout=True)
    for curve in curves:
        points = curve["points"]
        seconds = [point["cpu_s"] for point in points]
        for panel, key in zip(axes, ("f1_15_mm", "f1_5_mm"), strict=True):
            panel.plot(
                seconds,
                [point[key] for point in points],
                color=COLOURS[curve["form"]],
                linestyle=("-", "--", ":")[curve["seed"] % 3],
                label=f"{curve['form']}, seed {curve['seed']}",
            )
            after = [point["cpu_s"] for point in points if point["stage"] == 1]
            panel.plot(after[-1], [p[key] for p in points][len(after) - 1], "k|", markersize=14)
    for panel, key, name in zip(
        axes, ("f1_15_mm", "f1_5_mm"), ("F1 at 15 mm", "F1 at 5 mm"), strict=True
    ):
        panel.axhline(oracle[key], color="0.5", linewidth=1.0, label="matched filter, oracle")
        panel.set_xlabel("CPU seconds of training (bar: stage 2 begins)")
        panel.set_ylabel(name)
        panel.set_ylim(0.0, 1.02)
        panel.grid(alpha=0.3)
    axes[0].legend(fontsize=8, loc="lower right")
    figure.savefig(out, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_scene_arguments(parser, (1200, 400))
    parser.add_argument("--out", type=Path, required=True, help="picture; JSON lies beside it")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--forms", nargs="+", choices=list(FORMS), default=list(FORMS)[:2])
    options = parser.parse_args()
    bench = make_bench(options, options.seeds[0])
    curves = [
        {"form": form, "seed": seed, "points": run(bench, form, seed)}
        for seed in options.seeds
        for form in options.forms
    ]
    best = matched_filter(bench)
    oracle = {"f1_15_mm": best.f1_15mm, "f1_5_mm": best.f1_5mm}
    result = {"steps": options.steps, "curves": curves, "matched_filter": oracle}
    options.out.with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
    draw(curves, oracle, options.out)


if __name__ == "__main__":
    main()
