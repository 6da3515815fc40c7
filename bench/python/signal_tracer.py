"""Signal tracer beside the same sum written in torch, forward and backward, in one run.

    python bench/python/signal_tracer.py

One thread, float32, CPU time, medians. torch needs one complex number for each (antenna, point,
sample), so it works on chunks of the points and on a few antennas; its time is proportional to the
pairs.
"""

import argparse
import math
import statistics
import time
from collections.abc import Callable

import torch

from geraf2.ops import signal_tracer, simd_level
from geraf2.scene import Waveform

SPEED_OF_LIGHT = 299792458.0
WAVEFORM = Waveform(
    start_frequency_hz=77.3704e9,
    chirp_slope_hz_per_s=70.15e12,
    sample_rate_hz=1.25e6,
    n_samples=64,
    path_bias_m=0.15,
)


def geometry(n_antennas: int, n_points: int) -> tuple[torch.Tensor, ...]:
    """Points anywhere in a cube of 0.2 m, antennas on a plane 0.36 m from its middle."""
    random = torch.Generator().manual_seed(0)

    def uniform(*shape: int) -> torch.Tensor:
        return 2.0 * torch.rand(shape, generator=random, dtype=torch.float64) - 1.0

    tx = uniform(n_antennas, 3) * torch.tensor([0.0, 0.07, 0.12]) - torch.tensor([0.36, 0.0, 0.0])
    rx = tx + torch.tensor([0.0, 0.005, 0.0])
    return uniform(n_points).float(), 0.1 * uniform(n_points, 3), tx, rx


def torch_tracer(amplitude, points, tx, rx, chunk: int) -> torch.Tensor:  # type: ignore[no-untyped-def]
    """The equation, with the path in float64 as float32 would not hold its phase."""
    time_s = torch.arange(WAVEFORM.n_samples, dtype=torch.float64) / WAVEFORM.sample_rate_hz
    turns_per_m = (
        WAVEFORM.start_frequency_hz + WAVEFORM.chirp_slope_hz_per_s * time_s
    ) / SPEED_OF_LIGHT
    signal = torch.zeros((tx.shape[0], WAVEFORM.n_samples), dtype=torch.complex64)
    for begin in range(0, points.shape[0], chunk):
        part = slice(begin, begin + chunk)
        path = torch.cdist(tx, points[part]) + torch.cdist(rx, points[part])
        turns = (path[..., None] + WAVEFORM.path_bias_m) * turns_per_m
        phase = (-2.0 * math.pi * (turns - turns.round())).float()
        phasor = torch.polar(torch.ones_like(phase), phase)
        signal = signal + (amplitude[part, None] * phasor).sum(dim=1)
    return signal


def cpu_ms(step: Callable[[], None], repeats: int) -> float:
    step()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        step()
        times.append(time.process_time() - start)
    return 1e3 * statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--antennas", type=int, default=512)
    parser.add_argument("--points", type=int, default=25000)
    parser.add_argument("--torch-antennas", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    torch.set_num_threads(1)
    amplitude, points, tx, rx = geometry(options.antennas, options.points)
    amplitude.requires_grad_(True)
    few = slice(0, options.torch_antennas)
    ours = signal_tracer(amplitude, points, tx, rx, WAVEFORM)
    theirs = torch_tracer(amplitude, points, tx[few], rx[few], 2000)
    error = (ours[few] - theirs).norm() / theirs.norm()
    signal_grad = torch.randn_like(ours)
    print(f"{simd_level()}, {options.antennas} antennas x {options.points} points x 64 samples, "
          f"difference {float(error.detach()):.1e}")  # fmt: skip
    scale = options.antennas / options.torch_antennas
    for name, backward in (("forward", False), ("forward + backward", True)):

        def native(backward: bool = backward) -> None:
            signal = signal_tracer(amplitude, points, tx, rx, WAVEFORM)
            if backward:
                signal.backward(signal_grad)

        def peer(backward: bool = backward) -> None:
            signal = torch_tracer(amplitude, points, tx[few], rx[few], 2000)
            if backward:
                signal.backward(signal_grad[few])

        fast = cpu_ms(native, options.repeats)
        slow = scale * cpu_ms(peer, 3)
        print(f"{name:20} {fast:8.1f} ms   torch {slow:9.0f} ms   {slow / fast:6.0f}x")


if __name__ == "__main__":
    main()
