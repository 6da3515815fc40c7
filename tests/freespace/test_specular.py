"""Specular visibility against its slow twin, and apertures from poses, corners and rectangles."""

import numpy as np
import pytest
import trimesh

from geraf2.freespace.specular import angles_off, specular_visibility
from geraf2.ops.visibility import MeshScene
from geraf2.records import Pose
from geraf2.scene.aperture import Aperture
from helpers.specular import antennas, fibonacci_sphere, raster
from reference.specular import specular_margin

RADIUS_M = 0.04
LIFT_M = 1e-3


def pose(angle_deg, positions):
    tx, rx, axes = antennas(angle_deg, positions, baseline_m=0.01)
    signal = np.zeros((len(tx), 2), dtype=np.complex64)
    return Pose(signal=signal, tx_positions=tx, rx_positions=rx, axes=axes)


@pytest.fixture(scope="module")
def apertures():
    """Seven planes around, of 12 and 24 cm."""
    positions = raster(5, 0.03) * [1.0, 2.0]
    return [Aperture.from_pose(pose(51.0 * number, positions)) for number in range(7)]


@pytest.fixture(scope="module")
def surface():
    """A ball, a second one that blocks some of its paths."""
    one = trimesh.creation.icosphere(subdivisions=2, radius=RADIUS_M)
    other = trimesh.creation.icosphere(subdivisions=1, radius=0.02)
    other.apply_translation([0.15, 0.01, 0.0])
    both = trimesh.util.concatenate([one, other])
    return np.asarray(both.vertices), np.asarray(both.faces)


@pytest.mark.parametrize("blocked", [False, True])
@pytest.mark.parametrize("min_m", [-0.02, 0.015])
def test_margins_equal_those_of_a_plain_loop(apertures, surface, blocked, min_m):
    normals = fibonacci_sphere(250)
    points = 1.02 * RADIUS_M * normals
    vertices, faces = surface
    found = specular_visibility(
        points,
        normals,
        apertures,
        MeshScene(vertices, faces) if blocked else None,
        min_m=min_m,
        lift_m=LIFT_M,
    )
    triangles = vertices[faces] if blocked else ()
    wanted = np.full(found.shape, -np.inf)
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        for k, aperture in enumerate(apertures):
            margin = specular_margin(point, normal, aperture.corners_m, (), LIFT_M)
            if margin >= min_m:
                margin = specular_margin(point, normal, aperture.corners_m, triangles, LIFT_M)
                wanted[i, k] = margin
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert 10 < np.isfinite(found).sum() < found.size // 2


def test_points_in_the_cone_of_a_ball_are_blocked(apertures, surface):
    normals = fibonacci_sphere(20000)
    points = RADIUS_M * normals
    free = specular_visibility(points, normals, apertures)
    seen = specular_visibility(points, normals, apertures, MeshScene(*surface), lift_m=LIFT_M)
    lost = (np.isfinite(free) & ~np.isfinite(seen)).any(axis=1)
    away = np.hypot(0.15, 0.01)
    off = np.arccos(normals @ np.array([0.15, 0.01, 0.0]) / away)
    cone = np.arcsin(0.02 / away)
    hit = np.isfinite(free).any(axis=1)
    assert lost[hit & (off < 0.9 * cone)].all()  # the ball has facets
    assert not lost[off > cone].any()
    assert lost.sum() > 50


def test_an_aperture_is_the_area_that_the_antennas_cover(apertures):
    for number, one in enumerate(apertures):
        made = pose(51.0 * number, raster(5, 0.03) * [1.0, 2.0])
        np.testing.assert_allclose(one.half_m, (0.06, 0.12), atol=1e-12)
        np.testing.assert_allclose(one.middle_m, made.phase_centers.mean(axis=0), atol=1e-12)


def test_corners_and_rectangles_make_the_same_aperture(apertures):
    for one in apertures:
        again = Aperture.from_corners(one.corners_m)
        np.testing.assert_allclose(again.corners_m, one.corners_m, atol=1e-12)
        given = Aperture.from_rectangle(one.middle_m, one.axes, one.half_m)
        np.testing.assert_allclose(given.corners_m, one.corners_m, atol=1e-12)
        turned = one.turn_right_handed()
        assert np.linalg.det(turned.axes) == pytest.approx(1.0)
        np.testing.assert_allclose(
            np.sort(turned.corners_m, 0), np.sort(one.corners_m, 0), atol=1e-12
        )


@pytest.mark.parametrize("half_m", [(0.1, 0.0), (0.0, 0.1), (0.0, 0.0)])
def test_a_line_of_antennas_keeps_its_middle_and_receives_nothing_beside_it(half_m):
    line = Aperture.from_corners(
        Aperture.from_rectangle(np.array([-0.4, 0.1, 0.2]), np.eye(3), np.array(half_m)).corners_m
    )
    np.testing.assert_allclose(line.middle_m, (-0.4, 0.1, 0.2), atol=1e-12)
    np.testing.assert_allclose(np.sort(line.half_m), np.sort(half_m), atol=1e-12)
    normals = fibonacci_sphere(500)
    assert not (specular_visibility(0.01 * normals, normals, [line]) > 0.0).any()


def test_angles_off_are_zero_where_an_aperture_receives(apertures):
    normals = fibonacci_sphere(800)
    received = specular_visibility(np.zeros((800, 3)), normals, apertures).max(axis=1) >= 0.0
    off = angles_off(normals, apertures, np.zeros(3))
    assert off[received].max() < 0.06  # half a step of 9 directions over 24 cm at 0.4 m
    assert off[~received].min() > 0.0
