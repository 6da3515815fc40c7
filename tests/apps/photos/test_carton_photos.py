"""Photos that bench/photos takes: geometry against the box, determinism, sensor."""

from dataclasses import replace

import numpy as np
import pytest

from carton_photos import PhotosSpec, expose, ring_cameras, simulate_photos
from carton_scene import CartonScene, photograph
from geraf2.apps.photos.photo_store import box_outline, load_photos
from geraf2.scene import Wall
from photo_writing import save_photos

WALL = Wall(
    size_m=(0.2, 0.14, 0.1), thickness_m=0.004, permittivity=1.6, center_m=(0.02, 0.0, 0.03)
)
BOUNDS = np.array([[-0.08, -0.07, -0.02], [0.12, 0.07, 0.08]])
TINY = Wall(size_m=(0.05, 0.05, 0.04), thickness_m=0.004, permittivity=1.6)
SMALL = PhotosSpec(n_photos=4, size_px=(96, 72), focal_length_px=96.0)
EXACT = replace(SMALL, pose_error_rms_m=0.0, pose_error_rms_deg=0.0)
LENS = (-0.2, 0.05, 1e-3, -1e-3, 0.0)


@pytest.fixture(scope="module")
def carton():
    return CartonScene(WALL, seed=1)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, LENS])
def test_the_silhouette_is_the_box(carton, distortion):
    spec = replace(EXACT, distortion=distortion)
    for camera in ring_cameras(spec, WALL, seed=3):
        got = photograph(carton.trace, camera).coverage >= 0.5
        expected = box_outline(camera, BOUNDS)
        # Straight edges between projected corners; a lens bends them by less than a pixel.
        differing = (got != expected).sum() / expected.sum()
        assert differing < (0.05 if any(distortion) else 0.025)


def test_the_same_seed_gives_the_same_photos_and_another_does_not():
    first, again, other = (
        simulate_photos(replace(SMALL, n_photos=1), (TINY,), seed=seed, num_threads=threads)
        for seed, threads in ((5, 1), (5, 2), (6, 1))
    )
    np.testing.assert_array_equal(first.images[0], again.images[0])
    np.testing.assert_array_equal(
        first.cameras[0].camera_to_world, again.cameras[0].camera_to_world
    )
    assert (first.images[0] != other.images[0]).mean() > 0.5


def test_noise_is_as_asked_and_over_exposure_saturates():
    grey = np.full((60, 80, 3), 0.18, np.float32)
    rng = np.random.default_rng(0)
    noisy = expose(grey, replace(SMALL, noise_rms=4.0), rng)
    assert abs(noisy.std() - 4.0) < 0.3
    assert expose(grey, replace(SMALL, noise_rms=0.0), rng).std() == 0.0
    assert (expose(grey, replace(SMALL, exposure=8.0), rng) == 255).mean() > 0.95


def test_written_photos_are_read_back(tmp_path):
    photos = simulate_photos(replace(SMALL, distortion=LENS), (TINY,), seed=0)
    save_photos(photos, tmp_path)
    loaded = load_photos(tmp_path)
    assert loaded.notes == ()
    assert loaded.photos.names == photos.names
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (10, 3))
    for index, camera in enumerate(photos.cameras):
        read = loaded.photos.cameras[index]
        np.testing.assert_allclose(read.project(points), camera.project(points), atol=1e-6)
        np.testing.assert_array_equal(loaded.photos.images[index], photos.images[index])
        np.testing.assert_array_equal(loaded.photos.masks[index], photos.masks[index])
