from dataclasses import replace

import numpy as np
import pytest

from geraf2.ops.subaperture import CosineAxis, Lattice, SubapertureBins, subaperture_peaks
from helpers.antennas import bins_of, members_of
from helpers.aperture_images import image_peaks, kernel_images, noise_floor
from helpers.synthetic import WAVEFORM, white_noise
from reference import peaks as peaks_twin
from reference import subaperture as twin

AXES = np.eye(3)
TARGET = np.array([0.4, 0.0, 0.0])
SPACING = (0.003, 0.0025)
SHAPE = (7, 6)


def problem(shape=SHAPE, n_samples=32, positions=None, dtype=np.complex128, seed=0):
    """White noise on antennas about the origin, the lattice they lie on, and the twin's view."""
    rng = np.random.default_rng(seed)
    lattice = Lattice(shape=shape, spacing_m=SPACING)
    if positions is None:
        index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
        positions = (index.reshape(-1, 2) - 0.5 * (np.array(shape) - 1)) * SPACING
    else:
        lattice = None
    n = len(positions)
    centers = np.concatenate([np.zeros((n, 1)), positions], axis=1)
    baseline = 0.002 * rng.standard_normal((n, 3))
    signal = white_noise((n, n_samples), dtype)
    weights = rng.uniform(0.1, 1.0, n)
    waveform = replace(WAVEFORM, n_samples=n_samples)
    subapertures = members_of(
        positions, weights=weights / weights.sum(), focus=TARGET[None], lattice=lattice
    )
    return signal, centers + baseline, centers - baseline, waveform, subapertures


def direct_sum(arguments, bins):
    signal, tx, rx, waveform, subapertures = arguments
    axes = (bins.horizontal.values, bins.vertical.values, bins.ranges_m)
    weights = subapertures.weights
    return twin.image(signal, tx, rx, AXES, weights, np.zeros(3), TARGET, waveform, axes)


@pytest.mark.usefixtures("simd")
@pytest.mark.parametrize(("dtype", "atol"), [(np.complex64, 1e-6), (np.complex128, 1e-13)])
@pytest.mark.parametrize(
    ("shape", "n_samples", "n_cosines", "wraps"),
    [((7, 6), 32, 5, False), ((6, 7), 31, 6, True), ((1, 2), 1, 1, False), ((3, 3), 17, 7, True)],
)
def test_images_on_a_lattice_are_the_direct_sum(shape, n_samples, n_cosines, wraps, dtype, atol):
    arguments = problem(shape, n_samples, dtype=dtype)
    bins = bins_of((n_cosines, 0.06), (3, 0.2), wraps=wraps)
    (image,) = kernel_images(*arguments, bins)
    assert image.dtype == np.empty(0, dtype).real.dtype
    np.testing.assert_allclose(image, direct_sum(arguments, bins), atol=atol)


@pytest.mark.parametrize(("dtype", "atol"), [(np.complex64, 2e-6), (np.complex128, 1e-6)])
def test_images_of_antennas_anywhere_are_the_direct_sum(dtype, atol):
    # Phases that cancel nowhere: the error is relative to the sum of all magnitudes.
    positions = np.random.default_rng(3).uniform(-0.04, 0.04, (60, 2))
    arguments = problem(positions=positions, dtype=dtype)
    bins = bins_of((9, 0.15), (3, 0.31), n_ranges=3)
    (image,) = kernel_images(*arguments, bins)
    np.testing.assert_allclose(image, direct_sum(arguments, bins), atol=atol)


def lumpy_image(shape, dtype, seed):
    rng = np.random.default_rng(seed)
    spectrum = np.fft.fftn(rng.standard_normal(shape))
    smooth = [np.exp(-((4.0 * np.fft.fftfreq(n)) ** 2)) for n in shape]
    spectrum *= smooth[0][:, None, None] * smooth[1][:, None] * smooth[2]
    return np.abs(np.fft.ifftn(spectrum)).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("wraps", [(False, False), (True, False), (False, True), (True, True)])
@pytest.mark.parametrize("shape", [(14, 11, 9), (8, 7, 19), (5, 5, 3), (1, 4, 6)])
def test_peaks_are_those_of_the_twin(shape, wraps, dtype):
    magnitude = lumpy_image(shape, dtype, seed=7)
    bins = SubapertureBins(
        horizontal=CosineAxis(count=shape[0], first=-0.2, pitch=0.02, wraps=wraps[0]),
        vertical=CosineAxis(count=shape[1], first=-0.1, pitch=0.03, wraps=wraps[1]),
        first_range_m=0.3,
        range_pitch_m=0.02,
        n_ranges=shape[2],
    )
    found = image_peaks(magnitude, bins, (20.0, 0.0))
    expected = peaks_twin.find_peaks(magnitude, wraps, 20.0, 0.0)
    assert len(found.ranges_m) == len(expected)
    if shape[0] > 5:
        assert len(expected) > 3
    np.testing.assert_allclose(noise_floor(magnitude, bins), peaks_twin.noise_floor(magnitude))
    for n, (_, position, value, noise) in enumerate(expected):
        scaled = position * (0.02, 0.03, 0.02) + (-0.2, -0.1, 0.3)
        measured = (*found.cosines[n], found.ranges_m[n])
        np.testing.assert_allclose(measured, scaled, atol=1e-9 if dtype is np.float64 else 1e-7)
        assert found.magnitudes[n] == value
        assert found.noise[n] == pytest.approx(noise)


