"""Kernels beside the same sums written in NumPy and in torch, in one run.

    python bench/python/peers.py [--check]

One thread, single precision, CPU time, medians. The peers need one complex number for each
(antenna, point, sample), so they work on fewer antennas and points; their time is proportional to
the pairs. Paths are float64 in both, as float32 would not hold the phase. `--check` fails where the
signal tracer is less than 500 times as fast as torch, forward or forward with backward.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.ops import matched_filter, signal_tracer, simd_level
from geraf2.scene import Grid, Waveform

WAVEFORM = Waveform(
    start_frequency_hz=77.3704e9,
    chirp_slope_hz_per_s=70.15e12,
    sample_rate_hz=1.25e6,
    n_samples=64,
    path_bias_m=0.15,
)
MIN_TRACER_RATIO = 500.0
"""To torch autograd."""
CHUNK = 2000
"""Points whose phasors a peer holds at a time: some 30 MB for 4 antennas."""


def geometry(n_antennas: int, n_points: int) -> tuple[torch.Tensor, ...]:
    """Points anywhere in a cube of 0.2 m, antennas on a plane 0.36 m from its middle."""
    random = torch.Generator().manual_seed(0)

    def uniform(*shape: int) -> torch.Tensor:
        return 2.0 * torch.rand(shape, generator=random, dtype=torch.float64) - 1.0

    tx = uniform(n_antennas, 3) * torch.tensor([0.0, 0.07, 0.12]) - torch.tensor([0.36, 0.0, 0.0])
    rx = tx + torch.tensor([0.0, 0.005, 0.0])
    return uniform(n_points).float(), 0.1 * uniform(n_points, 3), tx, rx


def numpy_phasors(tx, rx, points) -> NDArray[np.complex64]:  # type: ignore[no-untyped-def]
    """exp(j 2 pi f d / c), (n_antennas, n_points, n_samples)."""
    path = sum(np.linalg.norm(a[:, None] - points, axis=2) for a in (tx, rx))
    turns = (path + WAVEFORM.path_bias_m)[..., None] * (
        WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    )
    phase = (2.0 * np.pi * (turns - np.round(turns))).astype(np.float32)
    return np.cos(phase) + 1j * np.sin(phase)


def torch_phasors(tx, rx, points) -> torch.Tensor:  # type: ignore[no-untyped-def]
    path = torch.cdist(tx, points) + torch.cdist(rx, points) + WAVEFORM.path_bias_m
    turns = path[..., None] * (torch.from_numpy(WAVEFORM.frequencies_hz) / SPEED_OF_LIGHT_M_PER_S)
    phase = (2.0 * torch.pi * (turns - turns.round())).float()
    return torch.polar(torch.ones_like(phase), phase)


def torch_tracer(amplitude, points, tx, rx) -> torch.Tensor:  # type: ignore[no-untyped-def]
    """The equation, differentiable to the amplitude."""
    signal = torch.zeros((tx.shape[0], WAVEFORM.n_samples), dtype=torch.complex64)
    for begin in range(0, points.shape[0], CHUNK):
        part = slice(begin, begin + CHUNK)
        phasor = torch_phasors(tx, rx, points[part]).conj()
        signal = signal + (amplitude[part, None] * phasor).sum(dim=1)
    return signal


def cpu_ms(steps: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Medians, all steps by turns, so that a neighbour on the same machine disturbs them alike."""
    times: list[list[float]] = [[] for _ in steps]
    for repeat in range(repeats + 1):
        for step, of_step in zip(steps, times, strict=True):
            start = time.process_time()
            step()
            if repeat > 0:
                of_step.append(time.process_time() - start)
    return [1e3 * statistics.median(of_step) for of_step in times]


def in_chunks(part: Callable[[slice], object], n_points: int) -> list[object]:
    return [part(slice(begin, begin + CHUNK)) for begin in range(0, n_points, CHUNK)]


def per_pair(step: Callable[[], object], n_pairs: int, repeats: int) -> float:
    """Median CPU time in nanoseconds."""
    return 1e6 * cpu_ms([step], repeats)[0] / n_pairs


