"""Images of transmitters and receivers decimetres apart, against where the reflectors are."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.imaging.bistatic import common_half_baseline, seen_from_midpoints
from geraf2.imaging.peaks import collect_peaks
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.records import Pose
from geraf2.scene import Capture, LosPrior
from helpers.synthetic import WAVEFORM

AXES = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TARGET = np.array([0.04, 0.02, 0.06])


def plane(half):
    """Plane of antennas at y = 0.35 m, with the samples of one point, from their definition."""
    x, z = np.meshgrid(0.004 * np.arange(-12, 13), 0.004 * np.arange(-12, 13), indexing="ij")
    centers = np.stack([x.ravel(), np.full(x.size, 0.35), z.ravel()], axis=1)
    tx, rx = centers + half, centers - half
    path = np.linalg.norm(tx - TARGET, axis=1) + np.linalg.norm(rx - TARGET, axis=1)
    turns = (path + WAVEFORM.path_bias_m)[:, None] * WAVEFORM.frequencies_hz
    signal = np.exp(-2j * np.pi * turns / SPEED_OF_LIGHT_M_PER_S).astype(np.complex64)
    return Pose(signal=signal, tx_positions=tx, rx_positions=rx, axes=AXES)


@pytest.mark.parametrize("half", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.08, 0.0, 0.06)])
def test_a_point_is_seen_where_it_is(half):
    capture = Capture(waveform=WAVEFORM, poses=(plane(np.array(half)),))
    peaks = collect_peaks(capture, LosPrior.from_box((0.2, 0.2, 0.2)), SubapertureConfig(), 20.0)
    strong = peaks.select(peaks.levels_db > -1.0)
    assert len(strong) >= 4
    # Range to a twentieth of its cell, direction to a tenth of the resolution at 0.35 m.
    assert np.linalg.norm(strong.points - TARGET, axis=1).max() < 2.5e-3
    along = strong.points - TARGET
    assert np.abs(np.einsum("ni,ni->n", along, strong.directions)).max() < 5e-4


def test_a_reflector_is_found_from_its_half_path_and_slope():
    rng = np.random.default_rng(0)
    centers = np.array([[0.0, 0.35, 0.0]]) + rng.uniform(-0.05, 0.05, (20, 3)) * [1.0, 0.0, 1.0]
    points = rng.uniform(-0.1, 0.1, (20, 3))
    focus, half = centers - [0.0, 0.35, 0.0], np.array([0.05, 0.0, 0.12])

    def half_path(c, p):
        return 0.5 * (np.linalg.norm(p - c - half, axis=1) + np.linalg.norm(p - c + half, axis=1))

    def slope(c, p):
        steps = 1e-6 * AXES[1:]
        return np.stack([(half_path(c - s, p) - half_path(c + s, p)) / 2e-6 for s in steps], 1)

    ranges = half_path(centers, points) - half_path(centers, focus) + 0.35
    cosines = slope(centers, points) - slope(centers, focus)
    directions = np.column_stack([np.sqrt(1.0 - (cosines**2).sum(axis=1)), cosines]) @ AXES
    found, toward = seen_from_midpoints(ranges, directions, centers, focus, half, AXES)
    assert centers + found[:, None] * toward == pytest.approx(points, abs=1e-5)


def test_only_a_long_common_baseline_counts():
    def found(pose):
        return common_half_baseline(pose.tx_positions, pose.rx_positions)

    pose = plane(np.array([0.0, 0.0, 0.1]))
    assert found(pose) == pytest.approx([0.0, 0.0, 0.1])
    assert found(plane(np.array([0.0, 0.0, 0.0025]))) is None
    mixed = replace(pose, tx_positions=pose.tx_positions + np.arange(625)[:, None] * 1e-5)
    assert found(mixed) is None
