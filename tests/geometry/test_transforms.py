import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.errors import UserError
from geraf2.geometry.transforms import (
    apply_rigid,
    inverse_rigid,
    require_rigid,
    rigid,
    rotation_of_quaternion,
)

TURN = Rotation.from_rotvec([0.3, -0.8, 1.1]).as_matrix()
SHIFT = np.array([0.1, -0.2, 0.3])


def test_the_inverse_brings_points_back():
    points = np.random.default_rng(0).normal(size=(7, 3))
    moved = apply_rigid(rigid(TURN, SHIFT), points)
    np.testing.assert_allclose(apply_rigid(inverse_rigid(TURN, SHIFT), moved), points, atol=1e-14)


def test_a_quaternion_equals_its_axis_and_angle():
    axis, angle = np.array([1.0, 2.0, -2.0]) / 3.0, 0.7
    quaternion = 5.0 * np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)])
    want = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(rotation_of_quaternion(quaternion), want, atol=1e-14)
    assert np.isnan(rotation_of_quaternion(np.zeros(4))).all()


def test_a_rotation_with_four_digits_becomes_exact():
    got = require_rigid(rigid(TURN.round(4), SHIFT), "poses.txt")
    np.testing.assert_allclose(got[:3, :3] @ got[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(got, rigid(TURN, SHIFT), atol=1e-4)
    np.testing.assert_array_equal(got[:3, 3], SHIFT)
    np.testing.assert_array_equal(require_rigid(rigid(TURN, SHIFT)[:3], "-")[3], [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("matrix", "stated"),
    [
        (np.eye(3), "4 x 4"),
        (rigid(1.1 * TURN, SHIFT), "no rigid transform"),
        (rigid(np.zeros((3, 3)), SHIFT), "no rigid transform"),
        (rigid(TURN @ np.diag([1.0, 1.0, -1.0]), SHIFT), "handedness"),
        (rigid(TURN, np.array([0.0, np.inf, 0.0])), "not finite"),
        (rigid(np.full((3, 3), np.nan), SHIFT), "not finite"),
        (np.eye(4) + np.eye(4, k=-3), "last row"),
    ],
)
def test_a_matrix_that_is_not_rigid_is_refused(matrix, stated):
    with pytest.raises(UserError, match=rf"poses\.txt: .*{stated}"):
        require_rigid(matrix, "poses.txt")
