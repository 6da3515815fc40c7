from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes import glints as glints_module
from geraf2.echoes.glints import GlintConfig, find_echoes, find_glints
from geraf2.errors import UserError
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import Capture, LosPrior, Pose
from helpers.specular import (
    BOX_M,
    capture_of,
    raster,
    sphere_capture,
    sphere_paths,
)

BOX = LosPrior.from_box((BOX_M, BOX_M, BOX_M))
RADIUS_M = 0.04
# A 4 cm sphere spans 0.1 in direction cosine: less than a third of the default is enough.
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


@pytest.fixture(scope="module")
def capture():
    return sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M])


@pytest.fixture(scope="module")
def glints(capture):
    return find_glints(capture, BOX)


def errors(glints, centers, radii):
    """Signed distance and angle of each glint from the nearest of the spheres."""
    offset = glints.positions[:, None] - np.asarray(centers)
    distance = np.linalg.norm(offset, axis=2) - np.asarray(radii)
    nearest = np.abs(distance).argmin(axis=1)
    rows = np.arange(len(glints))
    normal = offset[rows, nearest] / np.linalg.norm(offset[rows, nearest], axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", normal, glints.normals)
    return distance[rows, nearest], np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def test_all_glints_of_a_sphere_lie_on_it_and_face_outward(glints):
    distance, angle = errors(glints, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert len(glints) == 12 * 36  # one for each sub-aperture
    assert np.abs(distance).max() < 1e-3
    assert abs(distance.mean()) < 3e-4
    assert angle.max() < 3.0
    np.testing.assert_allclose(np.linalg.norm(glints.normals, axis=1), 1.0, atol=1e-12)
    np.testing.assert_array_equal(np.unique(glints.poses), np.arange(12))


def test_the_uncertainty_covers_the_error(glints):
    distance, angle = errors(glints, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert np.mean(np.abs(distance) < 2.5 * glints.position_sigma_m) > 0.9
    assert np.mean(np.radians(angle) < 2.5 * glints.normal_sigma_rad) > 0.9


def test_where_few_returns_are_probable_the_likeliest_are_taken(capture, monkeypatch):
    certain = glints_module.label_peaks

    def doubtful(*of):
        labelled = certain(*of)
        return replace(labelled, probability=0.45 * labelled.probability)

    monkeypatch.setattr(glints_module, "label_peaks", doubtful)
    found = find_echoes(capture, BOX)
    kept = found.glints.probability
    _, index = found.likelier_than(np.nextafter(kept.min(), 0.0))
    np.testing.assert_array_equal(found.labelled.probability[index], kept)
    rest = np.delete(found.labelled.probability, index)
    assert len(kept) > 50
    assert kept.max() < GlintConfig().min_probability
    assert kept.min() >= rest.max()


def test_irregular_positions_give_the_same_glints():
    positions = raster(41)
    positions = positions + np.random.default_rng(0).uniform(-1e-3, 1e-3, positions.shape)
    capture = sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M], n_poses=2, positions=positions)
    config = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.15))
    found = find_glints(capture, BOX, config)
    distance, angle = errors(found, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert len(found) >= 2 * 9
    assert set(found.poses.tolist()) == {0, 1}
    # Focused range by range, all would lie 0.9 mm inside the sphere.
    assert np.abs(distance).max() < 3e-4
    assert angle.max() < 3.0


def test_two_spheres_are_separated():
    centers, radii = [[0.0, 0.0, 0.04], [0.01, 0.0, -0.045]], [0.03, 0.025]
    found = find_glints(sphere_capture(centers, radii), BOX)
    distance, angle = errors(found, centers, radii)
    upper = found.positions[:, 2] > 0.0
    assert upper.sum() >= 60
    assert (~upper).sum() >= 60
    # The other echo's side lobes push each peak a little.
    assert np.abs(distance).max() < 2e-3
    assert np.median(angle) < 2.0


def test_noise_of_the_same_power_makes_no_false_glints():
    found = find_glints(sphere_capture([[0, 0, 0]], [RADIUS_M], noise=1.0), BOX)
    distance, _ = errors(found, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert len(found) >= 100
    assert np.mean(np.abs(distance) > 2e-3) < 0.02


def test_noise_is_clutter_and_small_bodies_are_content():
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.08, 0.08, (8, 3))
    points = points[np.linalg.norm(points, axis=1) > RADIUS_M + 0.015]
    sphere = sphere_capture([[0, 0, 0]], [RADIUS_M], noise=1.0)  # as strong as the sphere
    beside = sphere_capture(points, np.zeros(len(points)))
    poses = tuple(
        Pose(**{**vars(pose), "signal": pose.signal + np.complex64(0.2) * other.signal})
        for pose, other in zip(sphere.poses, beside.poses, strict=True)
    )
    found = find_echoes(Capture(waveform=sphere.waveform, poses=poses), BOX)
    of_sphere, _ = errors(found.glints, [[0.0, 0.0, 0.0]], [RADIUS_M])
    apart = np.linalg.norm(found.glints.positions[:, None] - points, axis=2)
    near = apart.min(axis=1) < 5e-3
    assert np.count_nonzero(np.abs(of_sphere) < 2e-3) > 100
    assert (np.count_nonzero(apart < 5e-3, axis=0) > 100).all()
    assert np.mean((np.abs(of_sphere) > 3e-3) & ~near) < 0.1
    again, index = found.likelier_than(GlintConfig().min_probability)
    np.testing.assert_array_equal(again.positions, found.glints.positions)
    np.testing.assert_array_equal(found.labelled.probability[index], found.glints.probability)


def test_the_range_correction_is_subtracted_along_the_line_of_sight(capture, glints):
    config = GlintConfig(range_correction_m=0.001)
    found = find_glints(capture, BOX, config)
    np.testing.assert_allclose(found.positions, glints.positions + 0.001 * glints.normals)


def test_an_empty_box_reports_its_wall_echoes():
    def walls(positions, axes):
        near = -positions @ axes[0] - BOX_M / 2
        return 2.0 * np.stack([near, near + BOX_M], axis=1)

    capture = capture_of(walls, n_poses=4, positions=raster(27))
    stated = "no glint inside the box.*288 echoes of the box's walls and 0 outside it"
    with pytest.raises(UserError, match=stated):  # 2 walls, 36 sub-apertures, 4 poses
        find_glints(capture, BOX, NARROW)


def test_planes_below_a_sub_aperture_show_the_ball():
    capture = sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M], positions=raster(20))  # 57 mm wide
    found = find_glints(capture, BOX)
    distance, _ = errors(found, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert len(found) > 50
    assert np.mean(np.abs(distance) < 3e-3) > 0.9


def path_via_wall(positions, image, radius_m):
    """Point, ball at the origin, image of the point: shortest path over the ball, (n,) [m]."""
    one, two = (p / np.linalg.norm(p, axis=1, keepdims=True) for p in (positions, image))
    shares = np.linspace(0.0, 1.0, 201)[:, None, None]
    points = (1.0 - shares) * one + shares * two  # in the plane of both legs
    points *= radius_m / np.linalg.norm(points, axis=2, keepdims=True)
    leg = np.linalg.norm(points - positions, axis=2) + np.linalg.norm(points - image, axis=2)
    return leg.min(axis=0)


def test_images_in_a_wall_are_no_glints():
    # What goes over ball and wall seems to come from the wall, midway between ball and image; what
    # goes over the wall twice from the image, outside.
    wall_m, radius_m = -0.5 * BOX_M, 0.03

    def paths(positions, _):
        image = positions * [1.0, -1.0, 1.0] + [0.0, 2.0 * wall_m, 0.0]
        own, twice = (sphere_paths(p, [[0.0, 0.0, 0.0]], [radius_m]) for p in (positions, image))
        return np.column_stack([own, path_via_wall(positions, image, radius_m), twice])

    # On a raster of 3 mm the image's direction, a cosine of 0.45, wraps around to one inside.
    capture = capture_of(paths, n_poses=1, positions=raster(51, 0.002))
    found = find_glints(capture, LosPrior.from_box((BOX_M,) * 3))
    assert len(found) == 36  # one for each sub-aperture
    assert np.abs(np.linalg.norm(found.positions, axis=1) - radius_m).max() < 2e-3
