"""Heat map of facets beside plain NumPy loops, in one run.

    python bench/python/facet_echo.py

One thread, CPU time, medians of repeats; sizes are those of a window of an inspection. The naive
loop takes every 20th antenna, and its time is scaled up.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.ops import MatchedFilterPlan, signal_tracer, simd_level
from geraf2.records import Waveform

WAVEFORM = Waveform(
    start_frequency_hz=77.4e9,
    chirp_slope_hz_per_s=70.15e12,
    sample_rate_hz=5e6,
    n_samples=32,
    path_bias_m=0.0,
)
EVERY = 20


def naive_echo(
    amplitudes: np.ndarray, points: np.ndarray, antennas: np.ndarray, targets: np.ndarray
) -> np.ndarray:
    """Antenna after antenna: phasors of facets, of targets, and what they make."""
    k = 2.0 * np.pi * WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    image = np.zeros(len(targets), dtype=complex)
    for antenna in antennas:
        there = 2.0 * np.linalg.norm(points - antenna, axis=1)
        signal = np.exp(-1j * k[:, None] * there) @ amplitudes
        back = 2.0 * np.linalg.norm(targets - antenna, axis=1)
        image += np.exp(1j * back[:, None] * k) @ signal
    return image / len(antennas)


def echo_from(antennas: np.ndarray, targets: np.ndarray) -> Callable[..., np.ndarray]:
    """Heat map of amplitudes at points: signals are traced, then matched at the targets."""
    plan = MatchedFilterPlan(antennas, antennas, targets, WAVEFORM, method="exact", num_threads=1)
    return lambda amplitudes, points: plan.execute(
        signal_tracer(
            amplitudes.astype(np.float32), points, antennas, antennas, WAVEFORM, num_threads=1
        )
    )


def milliseconds(work: Callable[[], object], n_repeats: int) -> float:
    times = []
    for _ in range(n_repeats):
        start = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15)
    n_repeats = parser.parse_args().repeats
    rng = np.random.default_rng(0)
    antennas = np.array([0.4, 0.0, 0.0]) + rng.uniform(-0.1, 0.1, (200, 3)) * [0.0, 1.0, 1.0]
    normals = rng.standard_normal((4000, 3))
    points = 0.05 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    targets = rng.uniform(-0.08, 0.08, (560, 3))
    amplitudes = rng.uniform(0.5, 1.0, len(points))
    echo = echo_from(antennas, targets)

    few = antennas[::EVERY]
    part = echo_from(few, targets)(amplitudes, points)
    expected = naive_echo(amplitudes, points, few, targets)
    error = np.linalg.norm(part - expected) / np.linalg.norm(expected)
    naive_ms = EVERY * milliseconds(lambda: naive_echo(amplitudes, points, few, targets), 3)
    print(f"{len(antennas)} antennas, {len(points)} facets, {len(targets)} targets, {simd_level()}")
    print(f"{'':10}     ms   naive ms   ratio")
    took_ms = milliseconds(lambda: echo(amplitudes, points), n_repeats)
    print(f"{'image':10} {took_ms:6.2f} {naive_ms:10.0f} {naive_ms / took_ms:7.0f}")
    print(f"image off that of the loop by {error:.1e} of its norm")


if __name__ == "__main__":
    main()
