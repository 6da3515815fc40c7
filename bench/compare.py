"""Run the matched-filter benchmark and print each kernel beside the naive loop of the same run.

    python bench/compare.py                       the instruction set that this CPU would use
    python bench/compare.py --simd avx2 avx512    each of these
    python bench/compare.py --check               exit 1 unless block and factorised reach theirs
    python bench/compare.py --check-threads       and unless two threads do: on an idle machine

Times are CPU times of one thread, medians over repetitions that are interleaved at random, so that
a neighbour on the same machine disturbs all kernels alike. Errors are relative to the norm of the
float64 direct sum, on white noise.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

FOLDER = Path("build/bench/bench/cpp")
PROGRAM = "geraf2_bench_matched_filter"
FACTORISED_PROGRAM = "geraf2_bench_factorised"
NAIVE = "BM_MatchedFilterNaive"
BLOCK = "BM_MatchedFilter<float, block>"
PEAK = "BM_FmaPeak"

MIN_RATIO = 400.0
"""Block against the naive loop, both float32, one thread."""
MAX_ERROR = 5e-4
"""Of block at rtol 1e-3."""

# Least ratio of block to factorised, both float32, one thread, 65,536 antennas, 64^3 voxels, and
# largest error of factorised: by levels and digits of rtol.
FACTORISED_FIGURES = {
    (1, 3): (25.0, 1e-3),
    (2, 3): (50.0, 1e-3),
    (1, 4): (12.0, 1e-4),
    (2, 4): (12.0, 1e-4),
}
MIN_THREAD_RATIO = 1.8
"""Wall time of one thread over that of two."""

# Multiply-adds (or bare products) of one (antenna, point) pair, 64 samples: four a sample; and for
# the blocks 12 for both ranges, 7 for sine and cosine, 6 for the profile, 4 for the sum.
MULTIPLY_ADDS = {
    "BM_MatchedFilter<float, exact>": 256,
    "BM_MatchedFilterAdjoint<float, exact>": 256,
    BLOCK: 29,
    "BM_MatchedFilterAdjoint<float, block>": 29,
}


def run(program: Path, simd: str | None, repetitions: int, only: str) -> list[dict[str, Any]]:
    """Entries of the benchmarks that match `only`, or that do not match if it begins with `-`."""
    environment = dict(os.environ) if simd is None else {**os.environ, "GERAF2_SIMD": simd}
    done = subprocess.run(
        [
            str(program),
            "--benchmark_format=json",
            f"--benchmark_repetitions={repetitions}",
            "--benchmark_min_time=0.05",
            "--benchmark_enable_random_interleaving=true",
            f"--benchmark_filter={only}",
        ],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [b for b in json.loads(done.stdout)["benchmarks"] if b["run_type"] == "iteration"]


def collect(entries: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Medians by kernel: ns per item, relative error, instruction set."""
    by_name = defaultdict(list)
    for entry in entries:
        if entry.get("error_occurred"):
            msg = f"{entry['name']}: {entry['error_message']}"
            raise SystemExit(msg)
        by_name[entry["name"].split("/")[0]].append(entry)
    return {
        name: {
            # items_per_second is taken from CPU time
            "ns": statistics.median(1e9 / e["items_per_second"] for e in group),
            "error": statistics.median(e["rel_error"] for e in group)
            if "rel_error" in group[0]
            else None,
            "label": group[0]["label"],
        }
        for name, group in by_name.items()
    }


def show(kernels: dict[str, dict[str, Any]]) -> None:
    naive = kernels[NAIVE]["ns"]
    peak_ns = kernels[PEAK]["ns"]
    print(f"{kernels[PEAK]['label']}: {1.0 / peak_ns:.1f}e9 multiply-adds per second, one thread")
    print(f"{'kernel':42} {'ns/pair':>9} {'vs naive':>9} {'limit ns':>9} {'rel. error':>11}")
    for name, kernel in sorted(kernels.items()):
        if name == PEAK:
            continue
        count = MULTIPLY_ADDS.get(name)
        limit = "" if count is None else f"{count * peak_ns:9.3f}"
        error = "" if kernel["error"] is None else f"{kernel['error']:11.2e}"
        ratio = naive / kernel["ns"]
        print(f"{name:42} {kernel['ns']:9.3f} {ratio:8.1f}x {limit:>9} {error:>11}")


