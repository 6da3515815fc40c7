"""Echoes over figure and wall: ways by search on the wall, directions by differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from geraf2.echoes.wall_paths import over_walls, shares_transmitters
from geraf2.examples import small_capture
from geraf2.scene import Wall

WALL = Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6)
AXES = np.array([[1.0, 0.0, -1.0], [0.0, np.sqrt(2.0), 0.0], [1.0, 0.0, 1.0]]) / np.sqrt(2.0)
CENTER = np.array([-0.28, 0.0, 0.28])
FLOOR_M = -0.106


def range_over_floor(center, point):
    """Half of the shortest way antenna, point, any place on the floor, antenna [m]."""

    def far(xy):
        return sum(np.linalg.norm([*xy, FLOOR_M] - end) for end in (point, center))

    found = minimize(far, 0.5 * (point + center)[:2], tol=1e-14)
    return 0.5 * (np.linalg.norm(point - center) + found.fun)


def echo_over_floor(center, point):
    """Range and direction of that echo: the direction is how the range changes with the place."""
    steps = [1e-4 * axis for axis in AXES[1:]]
    cosines = [
        -(range_over_floor(center + step, point) - range_over_floor(center - step, point)) / 2e-4
        for step in steps
    ]
    return range_over_floor(center, point), np.array(
        [np.sqrt(1.0 - np.dot(cosines, cosines)), *cosines]
    ) @ AXES


def place_on_floor(center, point):
    """Where the way from a point to an antenna meets the floor."""
    image = point * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * FLOOR_M]
    return center + (image - center) * (FLOOR_M - center[2]) / (image[2] - center[2])


def believed(echo, point, normal, center=CENTER, walls=(WALL,), axes=AXES):
    """What is said of a glint that another plane sees, and of an echo of the raised one."""
    range_m, direction = echo
    found = over_walls(
        np.array([point + 0.4 * normal, center]),
        np.array([-normal, direction]),
        np.array([0.4, range_m]),
        np.array([point, center + range_m * direction]),
        np.array([0, 1]),
        [np.eye(3), axes],
        walls,
    )
    assert not found[0]
    return not found[1]


@pytest.fixture
def point():
    return np.array([-0.02, 0.01, 0.03])


@pytest.fixture
def normal(point):
    """The middle between the ways to the antenna and to the floor where it is seen again."""
    ways = [end - point for end in (CENTER, place_on_floor(CENTER, point))]
    both = sum(way / np.linalg.norm(way) for way in ways)
    return both / np.linalg.norm(both)


def test_an_echo_over_a_glint_and_the_floor_is_told(point, normal):
    assert abs(normal[2]) < 0.2  # an upright side, which planes around see
    range_m, direction = echo = echo_over_floor(CENTER, point)
    assert 0.0 < (CENTER + range_m * direction)[2] - FLOOR_M < 0.012
    assert not believed(echo, point, normal)
    # Rows of 32 mm that share a transmitter repeat it every wavelength / (2 * 32 mm).
    beside = direction + 0.059 * AXES[2]
    beside /= np.linalg.norm(beside)
    assert 0.012 < (CENTER + range_m * beside)[2] - FLOOR_M < 0.05  # where a figure may be
    assert not believed((range_m, beside), point, normal)


def test_neither_another_range_nor_direction_nor_a_face_turned_away_is(point, normal):
    range_m, direction = echo = echo_over_floor(CENTER, point)
    assert believed((range_m + 0.012, direction), point, normal)
    turned = direction + 0.05 * AXES[1]
    assert believed((range_m, turned / np.linalg.norm(turned)), point, normal)
    leaning = normal + 0.4 * np.array([0.0, 0.0, 1.0])
    assert believed(echo, point, leaning / np.linalg.norm(leaning))
    assert believed(echo, point, normal, walls=())
    assert believed(echo, point, normal, axes=None)  # transmitters of their own: at the wall
    assert believed((0.3, direction), point, normal)  # far above the floor


def test_what_few_explain_stays_but_a_third_of_a_group_takes_it_along(point, normal):
    range_m, direction = echo_over_floor(CENTER, point)
    beside = range_m + np.array([0.0, 0.0110, 0.0115, 0.012])  # too long to be explained

    def kept(n):
        ranges = np.array([0.4, *beside[:n]])
        directions = np.array([-normal, *[direction] * n])
        centers = np.array([point + 0.4 * normal, *[CENTER] * n])
        places = centers + ranges[:, None] * directions
        poses = np.array([0] + [1] * n)
        return (~over_walls(centers, directions, ranges, places, poses, [AXES] * 2, (WALL,)))[1:]

    assert kept(3).tolist() == [False, False, False]
    assert kept(4).tolist() == [False, True, True, True]


def test_a_column_of_receivers_shares_its_transmitters():
    pose = small_capture()[0].poses[0]
    assert not shares_transmitters(pose)
    shared = np.repeat(pose.tx_positions[::2], 2, axis=0)[: pose.n_antennas]
    assert shares_transmitters(replace(pose, tx_positions=shared))
