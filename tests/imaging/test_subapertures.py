import numpy as np
import pytest

from geraf2.imaging.subapertures import SubapertureConfig, find_raster
from geraf2.scene import Pose
from geraf2.scene.aperture import Aperture
from helpers.aperture_images import image_peaks, subaperture_images
from helpers.specular import STANDOFF_M, antennas, raster
from helpers.synthetic import WAVEFORM, point_signal

WAVELENGTH = WAVEFORM.center_wavelength_m
ORIGIN = np.zeros(3)
ONE = SubapertureConfig(size_m=0.08, max_cosine=0.2)
SPAN = (0.3, 0.5)


def pose_at(positions, target, baseline_m=0.0, angle_deg=30.0):
    tx, rx, axes = antennas(angle_deg, positions, baseline_m)
    signal = point_signal(tx, rx, np.atleast_2d(target))
    return Pose(signal=signal, tx_positions=tx, rx_positions=rx, axes=axes)


def target_at(cosines, distance, angle_deg=30.0):
    """A point at direction cosines and distance from the middle of the aperture."""
    _, _, axes = antennas(angle_deg, np.zeros((1, 2)))
    look = np.sqrt(1.0 - cosines[0] ** 2 - cosines[1] ** 2)
    return -STANDOFF_M * axes[0] + distance * np.array([look, *cosines]) @ axes


def only_peak(pose, config=ONE, target=ORIGIN):
    (image,) = subaperture_images(pose, WAVEFORM, target, SPAN, config)
    peaks = image_peaks(image.magnitude, image.bins, (6.0, 0.0))
    assert len(peaks.ranges_m) == 1
    return image, peaks


@pytest.mark.parametrize("cosines", [(0.0, 0.0), (0.05, -0.03), (-0.11, 0.08)])
def test_a_point_peaks_at_its_range_and_direction(cosines):
    pose = pose_at(raster(27), target_at(cosines, 0.387))
    _, peaks = only_peak(pose)
    # 0.1 mm of range is 1/400 cell; 1e-3 in a cosine is 0.4 mm sideways.
    assert peaks.ranges_m[0] == pytest.approx(0.387, abs=4e-4)
    np.testing.assert_allclose(peaks.cosines[0], cosines, atol=1e-3)


def jittered(positions):
    return positions + np.random.default_rng(0).uniform(-1e-3, 1e-3, positions.shape)


def with_missing(positions):
    rng = np.random.default_rng(1)
    return positions[rng.permutation(len(positions))[: int(0.85 * len(positions))]]


@pytest.mark.parametrize("change", [jittered, with_missing])
@pytest.mark.parametrize("baseline_m", [0.0, 0.005])
def test_irregular_positions_give_the_image_of_the_raster(change, baseline_m):
    target = target_at((0.05, -0.03), 0.387)
    regular = pose_at(raster(27), target, baseline_m)
    irregular = pose_at(change(raster(27)), target, baseline_m)
    assert find_raster(regular, WAVELENGTH) is not None
    assert find_raster(irregular, WAVELENGTH) is None
    _, expected = only_peak(regular)
    image, peaks = only_peak(irregular)
    assert not image.bins.horizontal.wraps
    positions = [part.ranges_m[0] * np.array([1.0, *part.cosines[0]]) for part in (peaks, expected)]
    assert np.linalg.norm(positions[0] - positions[1]) < 5e-4
    assert peaks.magnitudes[0] == pytest.approx(expected.magnitudes[0], rel=0.1)


def test_too_few_irregular_antennas_make_no_image():
    positions = jittered(raster(27))[::60]
    assert 4 < len(positions) < 16
    pose = pose_at(positions, ORIGIN)
    assert list(subaperture_images(pose, WAVEFORM, ORIGIN, SPAN, ONE)) == []


def test_a_wide_baseline_focuses_at_the_range_of_its_midpoint():
    _, peaks = only_peak(pose_at(raster(27), ORIGIN, baseline_m=0.02))
    # Unfocused, 2 cm of baseline make the path sqrt(d^2 + b^2 / 4) longer by 0.13 mm one-way.
    assert peaks.ranges_m[0] == pytest.approx(STANDOFF_M, abs=2e-4)
    np.testing.assert_allclose(peaks.cosines[0], 0.0, atol=1e-4)


