"""Throughput and memory of `geraf2 import dca1000` on a made-up recording.

    python bench/python/import_raw.py [--layout 4-lane] [--size-mb 2000] [--folder DIR]

The recording holds three echoes and noise; what is beyond `--filled-mb` is sparse and reads as
zero. `read` is the importer alone, on one thread, from opening the file to the last
sample, from the page cache. `command` is the whole `geraf2 import`, a process of its own from its
start to its end, on all cores: it also checks the samples, finds the sign of the phase and writes
a scene of the same size. Rates are bytes of the recording per second, medians over repeats: of
wall time, for an idle machine, and of processor time. Memory is the largest resident set. A
`--folder` in memory (/dev/shm) leaves the speed of the disk out.
"""

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers._raw_layout import LAYOUTS
from geraf2.apps.importers.dca1000 import Dca1000Importer
from geraf2.io.manifest import RadarManifest, RasterManifest

N_RX, N_SAMPLES = 4, 256
CHIRP_BYTES = 4 * N_RX * N_SAMPLES
PARAMETERS = {
    "start_frequency_hz": 77e9,
    "chirp_slope_hz_per_s": 60e12,
    "sample_rate_hz": 1e7,
    "path_bias_m": 0.15,
}


def write_recording(path: Path, layout: str, size_mb: int, filled_mb: int) -> int:
    """Write the recording; returns its chirps, a multiple of 1024."""
    rng = np.random.default_rng(0)
    n_block = 1024
    t = np.arange(N_SAMPLES) / N_SAMPLES
    phases = rng.uniform(0, 2 * np.pi, (n_block, N_RX, 3, 1))
    waves = np.exp(1j * (2 * np.pi * np.array([[5.3], [9.1], [21.4]]) * t + phases)).sum(axis=2)
    waves += 0.02 * (rng.normal(size=(*waves.shape, 2)) @ [1, 1j])
    parts = np.stack([waves.real, waves.imag], axis=-1) * 800
    axes = {
        "4-lane": (0, 2, 3, 1),
        "iq": (0, 2, 1, 3),
    }
    if layout in axes:
        words = parts.transpose(axes[layout])
    elif layout == "2-lane-pairs":
        words = parts.reshape(n_block, 2, 2, N_SAMPLES, 2).transpose(0, 3, 1, 4, 2)
    else:
        words = parts.reshape(n_block, N_RX, N_SAMPLES // 2, 2, 2).transpose(0, 1, 2, 4, 3)
    block = np.round(words).astype("<i2").tobytes()
    n_blocks = max(1, size_mb * 1_000_000 // len(block))
    with path.open("wb") as handle:
        for _ in range(min(n_blocks, filled_mb * 1_000_000 // len(block))):
            handle.write(block)
        handle.truncate(n_blocks * len(block))
    return n_blocks * n_block


def read(path: Path, n_chirps: int) -> None:
    raster = RasterManifest(
        n_rows=n_chirps // 1024, n_columns=1024, row_step_m=1e-3, column_step_m=1e-3
    )
    radar = RadarManifest(**PARAMETERS, raster=raster)
    scan = Dca1000Importer().open(path, radar, ImportOptions(num_threads=1))
    n_antennas = sum(len(part.signal) for part in scan.poses())
    if n_antennas != n_chirps * N_RX:
        msg = f"read {n_antennas} antennas of {n_chirps * N_RX}"
        raise SystemExit(msg)


def report(name: str, n_bytes: int, runs: list[tuple[float, float]], memory_mib: float) -> None:
    cpu, wall = (statistics.median(run[k] for run in runs) for k in (0, 1))
    print(
        f"{name:<8} {n_bytes / wall / 1e6:6.0f} MB/s of wall time, {n_bytes / cpu / 1e6:6.0f} MB/s "
        f"of CPU time, {wall:.2f} s and {cpu:.2f} s, {memory_mib:.0f} MiB"
    )


def run_command(path: Path, n_chirps: int, folder: Path) -> tuple[float, float]:
    radar = folder / "radar.toml"
    radar.write_text("".join(f"{key} = {value}\n" for key, value in PARAMETERS.items()))
    scene = folder / "scene"
    shutil.rmtree(scene, ignore_errors=True)
    raster = ["--raster", str(n_chirps // 1024), "1024", "1e-3", "1e-3"]
    arguments = ["import", "dca1000", str(path), str(scene), "--radar", str(radar), *raster]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", "from geraf2.cli.main import run; run()", *arguments],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    shutil.rmtree(scene)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, wall


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layout", choices=LAYOUTS, default="4-lane")
    parser.add_argument("--size-mb", type=int, default=2000)
    parser.add_argument("--filled-mb", type=int, default=2000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--folder", type=Path, default=None, help="where to write; a fast disk")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        path = Path(name) / "adc_data.bin"
        n_chirps = write_recording(path, options.layout, options.size_mb, options.filled_mb)
        n_bytes = path.stat().st_size
        print(f"{options.layout}, {n_bytes / 1e6:.0f} MB, {os.cpu_count()} CPUs")
        runs = []
        for _ in range(options.repeats):
            cpu, wall = time.process_time(), time.perf_counter()
            read(path, n_chirps)
            runs.append((time.process_time() - cpu, time.perf_counter() - wall))
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        report("read", n_bytes, runs, memory)
        runs = [run_command(path, n_chirps, Path(name)) for _ in range(options.repeats)]
        memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        report("command", n_bytes, runs, memory)


if __name__ == "__main__":
    main()
