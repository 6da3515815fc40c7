"""Captures of a carton with spheres inside, by geometrical optics: walls answer along normals."""

from dataclasses import replace

import numpy as np

from geraf2.calibration.wall_alignment import GROUPS, AlignmentConfig, WallProblem
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Capture, LosPrior, Pose, Wall
from helpers.specular import antennas, raster
from helpers.synthetic import WAVEFORM

SIDE_M = 0.2
# Its two faces lie on each other: the echo comes from the prior's surface.
THIN = Wall(size_m=(SIDE_M, SIDE_M, SIDE_M), thickness_m=1e-6, permittivity=1.0)
PRIOR = LosPrior.from_box((SIDE_M, SIDE_M, SIDE_M), walls=(THIN,))
SPHERES = (np.array([[0.02, 0.01, 0.02], [-0.025, 0.0, -0.03]]), np.array([0.03, 0.02]))


def aligned(capture, prior, config=None):
    """Estimate of all unknowns together, without a judgement."""
    problem = WallProblem(capture, prior, config or AlignmentConfig(), KeptPeaks(prior))
    return problem.result(problem.fit(GROUPS))


def flat(axis, side, position):
    return 0.0


def bulged(height_m):
    """All walls outward by this at their middles; an echo's range to first order."""

    def shape(axis, side, position):
        x, y = (position[:, [k for k in range(3) if k != axis]] / (0.5 * SIDE_M)).T
        return -height_m * np.clip(1.0 - x * x, 0.0, 1.0) * np.clip(1.0 - y * y, 0.0, 1.0)

    return shape


def carton_signal(tx, rx, waveform=WAVEFORM, wall=1.0, far=0.5, bulge=flat, noise=0.01):
    """Echoes of the walls whose foot lies on them, and of both spheres, (n, n_samples)."""
    position = 0.5 * (tx + rx)
    paths, weights = [], []
    for axis in range(2):
        for side in (-1.0, 1.0):
            height = side * position[:, axis] - 0.5 * SIDE_M + bulge(axis, side, position)
            others = [other for other in range(3) if other != axis]
            meets = (np.abs(position[:, others]) < 0.5 * SIDE_M).all(axis=1)
            paths.append(2.0 * np.abs(height))
            # From outside, and from behind, through the box.
            weights.append(wall * meets * ((height > 0) + far * (height < -SIDE_M)))
    for center, radius in zip(*SPHERES, strict=True):
        paths.append(2.0 * (np.linalg.norm(position - center, axis=1) - radius))
        weights.append(np.full(len(position), 0.7))
    total = np.stack(paths, axis=1) + waveform.path_bias_m
    phase = 2.0 * np.pi / SPEED_OF_LIGHT_M_PER_S * total[..., None] * waveform.frequencies_hz
    signal = (np.stack(weights, axis=1)[..., None] * np.exp(-1j * phase)).sum(axis=1)
    rng = np.random.default_rng(len(position))
    parts = rng.standard_normal((2, *signal.shape))
    return (signal + noise * (parts[0] + 1j * parts[1])).astype(np.complex64)


def carton_capture(n_poses=12, errors=None, **options):
    """`errors(number, axes, n)` -> true minus recorded position of each antenna, (n, 3) [m]."""
    poses = []
    for number in range(n_poses):
        tx, rx, axes = antennas(360.0 * number / n_poses, raster(37, 0.0035))
        shift = 0.0 if errors is None else errors(number, axes, len(tx))
        poses.append(
            Pose(
                signal=carton_signal(tx + shift, rx + shift, **options),
                tx_positions=tx,
                rx_positions=rx,
                axes=axes,
                name=str(number),
            )
        )
    return Capture(waveform=WAVEFORM, poses=tuple(poses), walls=(THIN,))


def with_bias(capture, path_bias_m):
    return replace(capture, waveform=replace(capture.waveform, path_bias_m=path_bias_m))
