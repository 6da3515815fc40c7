import numpy as np
import pytest

from helpers import aperture_images
from helpers.aperture_images import SubapertureImage, find_peaks, image_bins

SHAPE = (24, 20, 16)


def image_of(magnitude, wraps=(False, False)):
    n_h, n_v, n_r = magnitude.shape
    return SubapertureImage(
        magnitude=magnitude.astype(np.float32),
        center=np.zeros(3),
        horizontal_cosines=0.02 * (np.arange(n_h) - n_h // 2),
        vertical_cosines=0.02 * (np.arange(n_v) - n_v // 2),
        ranges_m=0.3 + 0.02 * np.arange(n_r),
        wraps=wraps,
    )


def noise_floor(magnitude):
    image = image_of(magnitude)
    return aperture_images.noise_floor(image.magnitude, image_bins(image))


def lobe(position, width=1.5, shape=SHAPE, periodic=False):
    """A Gaussian, whose logarithm is a parabola: the refinement is exact for it."""
    total = 0.0
    for axis, (n, at) in enumerate(zip(shape, position, strict=True)):
        off = np.arange(n) - at
        if periodic and axis < 2:
            off = (off + n / 2) % n - n / 2
        total = total + (off**2).reshape([-1 if k == axis else 1 for k in range(3)])
    return np.exp(-total / (2.0 * width**2))


@pytest.mark.parametrize("position", [(11.3, 9.8, 7.4), (5.0, 6.49, 8.51)])
def test_the_parabola_finds_the_top_between_bins(position):
    peaks = find_peaks(image_of(lobe(position)), 20.0, 0.0)
    assert len(peaks.ranges_m) == 1
    expected = 0.02 * (np.array(position[:2]) - [12, 10])
    # 1e-4 of a bin: float32 logarithms
    np.testing.assert_allclose(peaks.cosines[0], expected, atol=2e-6)
    assert peaks.ranges_m[0] == pytest.approx(0.3 + 0.02 * position[2], abs=2e-6)


def complex_noise(shape, rms=1.0):
    parts = np.random.default_rng(0).standard_normal((2, *shape))
    return rms * np.sqrt(0.5) * np.abs(parts[0] + 1j * parts[1])


def test_the_noise_floor_is_the_root_mean_square_of_the_noise():
    rms = np.linspace(0.5, 2.0, 30)
    floor = noise_floor(complex_noise((80, 80, 30)) * rms)
    # 1600 values a bin: the median errs by 2.5 % of the power, 1.3 % of the amplitude
    np.testing.assert_allclose(floor, rms, rtol=0.06)
    assert np.mean(floor / rms) == pytest.approx(1.0, abs=0.012)


def test_echoes_in_a_fifth_of_the_directions_hardly_lift_the_floor():
    noise = complex_noise((50, 50, 10))
    noise[:10] = 100.0
    floor = noise_floor(noise)
    assert (floor > 0.9).all()
    assert (floor < 1.25).all()


def test_directions_beyond_the_horizon_are_dropped():
    image = image_of(lobe((22, 18, 7)))
    wide = SubapertureImage(
        **{
            **vars(image),
            "horizontal_cosines": 5.0 * image.horizontal_cosines,
            "vertical_cosines": 5.0 * image.vertical_cosines,
        }
    )
    assert len(find_peaks(image, 6.0, 0.0).ranges_m) == 1
    assert len(find_peaks(wide, 6.0, 0.0).ranges_m) == 0
