"""Time of the kernels over voxels, antennas, samples and threads, drawn into docs/scaling.png.

    python bench/python/scaling.py [--out FILE]

Single precision, CPU time, medians. Over threads: CPU time of one thread over that of the busiest
of n, which a loaded machine shows too; it leaves out waiting for memory. The title names the CPU.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from geraf2.ops import matched_filter, signal_tracer, simd_level
from geraf2.scene import Grid, Waveform

METHODS = ("exact", "block", "factorised")
COLORS = {
    "exact": "#777777",
    "block": "#1f6fb4",
    "factorised": "#c8501e",
    "signal tracer": "#2c8a4b",
}
MAX_PAIRS = {"exact": 2e7, "block": 3e8, "factorised": 1e12, "signal tracer": 2e8}
"""No measurement takes much more than a fifth of a second."""


def cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return "unknown CPU"
    return next((line.split(":", 1)[1].strip() for line in lines if "model name" in line), "CPU")


def waveform(n_samples: int) -> Waveform:
    return Waveform(
        start_frequency_hz=77.3704e9,
        chirp_slope_hz_per_s=70.15e12,
        n_samples=n_samples,
        sample_rate_hz=10e6 * n_samples / 512,
        path_bias_m=0.15,
    )


def antennas(count: int) -> np.ndarray:
    """A raster of lambda / 4 spacing, 0.36 m in front of the origin."""
    rows = 2 ** (int(np.log2(count)) // 2)
    y, z = np.meshgrid(np.arange(rows), np.arange(count // rows), indexing="ij")
    positions = np.stack(
        [np.full(y.size, -360.0), y.ravel() - rows / 2, z.ravel() - y.size / rows / 2]
    )
    return 1e-3 * positions.T


def seconds(step: Callable[[], object], repeats: int, clock: Callable[[], float]) -> float:
    step()
    times = []
    for _ in range(repeats):
        start = clock()
        step()
        times.append(clock() - start)
    return statistics.median(times)


class Case:
    """White noise at a size; `run` takes a kernel's name."""

    def __init__(self, n_antennas: int = 4096, side: int = 32, n_samples: int = 64) -> None:
        rng = np.random.default_rng(0)
        self.tx = antennas(n_antennas)
        self.waveform = waveform(n_samples)
        noise = rng.normal(size=(2, len(self.tx), n_samples)).astype(np.float32)
        self.signal = noise[0] + 1j * noise[1]
        self.grid = Grid.cube((0.0, 0.0, 0.0), 0.5e-3 * (side - 1), side)
        self.pairs = len(self.tx) * self.grid.n_voxels

    def run(self, name: str, num_threads: int = 1) -> object:
        if name == "signal tracer":
            points = self.grid.points()
            amplitude = np.ones(len(points), np.float32)
            return signal_tracer(
                amplitude, points, self.tx, self.tx, self.waveform, num_threads=num_threads
            )
        return matched_filter(
            self.signal,
            self.tx,
            self.tx,
            self.grid,
            self.waveform,
            method=name,
            num_threads=num_threads,
        )


def curve(axes: Axes, name: str, what: str, sizes: dict[int, Case], repeats: int) -> None:
    kept = {x: case for x, case in sizes.items() if case.pairs <= MAX_PAIRS[name]}
    ns = [
        1e9 * seconds(lambda c=case: c.run(name), repeats, time.process_time) / case.pairs
        for case in kept.values()
    ]
    axes.loglog(list(kept), ns, "o-", color=COLORS[name], label=name, markersize=3)
    print(f"{what}, {name}: " + ", ".join(f"{x} {v:.3g}" for x, v in zip(kept, ns, strict=True)))


def busiest_thread(step: Callable[[], object], repeats: int) -> list[float]:
    """CPU time of the thread that worked most, for each call [s]."""

    def spent() -> dict[str, float]:
        tasks = Path("/proc/self/task").iterdir()
        return {t.name: int((t / "schedstat").read_text().split()[0]) * 1e-9 for t in tasks}

    step()
    times = []
    for _ in range(repeats):
        before = spent()
        step()
        times.append(max(t - before.get(name, 0.0) for name, t in spent().items()))
    return times


def threads_curve(axes: Axes, repeats: int) -> None:
    counts = range(1, len(os.sched_getaffinity(0)) + 1)
    sizes = {"exact": (512, 14), "block": (1024, 32), "factorised": (8192, 64)}
    sizes["signal tracer"] = (512, 32)
    for name, (n_antennas, side) in sizes.items():
        case = Case(n_antennas, side)
        busiest = {
            n: statistics.median(busiest_thread(lambda c=case, k=name, n=n: c.run(k, n), repeats))
            for n in counts
        }
        ratios = [busiest[1] / t for t in busiest.values()]
        axes.plot(list(counts), ratios, "o-", color=COLORS[name], markersize=3)
        print(f"threads, {name}: " + ", ".join(f"{v:.2f}x" for v in ratios))
    axes.plot(list(counts), list(counts), ":", color="black", linewidth=0.8)
    axes.set_ylim(bottom=0)
    axes.set(xlabel="threads", ylabel="times one thread (CPU of the busiest)", xticks=list(counts))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/scaling.png"))
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    mpl.use("agg")
    figure, ((voxels, elements), (samples, threads)) = plt.subplots(
        2, 2, figsize=(8.5, 6.2), layout="constrained"
    )
    series = (
        (voxels, "voxels", {s**3: Case(1024, s) for s in (4, 8, 16, 32, 64, 96)}),
        (elements, "antennas", {n: Case(n, 32) for n in (16, 64, 256, 1024, 4096, 16384)}),
        (samples, "samples", {n: Case(1024, 24, n) for n in (8, 16, 32, 64, 128, 256)}),
    )
    for axes, what, sizes in series:
        for name in (*METHODS, "signal tracer"):
            curve(axes, name, what, sizes, options.repeats)
        axes.set(xlabel=what, ylabel="ns per (antenna, voxel), one thread")
        axes.grid(visible=True, which="major", alpha=0.3)
    voxels.set_title("1,024 antennas, 64 samples", fontsize=9)
    elements.set_title("32³ voxels at 1 mm, 64 samples", fontsize=9)
    samples.set_title("1,024 antennas, 24³ voxels", fontsize=9)
    threads.set_title("dotted: as many times as threads", fontsize=9)
    threads_curve(threads, 4 * options.repeats)
    voxels.legend(fontsize=8)
    figure.suptitle(f"float32, rtol 1e-3, {simd_level()}, {cpu_model()}", fontsize=10)
    figure.savefig(options.out, dpi=110)
    print(f"{options.out}: {options.out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
