"""Run the matched-filter benchmark and print each kernel beside the naive loop of the same run.

    python bench/compare.py                       the instruction set that this CPU would use
    python bench/compare.py --simd avx2 avx512    each of these
    python bench/compare.py --check               exit 1 unless every kernel reaches its target
    python bench/compare.py --check-threads       of every kernel, two threads against one; exit 1
                                                  unless all gain enough: on an idle machine

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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path("build/bench/bench/cpp")
PROGRAM = "geraf2_bench_matched_filter"
FACTORISED_PROGRAM = "geraf2_bench_factorised"
TRACER_PROGRAM = "geraf2_bench_signal_tracer"
THREADED_PROGRAMS = (
    PROGRAM,
    FACTORISED_PROGRAM,
    TRACER_PROGRAM,
    "geraf2_bench_ray_march",
    "geraf2_bench_sdf_grid",
    "geraf2_bench_subaperture",
    "geraf2_bench_grid_energy",
    "geraf2_bench_physical_optics",
    "geraf2_bench_mesh_scene",
)
"""Those that measure one thread and two, under names that end in `threads:N/real_time`."""
NAIVE = "BM_MatchedFilterNaive"
PEAK = "BM_FmaPeak"
COPY = "BM_MachineCopy"
MACHINE = {"BM_MachineMultiplyAdds": "multiply-adds", COPY: "copies"}
"""Linked into every program: what two threads gain where they share nothing but the machine."""


@dataclass(frozen=True)
class Figures:
    """What a kernel is to reach: float32, one thread, 64 samples, on AVX2 or better."""

    ratio: float | None = None
    """To the naive loop, at least."""
    ns: float | None = None
    """Of a pair, at most."""
    bound: float | None = None
    """Fraction of the speed that the multiply-add peak allows, at least."""
    error: float | None = None
    """Against the float64 sum, at most."""


FIGURES = {
    "BM_MatchedFilter<float, block>": Figures(ratio=600, ns=1.0, bound=0.65, error=5e-4),
    "BM_MatchedFilter<float, block, 4>": Figures(ns=1.2, error=5e-5),
    "BM_MatchedFilter<float, exact>": Figures(ratio=75, bound=0.60, error=2e-4),
}
TRACER_NAIVE = {False: "BM_SignalTracerNaive<false>", True: "BM_SignalTracerNaive<true>"}
TRACER_MIN_RATIO = 300.0
"""Signal tracer against the naive loop, forward, and forward with backward."""
TRACER_MAX_MS = 70.0
"""Forward with backward, 25,000 points x 512 antennas x 64 samples."""

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
UNDISTURBED_RATIO = 1.9
"""What multiply-adds on registers gain at least where nobody else uses the two cores."""
QUIET_RATIO = 1.05
"""Of a median to the shortest time yet, at most, where nobody else uses the core's other half."""
QUIET_THREADS_RATIO = 1.03
"""The same where the quotient of two medians is judged: both errors count."""
ATTEMPTS = 8
"""To find the machine undisturbed."""


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
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
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
            "multiply_adds": group[0].get("multiply_adds"),
            "label": group[0]["label"],
        }
        for name, group in by_name.items()
    }


def times_by_name(entries: list[dict[str, Any]], measure: str) -> dict[str, list[float]]:
    times = defaultdict(list)
    for entry in entries:
        times[entry["name"]].append(entry[measure])
    return times


class QuietRuns:
    """Runs of benchmarks side by side, each again until the machine was undisturbed."""

    def __init__(self, measure: str, quiet_ratio: float) -> None:
        self.measure = measure
        self.quiet_ratio = quiet_ratio
        self.best: dict[str, float] = {}
        """Shortest time so far, by name."""

    def disturbance(self, entries: list[dict[str, Any]]) -> float:
        """Largest median over the shortest time of that benchmark so far; copies of memory, which
        are for comparison, vary more than any kernel and do not count.
        """
        kernels = [entry for entry in entries if not entry["name"].startswith(COPY)]
        times = times_by_name(kernels, self.measure)
        for name, of_name in times.items():
            self.best[name] = min(*of_name, self.best.get(name, float("inf")))
        return max(statistics.median(of_name) / self.best[name] for name, of_name in times.items())

    def attempts(
        self,
        program: Path,
        simd: str | None,
        repetitions: int,
        only: str,
        cores_are_free: Callable[[list[dict[str, Any]]], bool] = lambda _: True,
    ) -> list[list[dict[str, Any]]]:
        """Entries of each run, up to the first quiet one whose cores were free."""
        found: list[list[dict[str, Any]]] = []
        while len(found) < ATTEMPTS:
            found.append(run(program, simd, repetitions, only))
            if self.disturbance(found[-1]) <= self.quiet_ratio and cores_are_free(found[-1]):
                break
        return found

    def run(
        self, program: Path, simd: str | None, repetitions: int, only: str
    ) -> tuple[list[dict[str, Any]], str]:
        """The first quiet run, else the quietest, with words that say so."""
        attempts = self.attempts(program, simd, repetitions, only)
        # Shortest times are known better now than when each was run.
        quietest = min(attempts, key=self.disturbance)
        quiet = self.disturbance(quietest) <= self.quiet_ratio
        return quietest, "" if quiet else " (cores not free)"