def check(kernels: dict[str, dict[str, Any]]) -> bool:
    ratio = kernels[NAIVE]["ns"] / kernels[BLOCK]["ns"]
    error = kernels[BLOCK]["error"]
    reached = ratio >= MIN_RATIO and error <= MAX_ERROR
    verdict = "reached" if reached else "MISSED"
    print(
        f"block vs naive {ratio:.0f}x (at least {MIN_RATIO:.0f}), "
        f"error {error:.1e} (at most {MAX_ERROR:.0e}): {verdict}"
    )
    return reached


def compare_factorised(program: Path, simd: str | None, repetitions: int) -> bool:
    """Print factorised beside block of the same run; whether its figures are reached."""
    times, errors = defaultdict(list), {}
    for entry in run(program, simd, repetitions, "-real_time"):
        name = entry["name"].rsplit("/", 1)[0]
        times[name].append(1e9 / entry["items_per_second"])
        errors[name] = entry.get("rel_error")
    ns = {name: statistics.median(values) for name, values in times.items()}
    reached = True
    print(f"{'kernel':52} {'ns/pair':>9} {'vs block':>9} {'rel. error':>11}")
    for name, value in ns.items():
        kernel, _, digits = name.split("/")
        block = ns[f"{kernel.split('<')[0]}<block, 1>/side:27/{digits}"]
        error = "" if errors[name] is None else f"{errors[name]:11.2e}"
        verdict = ""
        figures = FACTORISED_FIGURES.get((int(kernel[-2]), int(digits[-1])))
        if kernel.startswith("BM_Plane<factorised") and figures is not None:
            good = block / value >= figures[0] and errors[name] <= figures[1]
            reached = reached and good
            verdict = f"  at least {figures[0]:.0f}x, at most {figures[1]:.0e}: " + (
                "reached" if good else "MISSED"
            )
        print(f"{name:52} {value:9.4f} {block / value:8.1f}x {error:>11}{verdict}")
    return reached


def compare_threads(program: Path, simd: str | None, repetitions: int) -> bool:
    """Print the wall time of one thread over that of two; whether it is enough."""
    times: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for entry in run(program, simd, repetitions, "real_time"):
        kernel, _, _, threads, _ = entry["name"].split("/")
        times[kernel][threads].append(entry["real_time"])
    reached = True
    for kernel, by_threads in times.items():
        one, two = (statistics.median(by_threads[f"threads:{n}"]) for n in (1, 2))
        reached = reached and one / two >= MIN_THREAD_RATIO
        print(f"{kernel}: two threads {one / two:.2f}x (at least {MIN_THREAD_RATIO})")
    return reached


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of the built benchmarks")
    parser.add_argument("--simd", nargs="+", default=[None], metavar="LEVEL")
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--check-threads", action="store_true")
    options = parser.parse_args()
    program, factorised = options.folder / PROGRAM, options.folder / FACTORISED_PROGRAM
    for path in (program, factorised):
        if not path.is_file():
            print(
                f"{path} is missing; build it:\n"
                "  cmake --preset bench && cmake --build --preset bench",
                file=sys.stderr,
            )
            return 2
    reached = True
    for simd in options.simd:
        # the grid-spacing series is for tuning `auto`, not for comparison
        kernels = collect(run(program, simd, options.repetitions, "-BM_MatchedFilterSpacing"))
        show(kernels)
        reached = check(kernels) and reached
        reached = compare_factorised(factorised, simd, options.repetitions) and reached
        if options.check_threads:
            reached = compare_threads(factorised, simd, options.repetitions) and reached
    return 0 if reached or not (options.check or options.check_threads) else 1


if __name__ == "__main__":
    sys.exit(main())
