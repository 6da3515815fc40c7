from dataclasses import replace

import numpy as np

from geraf2.apps.photos.unseen import close_unseen, seen_nodes
from geraf2.fields import BoxSolid
from geraf2.scene import Grid
from geraf2.simulation.photos import look_at
from helpers import photo_sphere

GRID = Grid.cube((0.0, 0.0, 0.0), 0.16, 41)


def cameras_above(n=8):
    """Around the origin, from 40 degrees above the ground."""
    made = []
    for camera in photo_sphere.cameras(n):
        eye = camera.position - photo_sphere.CENTER
        eye[2] = 0.4
        made.append(replace(camera, camera_to_world=look_at(eye, np.zeros(3))))
    return tuple(made)


def box_with_a_bulge():
    """Box of 0.16 m with a dome of 4 cm below it."""
    points = GRID.points()
    box = BoxSolid(size_m=(0.16, 0.16, 0.16)).signed_distance(points)
    dome = np.linalg.norm(points - [0.0, 0.0, -0.02], axis=1) - 0.1
    dome = np.maximum(dome, points[:, 2] + 0.06)  # only below the box
    return points, np.minimum(box, dome).reshape(GRID.shape).astype(np.float32)


def test_a_surface_is_seen_where_it_faces_a_camera_with_nothing_between():
    points, values = box_with_a_bulge()
    band, seen = seen_nodes(values, GRID, cameras_above())
    points = points.reshape(*GRID.shape, 3)
    top = band & (points[..., 2] > 0.075) & (np.abs(points[..., :2]).max(axis=3) < 0.06)
    below = band & (points[..., 2] < -0.1)
    assert seen[top].mean() > 0.95
    assert not seen[below].any()
    assert not (seen & ~band).any()


def test_an_unseen_bulge_shrinks_and_what_is_seen_stays():
    points, values = box_with_a_bulge()
    closed = close_unseen(values, GRID, cameras_above())
    points = points.reshape(*GRID.shape, 3)
    assert points[values < 0][:, 2].min() < -0.11
    assert points[closed < 0][:, 2].min() > -0.092
    middle = np.abs(points[..., :2]).max(axis=3) < 0.05
    bottom = points[(closed < 0) & middle][:, 2].min()
    assert abs(bottom + 0.08) < 1.5 * GRID.spacing_m
    upper = (points[..., 2] > 0.0) & (np.abs(values) < GRID.spacing_m)
    assert np.mean(closed[upper] == values[upper]) > 0.98


def test_a_field_without_a_surface_is_returned_as_it_is():
    _, values = box_with_a_bulge()
    away = np.abs(values) + np.float32(0.1)
    np.testing.assert_array_equal(close_unseen(away, GRID, cameras_above()), away)


def test_a_rim_that_no_camera_faces_stays():
    points = GRID.points()
    box = BoxSolid(size_m=(0.16, 0.16, 0.16)).signed_distance(points)
    values = box.reshape(GRID.shape).astype(np.float32)
    closed = close_unseen(values, GRID, cameras_above(8))
    points = points.reshape(*GRID.shape, 3)
    foot = (np.abs(np.abs(points[..., 0]) - 0.072) < 1e-6) & (np.abs(points[..., 1]) < 0.05)
    foot &= np.abs(points[..., 2] + 0.072) < 1e-6
    assert foot.any()
    assert (values[foot] < 0.0).all()
    assert (closed[foot] < 0.0).all()