@pytest.mark.parametrize(
    ("spacing_m", "n_lines", "largest", "wraps"), [(0.003, 27, 0.33, True), (0.001, 41, 0.6, False)]
)
def test_the_direction_axis_wraps_where_the_raster_is_too_coarse(
    spacing_m, n_lines, largest, wraps
):
    config = SubapertureConfig(size_m=0.04)
    pose = pose_at(raster(n_lines, spacing_m), ORIGIN)
    image = next(iter(subaperture_images(pose, WAVEFORM, ORIGIN, (0.38, 0.42), config)))
    assert image.bins.horizontal.wraps == image.bins.vertical.wraps == wraps
    cosines = image.bins.horizontal.values
    pitch = cosines[1] - cosines[0]
    assert abs(cosines).max() == pytest.approx(largest, abs=pitch)
    if wraps:
        period = WAVELENGTH / (2.0 * spacing_m)
        assert len(cosines) * pitch == pytest.approx(period)
        assert cosines[0] == pytest.approx(-0.5 * period)


def test_sub_apertures_reach_both_ends_in_equal_steps():
    pose = pose_at(raster(41), ORIGIN, angle_deg=0.0)
    config = SubapertureConfig(step_m=0.02)
    images = list(subaperture_images(pose, WAVEFORM, ORIGIN, (0.39, 0.41), config))
    assert len(images) == 16
    sideways = np.unique([np.round(image.center[1], 9) for image in images])
    # 14 lines to spare at 27 a sub-aperture; steps of 20 mm or less, rounded to whole lines
    np.testing.assert_allclose(sideways, 0.003 * np.array([-7, -2, 2, 7]), atol=1e-9)


def test_small_planes_have_sub_apertures_of_half_their_longer_side():
    config, planes = SubapertureConfig(), [Aperture.from_pose(pose_at(raster(41), ORIGIN))] * 3
    small = config.for_planes(planes)  # 0.12 m wide
    assert small.size_m == pytest.approx(0.06)
    assert small.step_m / small.size_m == pytest.approx(config.step_m / config.size_m)
    assert small.for_planes(planes) == small
    assert config.for_planes([Aperture.from_pose(pose_at(raster(61), ORIGIN))]) == config


def test_a_small_aperture_is_one_sub_aperture():
    pose = pose_at(raster(9), ORIGIN)
    (image,) = subaperture_images(pose, WAVEFORM, ORIGIN, (0.39, 0.41), SubapertureConfig())
    np.testing.assert_allclose(image.center, pose.phase_centers.mean(axis=0), atol=1e-9)


class TestFindRaster:
    def pose(self, positions):
        return pose_at(positions, ORIGIN)

    def test_every_antenna_is_at_its_lattice_point(self):
        positions = np.random.default_rng(2).permutation(raster(12))
        pose = self.pose(positions)
        found = find_raster(pose, WAVELENGTH)
        assert found.index.shape == (12, 12)
        h, v = np.meshgrid(found.horizontal_m, found.vertical_m, indexing="ij")
        np.testing.assert_allclose(positions[found.index], np.stack([h, v], axis=-1), atol=1e-9)

    def test_rounding_errors_of_a_file_are_tolerated(self):
        positions = np.round(raster(60, 0.0031234), 4)  # to 0.1 mm
        found = find_raster(self.pose(positions), WAVELENGTH)
        assert found.index.shape == (60, 60)
        spacing = np.diff(found.horizontal_m)
        np.testing.assert_allclose(spacing, 0.0031234, atol=2e-6)

    def test_a_few_holes_are_tolerated(self):
        positions = np.delete(raster(20), [3, 77, 205, 390], axis=0)
        found = find_raster(self.pose(positions), WAVELENGTH)
        assert int((found.index < 0).sum()) == 4
        assert found.index[0, 3] == -1

    @pytest.mark.parametrize(
        "positions",
        [
            np.delete(raster(20), np.arange(0, 400, 10), axis=0),
            np.concatenate([raster(20), raster(20)[:1]]),
            jittered(raster(20)),
            raster(20)[:20],
        ],
        ids=["too many holes", "two at one position", "jittered", "one line"],
    )
    def test_irregular_positions_have_no_lattice(self, positions):
        assert find_raster(self.pose(positions), WAVELENGTH) is None
