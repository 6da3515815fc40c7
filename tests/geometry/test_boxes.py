import itertools

import numpy as np
import pytest

from geraf2.geometry.boxes import beyond_sides, box_corners

CENTER, SIZE = (0.1, -0.2, 0.3), (0.2, 0.3, 0.4)


def test_corners_are_all_sums_of_middle_and_half_sides():
    want = [
        [c + sign * 0.5 * s for c, s, sign in zip(CENTER, SIZE, signs, strict=True)]
        for signs in itertools.product((-1, 1), repeat=3)
    ]
    np.testing.assert_allclose(box_corners(CENTER, SIZE), want)


def test_beyond_sides_equals_a_plain_loop():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    got = beyond_sides(points, CENTER, SIZE)
    for point, beyond in zip(points, got, strict=True):
        low, high = ([c + s * h / 2 for c, h in zip(CENTER, SIZE, strict=True)] for s in (-1, 1))
        want = [max(a - p, p - b) for p, a, b in zip(point, low, high, strict=True)]
        assert beyond == pytest.approx(want)


def test_a_corner_is_inside_and_a_point_just_beyond_is_not():
    box = ((0.0, 0.0, 0.0), (2.0, 4.0, 8.0))
    corners = box_corners(*box)
    assert (beyond_sides(corners, *box) <= 0.0).all()
    assert (beyond_sides(np.nextafter(corners, 2.0 * corners), *box) > 0.0).all()
    assert beyond_sides(np.zeros((0, 3)), *box).shape == (0, 3)
