from dataclasses import replace

import numpy as np
import pytest

from geraf2.scene.checks import check_capture
from geraf2.scene.summary import summarize_capture, summarize_in_parts, summarize_pose
from helpers.synthetic import WAVEFORM, point_capture, point_pose


def test_the_poses_of_a_turntable_look_at_its_axis():
    summary = summarize_capture(point_capture(6))
    assert summary.focus == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert summary.standoff_m == pytest.approx(0.4)
    assert summary.aperture_m == pytest.approx((0.03, 0.03))
    assert summary.spacing_m == pytest.approx(0.006)


def test_a_single_plane_looks_at_its_strongest_echo():
    summary = summarize_capture(
        replace(point_capture(), poses=(point_pose(0.0, targets=np.zeros((1, 3))),))
    )
    # To half a range cell.
    assert np.abs(summary.focus).max() < 0.5 * WAVEFORM.range_cell_m
    assert summary.echo_range_m(summary.poses[0]) == pytest.approx(0.4, abs=0.021)


@pytest.mark.parametrize("size", [36, 7])
def test_a_capture_in_parts_has_the_same_numbers(size):
    capture = point_capture(2)
    capture.poses[1].signal[3] = 1.0
    parts = [
        pose.select(slice(first, first + size))
        for pose in capture.poses
        for first in range(0, 36, size)
    ]
    got = summarize_in_parts(parts, [36, 36], capture.waveform)
    want = summarize_capture(capture)
    assert got.focus == pytest.approx(want.focus, abs=1e-9)
    assert got.aperture_m == pytest.approx(want.aperture_m)
    for one, other in zip(got.poses, want.poses, strict=True):
        assert (one.n_antennas, one.n_constant) == (other.n_antennas, other.n_constant)
        assert one.rms == pytest.approx(other.rms)
        assert one.profile == pytest.approx(other.profile, rel=1e-5)
        assert one.center == pytest.approx(other.center)
        assert one.spacings_m == pytest.approx(other.spacings_m)
        assert one.largest == other.largest


def test_several_receivers_at_one_transmitter_count_as_positions_of_their_own():
    pose = point_pose(0.0)
    twice = replace(
        pose,
        signal=np.concatenate([pose.signal, pose.signal]),
        tx_positions=np.concatenate([pose.tx_positions, pose.tx_positions]),
        rx_positions=np.concatenate([pose.rx_positions, pose.rx_positions + 0.002]),
    )
    summary = summarize_pose(twice)
    assert summary.n_repeated_positions == 0
    assert summary.spacings_m[0] < 0.003
    assert summarize_pose(pose).n_repeated_positions == 0
    repeated = replace(twice, rx_positions=np.concatenate([pose.rx_positions, pose.rx_positions]))
    assert summarize_pose(repeated).n_repeated_positions == 36


@pytest.mark.parametrize("degrees", [0.0, 30.0])
def test_rows_far_apart_count_and_not_the_antennas_in_them(degrees):
    capture, turn = point_capture(2), np.deg2rad(degrees)
    random = np.random.default_rng(0)
    y, z = np.meshgrid(0.00095 * np.arange(120), 0.006 * np.arange(12))
    raster = np.stack([y.ravel(), z.ravel()], axis=1) + 2e-5 * random.normal(size=(1440, 2))
    raster = raster @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    poses = []
    for pose in capture.poses:
        antennas = pose.phase_centers.mean(axis=0) + raster @ pose.axes[1:]
        signal = np.ones((1440, 32), dtype=np.complex64)
        poses.append(replace(pose, signal=signal, tx_positions=antennas, rx_positions=antennas))
    summary = summarize_capture(replace(capture, poses=tuple(poses)))
    assert summary.spacings_m == pytest.approx([0.00095, 0.006], rel=0.05)
    assert summary.spacing_m == summary.spacings_m[1]
    assert summary.is_coarse


def test_values_that_are_not_finite_are_counted_and_left_out():
    pose = point_pose(0.0)
    signal, tx = pose.signal.copy(), pose.tx_positions.copy()
    signal[0, :3] = np.nan
    tx[5, 1] = np.inf
    summary = summarize_pose(replace(pose, signal=signal, tx_positions=tx))
    assert (summary.n_bad_samples, summary.n_bad_positions) == (3, 1)
    assert np.isfinite(summary.center).all()
    assert np.isfinite(summary.rms)


def test_a_plane_with_depth_is_mentioned():
    capture = point_capture(4)
    swapped = tuple(replace(pose, axes=np.roll(pose.axes, 1, axis=0)) for pose in capture.poses)
    messages = [str(f) for f in check_capture(summarize_capture(replace(capture, poses=swapped)))]
    assert any("along their looking axis" in message for message in messages)


def test_samples_of_double_precision_have_the_same_numbers():
    pose = point_pose(0.0)
    single = summarize_pose(pose)
    double = summarize_pose(replace(pose, signal=pose.signal.astype(np.complex128)))
    assert double.largest == pytest.approx(single.largest)
    assert double.saturated_fraction == pytest.approx(single.saturated_fraction)
    assert double.rms == pytest.approx(single.rms)
