"""What a scan sees of a surface: a ball in closed form, obstacles, scores of both."""

import numpy as np
import pytest

from geraf2.evaluation import evaluate_mesh
from geraf2.io.mesh import TriangleMesh
from geraf2.scene.aperture import Aperture
from helpers import solids

RADIUS, AWAY, HALF = 0.05, 0.4, (0.06, 0.12)


def plane(angle_deg):
    """A rectangle at x = -AWAY, turned about z."""
    y, z = HALF[0] * np.array([-1, 1, 1, -1]), HALF[1] * np.array([-1, -1, 1, 1])
    turn = np.deg2rad(angle_deg)
    turned = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    return Aperture.from_corners(np.stack([np.full(4, -AWAY), y, z], axis=1) @ turned.T)


def ball(center=(0.0, 0.0, 0.0), radius=RADIUS, subdivisions=4):
    return solids.ball(radius, subdivisions, center)


def test_scores_of_both_parts_locate_the_error():
    truth, mesh = ball(), ball()
    moved = mesh.vertices.copy()
    moved[moved[:, 0] > 0.0] *= 1.2  # behind, which no antenna at x < 0 sees: 10 mm off
    mesh = TriangleMesh(vertices=moved, faces=mesh.faces)
    sight, rest = evaluate_mesh(mesh, truth, n_samples=4000, planes=[plane(0.0)]).by_sight
    assert (sight.part, rest.part) == ("in sight", "out of sight")
    assert sight.area_fraction + rest.area_fraction == pytest.approx(1.0)
    # Solid angle of the rectangle over the whole sphere: 4 asin(a b / sqrt((d2+a2)(d2+b2))) / 4 pi.
    a, b, d = *HALF, AWAY
    solid = 4 * np.arcsin(a * b / np.sqrt((d * d + a * a) * (d * d + b * b)))
    assert sight.area_fraction == pytest.approx(solid / (4 * np.pi), abs=0.005)
    assert sight.scores[1].f1 == 1.0
    assert sight.scores[3].f1 == pytest.approx(1.0, abs=0.01)  # at 2 mm, of dense samples
    assert 0.4 < rest.scores[1].f1 < 0.6
    assert sight.surface_truth_to_mesh.p95_m < 1e-4
    assert rest.surface_truth_to_mesh.p95_m > 5e-3


def test_without_a_scan_or_without_anything_in_sight():
    small = ball(subdivisions=2)
    assert evaluate_mesh(small, small, n_samples=100).by_sight == ()
    around = ball(radius=0.1, subdivisions=2)
    inwards = TriangleMesh(vertices=around.vertices, faces=around.faces[:, ::-1])  # hides itself
    sight, rest = evaluate_mesh(small, inwards, n_samples=100, planes=[plane(0.0)]).by_sight
    assert (sight.area_fraction, rest.area_fraction) == (0.0, 1.0)
    assert sight.surface_truth_to_mesh is None
    assert all(score.f1 == 0.0 for score in sight.scores)
