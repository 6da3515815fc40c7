"""Captures of metal spheres and flat walls by geometrical optics: one echo from one point."""

import numpy as np

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.scene import Capture, Pose
from helpers.synthetic import WAVEFORM

STANDOFF_M = 0.4
BOX_M = 0.2


def raster(n_lines=41, spacing_m=0.003):
    """Sideways positions of a square raster, (n_lines^2, 2) [m]."""
    steps = (np.arange(n_lines) - (n_lines - 1) / 2) * spacing_m
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)


def frame(angle_deg):
    """Looking, horizontal and vertical axis of a turntable pose."""
    angle = np.deg2rad(angle_deg)
    outward = np.array([np.cos(angle), np.sin(angle), 0.0])
    return np.stack([-outward, [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def antennas(angle_deg, positions, baseline_m=0.0):
    """Transmitters, receivers and axes of a pose that looks at the origin."""
    axes = frame(angle_deg)
    center = -STANDOFF_M * axes[0] + positions @ axes[1:]
    half = 0.5 * baseline_m * axes[1]
    return center + half, center - half, axes


def signal_of_paths(paths, waveform=WAVEFORM):
    """Sum of unit echoes, paths (n_antennas, n_echoes) [m] -> (n_antennas, n_samples)."""
    turns = -2j * np.pi / SPEED_OF_LIGHT_M_PER_S * (paths + waveform.path_bias_m)
    first, second = waveform.frequencies_hz[:2]
    echoes, step = np.exp(first * turns), np.exp((second - first) * turns)
    samples = np.empty((len(paths), waveform.n_samples), dtype=np.complex64)
    for column in samples.T:
        column[:] = echoes.sum(axis=1)
        echoes *= step
    return samples


def sphere_paths(positions, centers, radii):
    """Two-way path to the point of each sphere whose normal points at the antenna."""
    offset = positions[:, None] - np.asarray(centers, dtype=float)[None]
    return 2.0 * (np.linalg.norm(offset, axis=2) - np.asarray(radii))


def pose_of(angle_deg, positions, paths_of):
    tx, rx, axes = antennas(angle_deg, positions)
    signal = signal_of_paths(paths_of(tx, axes))
    return Pose(signal=signal, tx_positions=tx, rx_positions=rx, axes=axes, name=f"{angle_deg:g}")


def capture_of(paths_of, n_poses=12, positions=None, noise=0.0, seed=0):
    """`paths_of(positions, axes)` -> (n_antennas, n_echoes); noise power relative to one echo."""
    positions = raster() if positions is None else positions
    rng = np.random.default_rng(seed)
    poses = []
    for number in range(n_poses):
        pose = pose_of(360.0 * number / n_poses, positions, paths_of)
        parts = rng.standard_normal((2, *pose.signal.shape))
        added = np.sqrt(0.5 * noise) * (parts[0] + 1j * parts[1])
        signal = (pose.signal + added).astype(np.complex64)
        poses.append(Pose(**{**vars(pose), "signal": signal}))
    return Capture(waveform=WAVEFORM, poses=tuple(poses))


def sphere_capture(centers, radii, **options):
    return capture_of(lambda positions, _: sphere_paths(positions, centers, radii), **options)


def fibonacci_sphere(n):
    """Evenly spread unit vectors, (n, 3)."""
    height = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(n)
    ring = np.sqrt(1.0 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
