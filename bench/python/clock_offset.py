"""Errors of the estimated clock offset between radar and arm.

    python bench/python/clock_offset.py [--n 20] [--noise 1.0]

A serpentine of 20 lines of 200 mm, 1.5 mm apart, at .1 m/s, over 30 random reflectors. Frames every
10 ms with stamps that jitter by 1 ms, noise of `--noise` times the signal in each sample, poses at
100 Hz that jitter by .05 mm. Asked: within .3 ms in 95 % for offsets of 5 to 80 ms.
"""

import argparse

import numpy as np

from geraf2.apps.importers._bag import frame_clock
from geraf2.apps.importers.clock_offset import (
    MAX_OFFSET_S,
    Sweep,
    find_clock_offset,
    straight_lines,
)
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.records import Waveform

WAVEFORM = Waveform(
    start_frequency_hz=77.36e9,
    chirp_slope_hz_per_s=60e12,
    sample_rate_hz=1e6,
    n_samples=64,
    path_bias_m=0.15,
)
N_LINES, WIDTH_M, STEP_M, SPEED_M_PER_S = 20, 0.2, 0.0015, 0.1
PERIOD_S, JITTER_S, POSE_JITTER_M = 0.01, 0.002, 5e-5


def path():
    """Times (n,) [s] and positions (n, 3) [m] at the corners of a serpentine."""
    times, positions = [0.0], [[0.0, -WIDTH_M / 2, -STEP_M * N_LINES / 2]]
    for row in range(N_LINES):
        y = WIDTH_M / 2 if row % 2 == 0 else -WIDTH_M / 2
        z = positions[-1][2]
        times += [times[-1] + t for t in np.cumsum([WIDTH_M / SPEED_M_PER_S, 0.05, 0.07, 0.05])]
        positions += [[0.0, y, z], [0.0, y, z], [0.0, y, z + STEP_M], [0.0, y, z + STEP_M]]
    return np.array(times), np.array(positions)


def one(seed, noise):
    """Offset put in, that found, and its sigma [ms]."""
    rng = np.random.default_rng(seed)
    corners, positions = path()
    targets = rng.uniform((0.3, -0.12, -0.1), (0.5, 0.12, 0.1), (30, 3))
    offset_s = rng.uniform(0.005, 0.08)

    def between(at, table):
        return lambda t: np.stack([np.interp(t, at, table[:, k]) for k in range(3)], axis=1)

    pose_times = np.arange(0.0, corners[-1], 0.01)
    poses = between(corners, positions)(pose_times)
    poses += POSE_JITTER_M * rng.normal(size=poses.shape)
    positions_at = between(pose_times, poses)
    times = np.arange(0.3, corners[-1] - 0.3, PERIOD_S)
    distance = np.linalg.norm(between(corners, positions)(times)[:, None] - targets, axis=2)
    phase = 2 * np.pi / SPEED_OF_LIGHT_M_PER_S * (2 * distance + WAVEFORM.path_bias_m)
    signal = np.exp(1j * phase[..., None] * WAVEFORM.frequencies_hz).sum(axis=1)
    level = noise * np.sqrt(np.mean(np.abs(signal) ** 2) / 2)
    signal += level * (rng.normal(size=(*signal.shape, 2)) @ [1, 1j])
    stamps = times + offset_s + JITTER_S * (rng.uniform(size=len(times)) - 0.5)
    numbers, start_s, period_s = frame_clock(stamps, PERIOD_S, "samples", "bench")
    clock = start_s + period_s * numbers
    sweeps = []
    for begin, end in straight_lines((0.0, float(pose_times[-1])), positions_at):
        near = (clock > begin - MAX_OFFSET_S) & (clock < end + MAX_OFFSET_S)
        sweep = Sweep(interval_s=(begin, end), times_s=clock[near], signal=signal[near, None])
        sweeps.append(sweep)
    found = find_clock_offset(sweeps, positions_at, WAVEFORM.center_wavelength_m)
    return 1e3 * np.array([offset_s, found.offset_s, found.sigma_s])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=20, help="number of offsets")
    parser.add_argument("--noise", type=float, default=1.0, help="over the signal, amplitudes")
    options = parser.parse_args()
    rows = np.array([one(seed, options.noise) for seed in range(options.n)])
    errors = rows[:, 1] - rows[:, 0]
    for (true, found, sigma), error in zip(rows, errors, strict=True):
        print(f"put in {true:6.2f} ms, found {found:6.2f} +- {sigma:.2f}, error {error:+.3f}")
    within = np.mean(np.abs(errors) < 0.3)
    z = np.sqrt(np.mean((errors / rows[:, 2]) ** 2))
    print(f"within .3 ms: {100 * within:.0f} %, largest {np.abs(errors).max():.3f} ms, ", end="")
    print(f"RMS of error over sigma {z:.2f}")


if __name__ == "__main__":
    main()
