"""Parts cut into bodies where their surface bridges a gap that planes face and that is silent."""

from dataclasses import replace

import numpy as np
import pytest
from skimage.measure import marching_cubes

from geraf2.apps.inspection.bodies import split_bodies
from geraf2.apps.inspection.necks import Neck, cut_at_necks
from geraf2.io.mesh import TriangleMesh
from helpers.inspected import around, block, measured

RADIUS_M, APART_M = 0.018, 0.042
CORNERS = np.array([aperture.corners_m for aperture in around()])
HERE = np.eye(4)


def dumbbell():
    """Two balls with a bar between them: as a fit bridges their gap, or one body."""
    at, step = np.linspace(-0.045, 0.045, 46, retstep=True)
    x, y, z = np.meshgrid(at, at, at, indexing="ij")
    balls = [np.sqrt((x - c) ** 2 + y**2 + z**2) - RADIUS_M for c in (-APART_M / 2, APART_M / 2)]
    bar = np.maximum(np.abs(x) - APART_M / 2, np.hypot(y, z) - 0.007)
    values = np.minimum.reduce([*balls, bar])
    found = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    vertices = step * found[0] + at[0]
    return TriangleMesh(vertices=vertices, faces=found[1].astype(np.int64))


def part(silent_m):
    """One part, with echoes from all of it but from the middle, |x| below a length."""
    body = measured(dumbbell(), HERE, sigma_m=1e-6)
    return replace(body, seen=np.abs(body.mesh.vertices[:, 0]) > silent_m)


def test_a_silent_neck_that_planes_face_is_cut():
    bodies, probability = cut_at_necks([part(0.008)], CORNERS)
    assert len(bodies) == 2
    assert probability > 0.9
    middles = sorted(float(body.mesh.vertices[:, 0].mean()) for body in bodies)
    assert middles == pytest.approx([-APART_M / 2, APART_M / 2], abs=4e-3)
    for body in bodies:  # closed at the cut
        assert len(split_bodies(body)) == 1
        assert not body.seen[np.abs(body.mesh.vertices[:, 0]) < 1e-3].any()


def test_a_neck_that_echoed_is_part_of_one_body():
    (body,), probability = cut_at_necks([part(0.0)], CORNERS)
    assert len(body.mesh.faces) == len(dumbbell().faces)
    assert probability > 0.9


def test_what_no_plane_faces_is_not_cut_and_not_certain():
    bodies, probability = cut_at_necks([part(0.008)], CORNERS[:0])
    assert len(bodies) == 1
    assert probability < 0.8


def test_a_body_without_a_neck_stays_whole():
    ball = measured(block((0.05, 0.03, 0.03), edge_m=0.003), HERE, sigma_m=1e-6)
    bodies, probability = cut_at_necks([replace(ball, seen=ball.seen & False)], CORNERS)
    assert (len(bodies), probability) == (1, 1.0)


def test_the_odds_of_a_neck_are_those_of_its_patches():
    """Eight patches of 10 mm^2, of which a share is seen, against a binomial law written out."""
    for seen in (0.0, 0.25, 1.0):
        k = 8.0 * seen
        bridge = 0.1**k * 0.9 ** (8.0 - k) * np.exp(-1.25)
        one = 0.8**k * 0.2 ** (8.0 - k)
        found = Neck((0, 1), 80e-6, seen, 0.8).probability
        assert found == pytest.approx(bridge / (bridge + one))


def test_existence_counts_in_the_odds_of_the_count():
    pieces = [replace(part(0.0), probability=p) for p in (0.9, 0.7)]
    assert cut_at_necks(pieces, CORNERS)[1] == pytest.approx(
        0.63 * cut_at_necks([part(0.0)], CORNERS)[1] ** 2
    )
