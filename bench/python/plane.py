"""Image one plane of the published size: 142 x 512 antennas, 300 x 300 x 350 voxels at 1 mm.

    python bench/python/plane.py [--threads 2] [--rtol 1e-3] [--method auto]

White noise of 64 samples at 77 GHz; antennas 1 mm x 0.5 mm apart, 0.36 m from the volume's middle.
Prints the method and why, wall and CPU time of the image, the process' peak memory, and the error
relative to the norm against the float64 direct sum, on voxels drawn at random.
"""

import argparse
import json
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geraf2.ops import explain_method, matched_filter, simd_level
from geraf2.scene import Grid, Waveform

STANDOFF_M = 0.36
GRID = Grid(origin_m=(-0.1495, -0.1495, -0.1745), spacing_m=0.001, shape=(300, 300, 350))
WAVEFORM = Waveform(
    start_frequency_hz=77.3704e9,
    chirp_slope_hz_per_s=70.15e12,
    sample_rate_hz=1.25e6,
    n_samples=64,
    path_bias_m=0.15,
)


def antennas() -> NDArray[np.float64]:
    """Positions, (72704, 3) [m]; transmitter and receiver coincide."""
    y = 1e-3 * (np.arange(142) - 70.5)
    z = 0.5e-3 * (np.arange(512) - 255.5)
    mesh = np.meshgrid([-STANDOFF_M], y, z, indexing="ij")
    return np.stack([m.ravel() for m in mesh], axis=1)


def error_of(
    image: NDArray[np.complex64], signal: NDArray[np.complex64], places: NDArray[np.float64]
) -> float:
    """Error on 150 voxels, relative to their norm."""
    rng = np.random.default_rng(1)
    index = tuple(rng.integers(0, n, 150) for n in GRID.shape)
    points = np.stack([axis[i] for axis, i in zip(GRID.axes_m, index, strict=True)], axis=1)
    want = matched_filter(
        signal.astype(np.complex128), places, places, points, WAVEFORM, method="exact"
    )
    return float(np.linalg.norm(image[index] - want) / np.linalg.norm(want))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Times, memory and error of one image."""
    places = antennas()
    rng = np.random.default_rng(0)
    shape = (len(places), WAVEFORM.n_samples)
    signal = np.empty(shape, np.complex64)
    signal.real = rng.standard_normal(shape, np.float32)
    signal.imag = rng.standard_normal(shape, np.float32)
    print(explain_method(places, places, GRID, WAVEFORM, rtol=options.rtol).reason)
    wall, cpu = time.perf_counter(), time.process_time()
    image = matched_filter(
        signal,
        places,
        places,
        GRID,
        WAVEFORM,
        method=options.method,
        rtol=options.rtol,
        num_threads=options.threads,
    )
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {
        "simd": simd_level(),
        "threads": options.threads,
        "wall_s": wall,
        "cpu_s": cpu,
        "ns_per_pair": 1e9 * cpu / (len(places) * GRID.n_voxels),
        "peak_memory_bytes": peak,
        "rel_error": error_of(image, signal, places),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rtol", type=float, default=1e-3)
    parser.add_argument("--method", default="auto")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    options = parser.parse_args()
    found = measure(options)
    print(
        f"{found['simd']}, {found['threads']} threads: {found['wall_s']:.1f} s wall, "
        f"{found['cpu_s']:.1f} s CPU, {found['ns_per_pair']:.4f} ns of CPU a pair\n"
        f"peak memory {found['peak_memory_bytes'] / 2**30:.2f} GiB, "
        f"relative error {found['rel_error']:.1e}"
    )
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
