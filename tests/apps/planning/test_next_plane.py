"""The next plane: on a sphere, whose normals lie everywhere."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.planning.next_plane import expected_errors
from geraf2.apps.planning.scan_time import plane_at
from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Pose
from geraf2.scene.aperture import Aperture

SMALL, HALF, CENTER = np.array([0.001, 0.001]), np.array([0.07, 0.125]), np.zeros(3)
ABOVE, BESIDE, RAISED = (plane_at(0.0, np.deg2rad(e), 0.4, SMALL) for e in (90.0, 0.0, 45.0))


@pytest.fixture(scope="module")
def ball():
    trimesh = pytest.importorskip("trimesh")
    made = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
    vertices = np.asarray(made.vertices)
    stated = np.full(len(vertices), 2.4e-3)
    return TriangleMesh(vertices=vertices, faces=np.asarray(made.faces), expected_error_m=stated)


def squared_angles(directions):
    """Mean over the sphere of the squared angle to the nearest of some directions, by sampling."""
    normals = np.random.default_rng(1).standard_normal((100_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = (normals @ np.asarray(directions, dtype=float).T).max(axis=1)
    return float(np.mean(np.arccos(np.clip(cosine, -1.0, 1.0)) ** 2))


def test_the_error_falls_with_the_square_of_the_angle_to_what_is_seen(ball):
    before, after = expected_errors(ball, [BESIDE], [ABOVE, RAISED, BESIDE], CENTER)
    assert before == pytest.approx(2.4e-3)
    # Of one direction: mean square of the angle between any two directions, (pi^2 - 4) / 2.
    alone = 0.5 * (np.pi**2 - 4.0)
    assert squared_angles([[1, 0, 0]]) == pytest.approx(alone, rel=0.01)
    for error, direction in zip(after, ([0, 0, 1], [1, 0, 1] / np.sqrt(2), [1, 0, 0]), strict=True):
        left = squared_angles([[1, 0, 0], direction]) / alone
        assert error == pytest.approx(0.4e-3 + 2e-3 * left, rel=0.04)
    assert after[2] == pytest.approx(before)


def test_a_larger_plane_gains_more_and_one_that_was_there_nothing(ball):
    wide = plane_at(0.0, np.deg2rad(90.0), 0.4, HALF)
    before, after = expected_errors(ball, [BESIDE, ABOVE], [ABOVE, wide], CENTER)
    assert after[0] == pytest.approx(before)
    assert after[1] < 0.99 * before


def test_a_surface_smaller_than_the_seen_one_gains_nothing(ball):
    sure = replace(ball, expected_error_m=np.full(len(ball.vertices), 0.3e-3))
    before, after = expected_errors(sure, [BESIDE], [ABOVE], CENTER)
    assert after[0] == pytest.approx(before)
    with pytest.raises(UserError, match="does not state its expected error"):
        expected_errors(replace(ball, expected_error_m=None), [BESIDE], [ABOVE], CENTER)


def test_the_plane_of_a_pose_covers_its_phase_centres():
    rng = np.random.default_rng(0)
    beside = plane_at(0.0, 0.0, 0.4, HALF)
    local = rng.uniform(-1, 1, (50, 2)) * HALF + [0.01, 0.02]
    centers = beside.middle_m + local @ beside.axes[1:]
    apart = np.array([0.0, 0.001, 0.0])
    pose = Pose(
        signal=np.zeros((50, 1), np.complex64),
        tx_positions=centers + apart,
        rx_positions=centers - apart,
        axes=beside.axes,
    )
    plane = Aperture.from_pose(pose).turn_right_handed()
    assert plane.half_m == pytest.approx(0.5 * np.ptp(local, axis=0))
    assert plane.axes == pytest.approx(beside.axes)
    inside = np.abs((centers - plane.middle_m) @ plane.axes[1:].T) <= plane.half_m + 1e-12
    assert inside.all()
