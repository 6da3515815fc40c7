"""Cameras and photo sets: projection against the equations, rays as its inverse."""

import numpy as np
import pytest

from geraf2.scene.photos import Camera, PhotoSet, bin_pixels
from helpers.scene_photos import ring_of_cameras
from photo_writing import look_at

INTRINSICS = np.array([[520.0, 0.0, 322.0], [0.0, 515.0, 238.5], [0.0, 0.0, 1.0]])
DISTORTION = (-0.21, 0.07, 1.5e-3, -8e-4, -0.01)


def looking_at(eye, target, *, distortion=(0.0,) * 5, size=(640, 480), intrinsics=INTRINSICS):
    return Camera(
        intrinsics=intrinsics,
        camera_to_world=look_at(np.asarray(eye, float), np.asarray(target, float)),
        width=size[0],
        height=size[1],
        distortion=distortion,
    )


def test_distortion_is_brown_s():
    # Written from the equations, one point: x = 0.2, y = -0.1.
    camera = Camera(
        intrinsics=INTRINSICS,
        camera_to_world=np.eye(4),
        width=640,
        height=480,
        distortion=DISTORTION,
    )
    k1, k2, p1, p2, k3 = DISTORTION
    x, y, r2 = 0.2, -0.1, 0.05
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    got = camera.project([[0.2, -0.1, 1.0]])
    np.testing.assert_allclose(got, [[520.0 * u + 322.0, 515.0 * v + 238.5]], rtol=1e-14)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, DISTORTION])
def test_rays_are_the_inverse_of_projection(distortion):
    camera = looking_at((0.3, -0.4, 0.2), (0.0, 0.02, 0.0), distortion=distortion)
    pixels = camera.pixel_centers()[::97]
    origins, directions = camera.rays(pixels)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(camera.project(origins + 0.7 * directions), pixels, atol=1e-8)


def test_rays_stay_finite_where_the_lens_model_folds():
    camera = looking_at((0.5, 0.0, 0.0), (0.0, 0.0, 0.0), distortion=(-3.0, 0.0, 0.0, 0.0, 0.0))
    _, directions = camera.rays([[0.5, 0.5], [639.5, 479.5]])
    assert np.isfinite(directions).all()


def test_what_is_behind_the_camera_has_no_image():
    camera = looking_at((0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert np.isnan(camera.project([[1.0, 0.0, 0.0]])).all()


def test_a_resized_camera_sees_the_same():
    camera = looking_at((0.3, -0.4, 0.2), (0.0, 0.02, 0.0), distortion=DISTORTION)
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    small = camera.resize(320, 120).project(points)
    np.testing.assert_allclose(small * [2.0, 4.0], camera.project(points), rtol=1e-12)


def test_binned_pictures_and_cameras_agree():
    camera = looking_at((0.3, -0.4, 0.2), (0.0, 0.02, 0.0), distortion=DISTORTION, size=(641, 481))
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    small = camera.join_pixels(3)
    assert (small.width, small.height) == (213, 160)
    np.testing.assert_allclose(3.0 * small.project(points), camera.project(points), rtol=1e-12)
    image = np.arange(7 * 9 * 3, dtype=np.uint8).reshape(7, 9, 3)
    np.testing.assert_allclose(bin_pixels(image, 3)[1, 2], image[3:6, 6:9].mean(axis=(0, 1)))
    np.testing.assert_array_equal(bin_pixels(image, 1), image)
    with pytest.raises(ValueError, match="step"):
        camera.join_pixels(0)


def test_the_focus_is_where_all_look():
    images = (np.zeros((48, 64, 3), np.uint8),) * 5
    photos = PhotoSet(names=tuple("abcde"), cameras=tuple(ring_of_cameras(5)), images=images)
    np.testing.assert_allclose(photos.focus(), 0.0, atol=1e-12)
    assert photos.subset([3, 1]).names == ("d", "b")


def test_a_camera_without_focal_length_is_an_error():
    with pytest.raises(ValueError, match=r"intrinsics\[0, 0\]"):
        looking_at((0.5, 0.0, 0.0), (0.0, 0.0, 0.0), intrinsics=np.zeros((3, 3)))
