"""Measure this commit, append one JSON line to a file, print what changed since the line before.

    python bench/track.py FILE                     kernels, and twenty scenes of the population
    python bench/track.py FILE --only kernels      `make bench` built them
    python bench/track.py FILE --only scans        whole reconstructions; also with --data FOLDER
    python bench/track.py FILE --work FOLDER       simulated scenes are kept there

Of a kernel: ns per item, ratio to the naive twin of the same run, and fraction of the limit that
the measured multiply-add peak sets, where the kernel counts its multiply-adds. Of the population:
F1 at 5 mm of each seed; a scene that fails counts 0. Of three scans, the independent capture
`spot_carton` of --data with both presets and its content simulated with nine times the antennas:
median CPU seconds and peak memory of `geraf2 reconstruct --no-report`, and the ratio of that time
to the lower bound, pairs of antennas and bins of all images times the kernel's ns a pair. Lines of
different machines compare by ratio and fraction alone.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from math import prod
from pathlib import Path
from statistics import fmean, median
from typing import Any

import compare

SCORE = "f1_5mm"
DENSE = """
[figure]
mesh = "{mesh}"
height_m = 0.12
[[walls]]
size_m = [0.22, 0.22, 0.22]
[scan]
spacing_m = 0.001
[numerics]
wall_patch_m = 0.02
antenna_block_m = 0.07
"""
# Kernel -> naive twin, by program; one thread.
TWINS = {
    compare.PROGRAM: {
        "BM_MatchedFilter<float, exact>": compare.NAIVE,
        "BM_MatchedFilter<float, block>": compare.NAIVE,
        "BM_MatchedFilter<float, block, 4>": compare.NAIVE,
    },
    compare.TRACER_PROGRAM: {
        "BM_SignalTracer<float, shared>": "BM_SignalTracerNaive<false>",
        "BM_SignalTracerForwardBackward<float, shared>": "BM_SignalTracerNaive<true>",
    },
    "geraf2_bench_ray_march": {"BM_RayMarch": "BM_RayMarchNaive"},
    "geraf2_bench_sdf_grid": {
        f"BM_SdfGrid<{kind}, 1>": f"BM_SdfGridNaive<{kind}, 1>" for kind in ("linear", "cubic")
    },
}


def kernels(folder: Path, repetitions: int) -> dict[str, dict[str, Any]]:
    """Measures of each kernel by name."""
    found = {}
    for program, twins in TWINS.items():
        if not (folder / program).is_file():
            sys.exit(f"{folder / program} is missing: build it with make bench")
        wanted = {*twins, *twins.values(), compare.PEAK}
        listed = compare.list_benchmarks(folder / program, "-real_time")
        only = "|".join(name for name in listed if name.split("/")[0] in wanted)
        runs = compare.QuietRuns("cpu_time", compare.QUIET_RATIO)
        entries, disturbed = runs.run(folder / program, None, repetitions, f"^({only})$")
        times = compare.collect(entries)
        for name, twin in twins.items():
            ns, count = times[name]["ns"], times[name]["multiply_adds"]
            measures = {"ns": ns, "vs_naive": times[twin]["ns"] / ns, "quiet": not disturbed}
            if count is not None:
                measures["of_limit"] = count * times[compare.PEAK]["ns"] / ns
            found[name] = measures
    return found


def population(work: Path, seeds: str) -> dict[str, float]:
    """F1 of each seed; 0 where a scene failed. Scenes are kept in work, runs are made anew."""
    work.mkdir(parents=True, exist_ok=True)
    program = Path(sys.executable).with_name("geraf2")
    with tempfile.TemporaryDirectory(dir=work) as out:
        command = [program, "benchmark", out, "--only", "population", "--seeds", seeds]
        subprocess.run([*command, "--cache", work / "scenes"], check=True)
        return scores_of((Path(out) / "population.jsonl").read_text(encoding="utf-8"))


def scans(work: Path, data: Path, repetitions: int) -> dict[str, dict[str, float]]:
    """Measures of each scan by name. Scenes are kept in work, runs are made anew."""
    spot = data.resolve() / "spot_carton"
    program = str(Path(sys.executable).with_name("geraf2"))
    work.mkdir(parents=True, exist_ok=True)
    if not (work / "spot").exists():
        subprocess.run([program, "import", "geraf-sens", spot, work / "spot"], check=True)
    if not (work / "dense").exists():
        (work / "dense.toml").write_text(DENSE.format(mesh=spot / "truth_object.ply"))
        subprocess.run([program, "simulate", work / "dense.toml", work / "dense"], check=True)
    found = {}
    for name, scene, preset in (
        ("spot fast", "spot", "fast"),
        ("spot best", "spot", "best"),
        ("spot best, 9 times the antennas", "dense", "best"),
    ):
        arguments = ["--box", "0.22", "0.22", "0.22", "--preset", preset, "--no-report"]
        with tempfile.TemporaryDirectory(dir=work) as out:
            command = [sys.executable, Path(__file__).parent / "python" / "reconstruct.py"]
            command += [work / scene, "--repeats", str(repetitions), "--json", f"{out}/cost.json"]
            subprocess.run([*command, "--", *arguments], check=True)
            cost = json.loads((Path(out) / "cost.json").read_text(encoding="utf-8"))
        n_pairs, bound_s = imaging(work / scene, repetitions)
        cpu_s = cost["cpu_s"]["median"]
        found[name] = {
            "cpu_s": cpu_s,
            "memory_mib": cost["peak_memory_mib"]["median"],
            "ns": 1e9 * bound_s / n_pairs,
            "vs_bound": cpu_s / bound_s,
        }
    return found


def imaging(scene: Path, repetitions: int) -> tuple[int, float]:
    """Pairs of antennas and bins of the images, and CPU seconds of the kernel for them."""
    from geraf2.imaging.peaks import box_spans  # noqa: PLC0415 - kernels are measured without it
    from geraf2.imaging.subapertures import SubapertureConfig, pose_images  # noqa: PLC0415
    from geraf2.ops.subaperture import subaperture_peaks  # noqa: PLC0415
    from geraf2.scene import LosPrior, load_capture  # noqa: PLC0415

    capture, prior = load_capture(scene), LosPrior.from_box((0.22, 0.22, 0.22))
    config = SubapertureConfig()
    images = [
        pose_images(pose, capture.waveform, prior.bounds.mean(axis=0), tuple(span), config)
        for pose, span in zip(capture.poses, box_spans(capture.poses, prior), strict=True)
    ]
    seconds = []
    for _ in range(repetitions):
        start = time.process_time()
        for each in images:
            subaperture_peaks(
                each.pose.signal,
                each.pose.tx_positions,
                each.pose.rx_positions,
                each.waveform,
                each.subapertures,
                each.bins,
                thresholds_db=(100.0, 12.0),
                num_threads=1,
            )
        seconds.append(time.process_time() - start)
    n_pairs = sum(len(each.subapertures.antennas) * prod(each.bins.shape) for each in images)
    return n_pairs, median(seconds)


def scores_of(lines: str) -> dict[str, float]:
    """Last score of each seed."""
    results = [json.loads(line) for line in lines.splitlines() if line.strip()]
    return {
        str(result["seed"]): 0.0 if result["error"] else float(result["scores"][SCORE])
        for result in results
    }


def changes(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """What differs between two lines of the file, one thing a line."""
    rows = []
    same_machine = before.get("machine") == after["machine"]
    old_rows, new_rows = (
        line.get("kernels", {}) | line.get("scans", {}) for line in (before, after)
    )
    for name, new in new_rows.items():
        old = old_rows.get(name)
        if old is None:
            continue
        shown = [key for key in new if key in old and key != "quiet"]
        shown = shown if same_machine else [key for key in shown if key not in {"ns", "cpu_s"}]
        texts = [f"{key} {old[key]:.3g} -> {new[key]:.3g}" for key in shown]
        noisy = "" if old.get("quiet", True) and new.get("quiet", True) else " (cores not free)"
        rows.append(f"{name}: {', '.join(texts)}{noisy}")
    old, new = before.get("population", {}), after.get("population", {})
    common = sorted(old.keys() & new.keys(), key=int)
    if common:
        means = [fmean(scores[seed] for seed in common) for scores in (old, new)]
        worst = min(common, key=lambda seed: new[seed] - old[seed])
        rows.append(
            f"population, {len(common)} seeds: mean F1 at 5 mm {means[0]:.4f} -> {means[1]:.4f}, "
            f"largest loss {old[worst] - new[worst]:.3f} (seed {worst})"
        )
    return rows


def last_line(path: Path) -> dict[str, Any] | None:
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return json.loads(lines[-1]) if lines else None


def machine() -> str:

    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return "unknown"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", choices=["kernels", "population", "scans"])
    parser.add_argument("--data", type=Path, help="folder of the capture of --only scans")
    parser.add_argument("--folder", type=Path, default=compare.FOLDER, help="of the programs")
    parser.add_argument("--work", type=Path, default=Path("out/track"))
    parser.add_argument("--seeds", default="1000:1020", metavar="A:B")
    parser.add_argument("--repetitions", type=int, default=7)
    options = parser.parse_args()
    before = last_line(options.file)
    commit = subprocess.check_output(["git", "describe", "--always", "--dirty"], text=True).strip()
    line = {"commit": commit, "date": f"{datetime.now(UTC):%Y-%m-%d}", "machine": machine()}
    if options.only in {None, "kernels"}:
        line["kernels"] = kernels(options.folder, options.repetitions)
    if options.only in {None, "population"}:
        line["population"] = population(options.work, options.seeds)
    if options.only == "scans" or (options.only is None and options.data):
        if options.data is None:
            parser.error("the scans need --data")
        line["scans"] = scans(options.work, options.data, min(options.repetitions, 3))
    with options.file.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")
    print(f"{commit}: appended to {options.file}")
    if before is not None:
        print(f"since {before['commit']}:", *changes(before, line), sep="\n  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