def compare_matched_filter(program: Path, simd: str | None, repetitions: int) -> bool:
    """Print every kernel beside the naive loop and its limit; whether all targets are reached.

    Each is run alone with both: what shares a core with a neighbour for some seconds is measured
    again.
    """
    # The grid-spacing series is for tuning `auto`, not for comparison.
    names = list_benchmarks(program, f"-(Spacing|real_time|{NAIVE}|{'|'.join([PEAK, *MACHINE])})")
    runs = QuietRuns("cpu_time", QUIET_RATIO)
    reached = True
    for name in sorted(names):
        only = f"^({name}|{NAIVE}/.*|{PEAK})$"
        entries, disturbed = runs.run(program, simd, repetitions, only)
        kernels = collect(entries)
        naive, peak = kernels.pop(NAIVE), kernels.pop(PEAK)
        if name == min(names):
            print(
                f"{peak['label']}: {1.0 / peak['ns']:.1f}e9 multiply-adds per second, "
                f"naive {naive['ns']:.1f} ns/pair with error {naive['error']:.1e}, one thread"
            )
            print(
                f"{'kernel':40} {'ns/pair':>9} {'vs naive':>9} {'limit ns':>9} {'of limit':>8} "
                f"{'rel. error':>10}"
            )
        for kernel, measured in kernels.items():
            verdict = show(kernel, measured, naive["ns"], peak["ns"], disturbed)
            reached = reached and verdict in ("", "reached")
    return reached


def show(name: str, kernel: dict[str, Any], naive_ns: float, peak_ns: float, disturbed: str) -> str:
    """Print one kernel and return what it misses."""
    ns, error, count = kernel["ns"], kernel["error"], kernel["multiply_adds"]
    limit = None if count is None else count * peak_ns
    bound = "" if limit is None else f"{limit:9.3f} {100 * limit / ns:6.0f} %"
    verdict = missed(FIGURES.get(name), naive_ns / ns, ns, limit, error)
    print(
        f"{name:40} {ns:9.3f} {naive_ns / ns:8.1f}x {bound:>18} "
        f"{'' if error is None else f'{error:.2e}':>10}  {verdict}{disturbed}",
        flush=True,
    )
    return verdict


def missed(
    figures: Figures | None, ratio: float, ns: float, limit: float | None, error: float | None
) -> str:
    """Name the targets that are missed."""
    if figures is None:
        return ""
    faults = []
    if figures.ratio is not None and ratio < figures.ratio:
        faults.append(f"below {figures.ratio:.0f}x")
    if figures.ns is not None and ns > figures.ns:
        faults.append(f"above {figures.ns} ns (of an idle core)")
    if figures.bound is not None and limit is not None and limit / ns < figures.bound:
        faults.append(f"below {100 * figures.bound:.0f} % of the limit")
    if figures.error is not None and error is not None and error > figures.error:
        faults.append(f"error above {figures.error:.0e}")
    return "MISSED: " + ", ".join(faults) if faults else "reached"


def compare_tracer(program: Path, simd: str | None, repetitions: int) -> bool:
    """Print the signal tracer beside the naive loop; whether its targets are reached."""
    times = defaultdict(list)
    for entry in run(program, simd, repetitions, f"-(real_time|<double|{PEAK})"):
        times[entry["name"].split("/")[0]].append(entry)
    medians = {
        name: statistics.median(1e9 / e["items_per_second"] for e in group)
        for name, group in times.items()
    }
    reached = True
    for name, ns in medians.items():
        if name in TRACER_NAIVE.values():
            continue
        backward = "ForwardBackward" in name
        ratio = medians[TRACER_NAIVE[backward]] / ns
        ms = statistics.median(e["cpu_time"] for e in times[name])
        verdict = ""
        if name.endswith("<float, shared>"):  # the amplitudes that the naive loop has
            good = ratio >= TRACER_MIN_RATIO and (not backward or ms <= TRACER_MAX_MS)
            reached = reached and good
            verdict = (
                f"  at least {TRACER_MIN_RATIO:.0f}x"
                + (f", at most {TRACER_MAX_MS:.0f} ms: " if backward else ": ")
                + ("reached" if good else "MISSED")
            )
        print(f"{name:62} {ns:7.3f} ns/pair {ms:7.1f} ms {ratio:7.0f}x{verdict}")
    return reached


