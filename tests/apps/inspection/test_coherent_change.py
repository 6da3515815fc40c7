"""Coherent change of two scans: formulas against loops, and scans of points that are made up."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.apps.inspection.coherent_change import (
    Signals,
    compare_echoes,
    refine_turn,
)
from geraf2.apps.inspection.workers import Workers
from geraf2.geometry.transforms import apply_rigid, inverse_rigid, rigid
from geraf2.ops import signal_tracer
from geraf2.records import Pose, Waveform
from geraf2.scene import Capture

WAVEFORM = Waveform(
    start_frequency_hz=77.4e9, chirp_slope_hz_per_s=70e12, sample_rate_hz=625e3, n_samples=16
)
PUT_DOWN = rigid(
    Rotation.from_euler("xyz", [0.3, -0.2, 1.2], degrees=True).as_matrix(),
    np.array([0.002, -0.003, 0.0005]),
)


def noise(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def scan(points, amplitudes, seed):
    """Scan of points from four sides, with unknown phases that drift along each plane."""
    rng, poses = np.random.default_rng(seed), []
    line = 0.005 * (np.arange(26) - 12.5)
    flat = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    for angle in (0.0, 1.0, 2.2, 4.0):
        ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
        axes = np.stack([-ahead, [ahead[1], -ahead[0], 0.0], [0.0, 0.0, 1.0]])
        antennas = 0.3 * ahead + flat @ axes[1:]
        signal = signal_tracer(amplitudes, points, antennas, antennas, WAVEFORM, num_threads=1)
        screen = np.exp(1j * (rng.uniform(0.0, 6.28) + flat @ rng.normal(scale=10.0, size=2)))
        signal = (signal * screen[:, None] + noise(rng, *signal.shape)).astype(np.complex64)
        poses.append(Pose(signal=signal, tx_positions=antennas, rx_positions=antennas, axes=axes))
    plane_middles = np.array([pose.phase_centers.mean(axis=0) for pose in poses])
    return Signals(Capture(waveform=WAVEFORM, poses=tuple(poses)), plane_middles, None)


def amplified(scan, gain):
    """Scan by a radar with another gain."""
    poses = tuple(replace(p, signal=gain * p.signal) for p in scan.capture.poses)
    return scan._replace(capture=replace(scan.capture, poses=poses))


@pytest.fixture(scope="module")
def scans():
    """Points, a scan, one of all of them put down elsewhere, and one without the first."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.04, 0.04, size=(60, 3))
    amplitudes = np.exp(2j * np.pi * rng.uniform(size=60)).astype(np.complex64)
    there = apply_rigid(PUT_DOWN, points)
    return (
        points,
        scan(points, amplitudes, 1),
        scan(there, amplitudes, 2),
        scan(there[1:], amplitudes[1:], 3),
    )


def test_the_turn_is_found_by_the_phases_and_unchanged_echoes_are_no_change(scans):
    points, here, again, _ = scans
    peaks, start = (points, apply_rigid(PUT_DOWN, points)), PUT_DOWN.copy()
    start[:3, :3] = Rotation.from_euler("z", -0.9, degrees=True).as_matrix() @ start[:3, :3]
    with Workers(1) as workers:
        pose = refine_turn(start, here, again, peaks, workers)
        spots = compare_echoes(pose, here, again, peaks, workers)
        louder = compare_echoes(pose, here, amplified(again, 1.7), peaks, workers)
    error = Rotation.from_matrix(pose[:3, :3] @ PUT_DOWN[:3, :3].T).magnitude()
    assert np.rad2deg(error) < 0.15
    assert spots.log_ratios.max() < 2.0
    assert louder.log_ratios == pytest.approx(spots.log_ratios, abs=0.2)


def test_an_echo_that_one_scan_lacks_is_found_where_it_was(scans):
    points, here, _, robbed = scans
    peaks = points, apply_rigid(PUT_DOWN, points)
    with Workers(1) as workers:
        new = compare_echoes(PUT_DOWN, here, robbed, peaks, workers)
        back = inverse_rigid(PUT_DOWN[:3, :3], PUT_DOWN[:3, 3])
        gone = compare_echoes(back, robbed, here, peaks[::-1], workers)
    for spots, at, sign in ((new, points[0], 1.0), (gone, peaks[1][0], -1.0)):
        best = np.argmax(spots.log_ratios)
        assert spots.points[best] == pytest.approx(at, abs=1e-9)
        assert spots.log_ratios[best] > 8.0
        assert np.sign(spots.gains[best]) == sign
    far = np.linalg.norm(new.points - points[0], axis=1) > 0.02
    assert new.log_ratios[far].max() < new.log_ratios.max() - 5.0


def test_planes_that_stand_elsewhere_say_nothing(scans):
    points, here, again, _ = scans
    away = again._replace(
        plane_middles=again.plane_middles[::2],
        capture=Capture(waveform=WAVEFORM, poses=again.capture.poses[::2]),
    )
    aside = here._replace(
        plane_middles=here.plane_middles[1:2],
        capture=Capture(waveform=WAVEFORM, poses=here.capture.poses[1:2]),
    )
    peaks = points, apply_rigid(PUT_DOWN, points)
    with Workers(1) as workers:
        assert refine_turn(PUT_DOWN, aside, away, peaks, workers) == pytest.approx(PUT_DOWN)
        spots = compare_echoes(PUT_DOWN, aside, away, peaks, workers)
        none = compare_echoes(PUT_DOWN, here, again, (points[:0], points[:0]), workers)
    assert not spots.log_ratios.any()
    assert len(none.points) == 0