@pytest.mark.parametrize("n_directions", [5, 29, 33])  # 2, 8 and 9 are used
def test_noise_floor_of_equal_and_zero_magnitudes_is_that_of_the_twin(n_directions):
    magnitude = np.random.default_rng(9).integers(0, 4, (n_directions, 1, 21)).astype(np.float32)
    bins = bins_of((n_directions, 0.01), (1, 0.1), n_ranges=21)
    np.testing.assert_allclose(noise_floor(magnitude, bins), peaks_twin.noise_floor(magnitude))


@pytest.mark.parametrize("scattered", [False, True])
def test_peaks_are_those_of_the_images_with_any_threads(scattered):
    positions = np.random.default_rng(5).uniform(-0.03, 0.03, (80, 2)) if scattered else None
    arguments = list(problem((9, 9), positions=positions, dtype=np.complex64))
    one = arguments[4]
    n = len(one.antennas)
    half = replace(
        one,
        offsets=np.array([0, n // 2, n, n + 5]),
        antennas=np.concatenate([one.antennas, one.antennas[:5]]),
        weights=np.concatenate([one.weights, one.weights[:5]]),
        positions=np.concatenate([one.positions, one.positions[:5]]),
        focus=np.tile(TARGET, (3, 1)),
        focus_range_m=np.full(3, 0.4),
    )
    arguments[4] = half
    bins = bins_of((21, 0.06), (21, 0.05), n_ranges=12)
    images = kernel_images(*arguments, bins, num_threads=1)
    assert np.array_equal(images, kernel_images(*arguments, bins, num_threads=3))
    for num_threads in (1, 2, 4):
        found = subaperture_peaks(
            *arguments, bins, thresholds_db=(20.0, 0.0), num_threads=num_threads
        )
        np.testing.assert_array_equal(found.tops, images.max(axis=(1, 2, 3)))
        for number, image in enumerate(images):
            expected = image_peaks(image, bins, (20.0, 0.0))
            own = found.subapertures == number
            assert own.sum() > 0
            for name in ("cosines", "ranges_m", "magnitudes", "noise"):
                assert np.array_equal(getattr(found, name)[own], getattr(expected, name))


def test_a_conjugate_view_and_strides_change_nothing():
    signal, *rest = problem()
    bins = bins_of()
    expected = kernel_images(signal, *rest, bins)
    wide = np.repeat(signal, 2, axis=1)
    assert np.array_equal(kernel_images(wide[:, ::2], *rest, bins), expected)


def test_no_subaperture_and_an_empty_one_are_no_error():
    signal, tx, rx, waveform, members = problem()
    bins = bins_of()
    empty = replace(
        members,
        offsets=np.array([0, 0]),
        antennas=members.antennas[:0],
        weights=members.weights[:0],
        positions=members.positions[:0],
    )
    assert not kernel_images(signal, tx, rx, waveform, empty, bins).any()
    peaks = subaperture_peaks(signal, tx, rx, waveform, empty, bins, thresholds_db=(20.0, 0.0))
    assert len(peaks.ranges_m) == 0
    none = replace(empty, offsets=np.array([0]), focus=np.zeros((0, 3)), focus_range_m=np.zeros(0))
    assert kernel_images(signal, tx, rx, waveform, none, bins).shape == (0, *bins.shape)


def test_a_position_far_off_its_lattice_is_put_on_the_rim():
    signal, tx, rx, waveform, members = problem()
    far = replace(members, positions=1e300 * members.positions)
    assert np.isfinite(kernel_images(signal, tx, rx, waveform, far, bins_of())).all()


@pytest.mark.parametrize("value", [np.nan, -np.nan, np.inf, -np.inf])
def test_an_image_with_nan_has_no_peaks(value):
    signal, tx, rx, waveform, members = problem((9, 9))
    signal[3, 2] = value  # sums of infinities are NaN, on x86 with a sign
    bins = bins_of((21, 0.06), (3, 0.2))
    peaks = subaperture_peaks(signal, tx, rx, waveform, members, bins, thresholds_db=(60.0, -60.0))
    assert len(peaks.ranges_m) == 0
    assert np.isnan(peaks.tops).all()
    image = np.ones(bins.shape)
    image[2, 1, 0] = np.copysign(np.nan, value)
    assert np.isnan(noise_floor(image, bins)).all()
    assert len(image_peaks(image, bins, (60.0, -60.0)).ranges_m) == 0
