"""Echoes that a surface predicts: a sphere that all planes see, and one that is not there."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.scene.aperture import Aperture
from geraf2.surfaces.confirmation import Confirmation
from helpers.glint_sets import glints_at
from helpers.solids import ball
from helpers.specular import frame

PLANES = [
    Aperture.from_rectangle(-0.4 * (axes := frame(30.0 * k))[0], axes, np.array([0.07, 0.1]))
    for k in range(12)
]
RADIUS_M = 0.05


def seen_glints(center, radius_m=RADIUS_M):
    """Glint of each plane at each of its antennas, on a sphere."""
    normals, poses = [], []
    for number, plane in enumerate(PLANES):
        shares = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 15)]), axis=-1).reshape(-1, 2)
        ahead = plane.points_at(shares) - center
        normals.append(ahead / np.linalg.norm(ahead, axis=1, keepdims=True))
        poses.append(np.full(len(shares), number))
    normals = np.concatenate(normals)
    return glints_at(center + radius_m * normals, normals, poses=np.concatenate(poses))


def test_a_sphere_that_the_planes_see_is_confirmed():
    center = np.zeros(3)
    found = Confirmation.of(ball(RADIUS_M), seen_glints(center), PLANES)
    assert found.confirmed > 0.98
    # The planes cover a belt: 12 of 2 x 8 degrees, +-14 degrees high.
    assert 0.03 < found.visible < 0.3


def test_a_surface_beside_its_echoes_is_not_confirmed():
    moved = seen_glints(np.array([0.03, 0.0, 0.0]))
    assert Confirmation.of(ball(RADIUS_M), moved, PLANES).confirmed < 0.3


def test_planes_that_received_nothing_lower_it():
    half = seen_glints(np.zeros(3))
    half = half.select(half.poses % 2 == 0)
    share = Confirmation.of(ball(RADIUS_M), half, PLANES).confirmed
    assert share == pytest.approx(0.5, abs=0.1)


def test_a_back_face_is_confirmed_by_planes_that_see_it_from_inside():
    # Odd planes receive no front, but see the side across the ball.
    seen = seen_glints(np.zeros(3))
    front, other = (seen.select(seen.poses % 2 == k) for k in (0, 1))
    back = replace(other, positions=-other.positions, normals=-other.normals)
    assert Confirmation.of(ball(RADIUS_M), front.join(back), PLANES).confirmed > 0.98
