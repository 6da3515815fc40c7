"""The common collection of peaks, against the twin and against images of corrected captures."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.imaging.peaks import KeptPeaks, collect_peaks, grating_lobes
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import LosPrior
from helpers.carton import PRIOR, carton_capture, with_bias
from helpers.specular import antennas, raster
from helpers.synthetic import WAVEFORM, point_capture

BOX = LosPrior.from_box((0.12,) * 3)
TARGETS = np.array([[0.03, 0.01, 0.0], [-0.03, 0.0, 0.02]])


@pytest.fixture(scope="module")
def points():
    return point_capture(2, n_side=32, spacing_m=0.003, targets=TARGETS)


@pytest.fixture(scope="module")
def carton():
    return carton_capture(n_poses=3)


@pytest.fixture(scope="module")
def peaks(carton):
    return KeptPeaks(PRIOR).of(carton)


def test_peaks_are_lines_of_sight_to_reflectors(points):
    found = collect_peaks(points, BOX, SubapertureConfig(), 12.0)
    strong = found.select(found.levels_db > -1.0)
    off = np.linalg.norm(strong.points[:, None] - TARGETS, axis=2).min(axis=1)
    assert set(strong.planes) == {0, 1}
    assert off.max() < 0.004
    np.testing.assert_allclose(np.linalg.norm(found.directions, axis=1), 1.0)


def nearest_of_sub_aperture(first, second):
    """Strong peaks of the first, and the peak of the same sub-aperture nearest to each."""
    strong = first.select(first.levels_db > -6.0)
    chosen = [
        min(
            np.flatnonzero(second.subapertures == number),
            key=lambda other: np.linalg.norm(second.points[other] - point),
        )
        for number, point in zip(strong.subapertures, strong.points, strict=True)
    ]
    return strong, second.select(np.array(chosen))


def moved(capture):
    turn, poses = Rotation.from_rotvec([0.0, 0.0, 0.002]).as_matrix(), []
    for pose in capture.poses:
        shift = 0.002 * pose.axes[0] + 0.001 * pose.axes[1]
        tx, rx = ((places + shift) @ turn.T for places in (pose.tx_positions, pose.rx_positions))
        axes = pose.axes @ turn.T
        poses.append(replace(pose, tx_positions=tx, rx_positions=rx, axes=axes))
    return replace(capture, poses=tuple(poses))


@pytest.mark.parametrize("change", [lambda c: with_bias(c, 0.146), moved])
def test_corrected_peaks_equal_those_of_corrected_images(carton, change):
    """A common delay or a plane that moves as a whole: to .15 mm of range and 1.5 mrad."""
    kept = KeptPeaks(PRIOR)
    kept.of(carton)
    corrected = change(carton)
    found, imaged = kept.of(corrected), KeptPeaks(PRIOR).of(corrected)
    assert kept.n_imaged == 3
    np.testing.assert_allclose(found.subaperture_centers, imaged.subaperture_centers, atol=1e-9)
    for pair in ((found, imaged), (imaged, found)):  # none is lost, and none is new
        one, other = nearest_of_sub_aperture(*pair)
        assert len(one) > 100
        range_error = np.abs(one.ranges_m - other.ranges_m)
        turned = np.linalg.norm(one.directions - other.directions, axis=1)
        assert np.quantile(range_error, 0.95) < 1.5e-4
        assert np.quantile(turned, 0.95) < 1.5e-3


def test_a_plane_is_imaged_again_only_if_samples_or_positions_change(carton):
    kept = KeptPeaks(PRIOR)
    kept.of(carton, [0])
    assert kept.n_imaged == 1
    first = kept.of(carton)
    assert kept.n_imaged == 3
    kept.of(with_bias(carton, 0.151))
    back = kept.of(carton)
    assert kept.n_imaged == 3
    np.testing.assert_allclose(back.points, first.points, atol=1e-12)
    louder = replace(carton.poses[1], signal=2.0 * carton.poses[1].signal)
    changed = replace(carton, poses=(carton.poses[0], louder, carton.poses[2]))
    found = kept.of(changed)
    assert kept.n_imaged == 4
    ratio = found.of_plane(1).magnitudes / first.of_plane(1).magnitudes
    np.testing.assert_allclose(ratio, 2.0, rtol=1e-5)
    bent = carton.poses[2].tx_positions.copy()
    bent[0] += 1e-4
    drifted = replace(carton.poses[2], tx_positions=bent)
    kept.of(replace(carton, poses=(*carton.poses[:2], drifted)))
    assert kept.n_imaged == 5
    kept.of(with_bias(carton, 0.30), [0])
    assert kept.n_imaged == 6


def test_planes_left_out_keep_the_peaks_of_the_others(carton):
    kept = KeptPeaks(PRIOR)
    every = kept.of(carton)
    some = kept.of(replace(carton, poses=carton.poses[1:]))
    assert kept.n_imaged == 3
    np.testing.assert_array_equal(some.points, every.select(every.planes > 0).points)
    np.testing.assert_array_equal(some.planes, every.planes[every.planes > 0] - 1)


def test_peaks_are_dropped_with_their_samples(carton):
    kept = KeptPeaks(PRIOR)
    louder = tuple(replace(pose, signal=2.0 * pose.signal) for pose in carton.poses)
    kept.of(replace(carton, poses=louder))
    del louder
    gc.collect()
    kept.of(carton, [0])
    assert len(kept._kept) == 1


def test_grating_lobes_are_directions_of_equal_phase_at_every_antenna():
    tx, rx, axes = antennas(30.0, raster(30, 0.004))
    period = WAVEFORM.center_wavelength_m / (2.0 * 0.004)
    seen = np.array([[1.0, 0.1, -0.2], [1.0, 0.0, 0.0]])
    seen = seen / np.linalg.norm(seen, axis=1, keepdims=True) @ axes
    lobes = grating_lobes(seen, axes, np.array([period, period]))
    assert len(lobes) == 8
    centers = 0.5 * (tx + rx)
    turns = 2.0 / WAVEFORM.center_wavelength_m * (centers - centers[0])
    for others in lobes:
        assert np.linalg.norm(others, axis=1) == pytest.approx(1.0)
        assert (others @ axes[0] > 0.0).all()
        off = (others - seen) @ turns.T
        assert np.abs(off).max() > 5.0
        assert off == pytest.approx(np.rint(off), abs=2e-3)
    assert grating_lobes(seen, axes, np.array([np.inf, np.inf])) == []
    ahead = grating_lobes(np.array([[0.3, 0.95, 0.0]]) @ axes, axes, np.array([period, period]))
    assert sum(np.isnan(others).any() for others in ahead) > 0  # none beyond 90 degrees