def compare_factorised(program: Path, simd: str | None, repetitions: int) -> bool:
    """Print factorised beside block of the same run; whether its targets are reached."""
    times, errors = defaultdict(list), {}
    for entry in run(program, simd, repetitions, f"-(real_time|{PEAK})"):
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


def list_benchmarks(program: Path, only: str) -> list[str]:
    """Full names of the benchmarks that match `only`, or do not if it begins with `-`."""
    listed = subprocess.run(
        [str(program), "--benchmark_list_tests=true", f"--benchmark_filter={only}"],
        capture_output=True,
        text=True,
        check=True,
    )
    return listed.stdout.split("\n")[:-1]


def threaded_kernels(program: Path) -> list[str]:
    """Names of the benchmarks that measure one thread and two, without the number of threads."""
    one_thread = "/threads:1/real_time"
    names = [name.removesuffix(one_thread) for name in list_benchmarks(program, one_thread)]
    return [name for name in names if name not in MACHINE]


def gains(attempts: list[list[dict[str, Any]]], measure: str) -> dict[str, float]:
    """Time of one thread over that of two, by kernel: of each the least median of all runs."""
    least: dict[str, dict[str, float]] = defaultdict(dict)
    for entries in attempts:
        for name, of_name in times_by_name(entries, measure).items():
            kernel, threads = name.removesuffix("/real_time").rsplit("/threads:", 1)
            median = statistics.median(of_name)
            least[kernel][threads] = min(median, least[kernel].get(threads, median))
    return {kernel: by_threads["1"] / by_threads["2"] for kernel, by_threads in least.items()}


def compare_threads(program: Path, simd: str | None, repetitions: int) -> bool:
    """Print the wall time of one thread over that of two; whether it is enough.

    Each kernel is run alone with what the machine gains by a second thread, so that all are
    measured within seconds, and again while that is too little or medians are far from the shortest
    times: a neighbour disturbs two threads twice as often as one, so of either the quietest run
    counts. Beside it the same ratio of the first thread's CPU time, which shows what remains serial
    though the machine be busy: with OMP_WAIT_POLICY=passive, where work is shared out evenly.
    """
    reached = True
    runs = QuietRuns("real_time", QUIET_THREADS_RATIO)

    def cores_are_free(entries: list[dict[str, Any]]) -> bool:
        return gains([entries], "real_time")["BM_MachineMultiplyAdds"] >= UNDISTURBED_RATIO

    for kernel in threaded_kernels(program):
        only = f"^({kernel}|{'|'.join(MACHINE)})/threads:[12]/real_time$"
        attempts = runs.attempts(program, simd, repetitions, only, cores_are_free)
        wall, cpu = gains(attempts, "real_time"), gains(attempts, "cpu_time")
        good = wall[kernel] >= MIN_THREAD_RATIO
        reached = reached and good
        limits = ", ".join(f"{label} {wall[name]:.2f}x" for name, label in MACHINE.items())
        share = 100.0 * wall[kernel] / wall["BM_MachineMultiplyAdds"]
        print(
            f"{kernel:74} two threads {wall[kernel]:.2f}x (first thread's CPU "
            f"{cpu[kernel]:.2f}x; the machine's {limits}: {share:.0f} % of the first), "
            f"at least {MIN_THREAD_RATIO}: {'reached' if good else 'MISSED'}; "
            f"{len(attempts)} runs",
            flush=True,
        )
    return reached


def compare_kernels(folder: Path, simd: str | None, repetitions: int) -> bool:
    """Print each kernel beside its peers of the same run, one thread; whether all is reached."""
    reached = compare_matched_filter(folder / PROGRAM, simd, repetitions)
    reached = compare_tracer(folder / TRACER_PROGRAM, simd, repetitions) and reached
    return compare_factorised(folder / FACTORISED_PROGRAM, simd, repetitions) and reached


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
    for path in (options.folder / name for name in THREADED_PROGRAMS):
        if not path.is_file():
            print(
                f"{path} is missing; build it:\n"
                "  cmake --preset bench && cmake --build --preset bench",
                file=sys.stderr,
            )
            return 2
    reached = True
    for simd in options.simd:
        if options.check_threads:
            for name in THREADED_PROGRAMS:
                reached = (
                    compare_threads(options.folder / name, simd, options.repetitions) and reached
                )
        else:
            reached = compare_kernels(options.folder, simd, options.repetitions) and reached
    return 0 if reached or not (options.check or options.check_threads) else 1


if __name__ == "__main__":
    sys.exit(main())
