"""Retreat of unseen caps: flat surroundings draw them in, round ones do not."""

import numpy as np
import pytest

from geraf2.echoes.glint_set import Glints
from geraf2.freespace.caps import cap_retreat
from helpers.glint_sets import glints_at

SETTINGS = {"slope": 1.0, "start_m": 0.02, "lean": (0.2, 0.4)}
UP = np.array([[0.0, 0.0, 1.0]])


def ring(lean: float, radius_m: float = 0.05, n: int = 300) -> Glints:
    """Glints on a circle at z = 0; normals lean upwards by the cosine `lean`."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    return glints_at(radius_m * around, np.sqrt(1.0 - lean**2) * around + lean * UP)


@pytest.mark.parametrize(("lean", "share"), [(0.0, 1.0), (0.2, 1.0), (0.3, 0.5), (0.5, 0.0)])
def test_the_normals_around_a_cap_decide(lean, share):
    middle = np.zeros((1, 3))
    retreat = cap_retreat(middle, UP, ring(lean), **SETTINGS)
    assert retreat[0] == pytest.approx(share * (0.05 - 0.02), abs=1e-9)


def test_only_points_far_from_every_glint_move():
    along = np.array([[0.0, 0.0, 0.0], [0.029, 0.0, 0.0], [0.031, 0.0, 0.0], [0.05, 0.0, 0.0]])
    retreat = cap_retreat(along, np.repeat(UP, 4, axis=0), ring(0.0), **SETTINGS)
    np.testing.assert_allclose(retreat, [0.03, 0.001, 0.0, 0.0], atol=1e-9)


def test_a_side_that_faces_the_glints_stays():
    sideways = np.array([[1.0, 0.0, 0.0]])
    assert cap_retreat(np.zeros((1, 3)), sideways, ring(0.0), **SETTINGS)[0] == 0.0