def compare_matched_filter(repeats: int) -> None:
    _, _, tx, rx = geometry(512, 1)
    grid = Grid.cube((0.0, 0.0, 0.0), 0.0175, 36)
    points = torch.from_numpy(grid.points())
    random = torch.Generator().manual_seed(1)
    signal = torch.randn((512, WAVEFORM.n_samples), generator=random, dtype=torch.complex64)
    few, some = slice(0, 4), slice(0, 6000)

    def numpy_image() -> NDArray[np.complex64]:
        a, b, x, s = (v.numpy() for v in (tx[few], rx[few], points[some], signal[few]))
        return np.concatenate(
            in_chunks(lambda p: np.einsum("at,avt->v", s, numpy_phasors(a, b, x[p])) / 4, 6000)
        )

    def torch_image() -> torch.Tensor:
        x = points[some]
        return torch.cat(
            in_chunks(
                lambda p: (
                    torch.einsum("at,avt->v", signal[few], torch_phasors(tx[few], rx[few], x[p]))
                    / 4
                ),
                6000,
            )
        )

    n_few = 4 * 6000
    peers = {
        "NumPy": per_pair(numpy_image, n_few, 3),
        "torch": per_pair(torch_image, n_few, 3),
    }
    want = torch_image()
    print("matched filter, 512 antennas x 36^3 voxels at 1 mm x 64 samples, ns per pair")
    for name, ns in peers.items():
        print(f"  {name:22} {ns:9.2f}")
    for method, rtol in (("exact", 1e-3), ("block", 1e-3), ("block", 1e-4)):
        options = {"method": method, "rtol": rtol, "num_threads": 1}
        ns = per_pair(
            lambda o=options: matched_filter(signal, tx, rx, grid, WAVEFORM, **o),
            512 * grid.n_voxels,
            repeats,
        )
        got = matched_filter(signal[few], tx[few], rx[few], points[some], WAVEFORM, **options)
        error = float((got - want).norm() / want.norm())
        ratios = ", ".join(f"{peer / ns:.0f}x {name}" for name, peer in peers.items())
        print(f"  {method + f' {rtol:.0e}':22} {ns:9.3f}   {ratios}, difference {error:.1e}")


def compare_signal_tracer(repeats: int) -> bool:
    n_antennas, n_points, few = 512, 25000, slice(0, 4)
    amplitude, points, tx, rx = geometry(n_antennas, n_points)
    amplitude.requires_grad_(True)
    signal_grad = torch.randn((n_antennas, WAVEFORM.n_samples), dtype=torch.complex64)

    def native(backward: bool) -> None:
        signal = signal_tracer(amplitude, points, tx, rx, WAVEFORM, num_threads=1)
        if backward:
            signal.backward(signal_grad)

    def autograd(backward: bool) -> None:
        signal = torch_tracer(amplitude, points, tx[few], rx[few])
        if backward:
            signal.backward(signal_grad[few])

    def numpy_signal() -> object:
        a, b, x = (v.numpy() for v in (tx[few], rx[few], points))
        weight = amplitude.detach().numpy()
        parts = in_chunks(
            lambda p: np.einsum("v,avt->at", weight[p], numpy_phasors(a, b, x[p]).conj()), n_points
        )
        return sum(parts)  # type: ignore[call-overload]

    with torch.no_grad():
        want = torch_tracer(amplitude, points, tx[few], rx[few])
        got = signal_tracer(amplitude, points, tx[few], rx[few], WAVEFORM, num_threads=1)
    error = float((got - want).norm() / want.norm())
    print(
        "signal tracer, 25,000 points x 512 antennas x 64 samples, ns per pair, "
        f"difference {error:.1e}"
    )
    pairs, few_pairs = n_antennas * n_points, 4 * n_points
    print(f"  {'NumPy forward':22} {per_pair(numpy_signal, few_pairs, 3):9.2f}")
    reached = True
    for name, backward in (("forward", False), ("forward + backward", True)):
        times = cpu_ms([lambda b=backward: autograd(b), lambda b=backward: native(b)], repeats)
        slow, fast = 1e6 * times[0] / few_pairs, 1e6 * times[1] / pairs
        good = slow / fast >= MIN_TRACER_RATIO
        reached = reached and good
        print(f"  {'torch ' + name:22} {slow:9.2f}")
        print(
            f"  {name:22} {fast:9.3f}   {fast * pairs * 1e-6:.1f} ms, {slow / fast:.0f}x torch "
            f"(at least {MIN_TRACER_RATIO:.0f}): {'reached' if good else 'MISSED'}"
        )
    return reached


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"kernels use {simd_level()}, one thread, CPU time")
    compare_matched_filter(options.repeats)
    reached = compare_signal_tracer(options.repeats)
    return 0 if reached or not options.check else 1


if __name__ == "__main__":
    sys.exit(main())
