from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.inspection.bodies import body_of, measure, split_bodies
from helpers.glint_sets import glints_at
from helpers.inspected import POSE, block, measured_body
from helpers.solids import ball, joined

SIDES = (0.06, 0.04, 0.02)


def test_a_block_that_lies_askew_has_its_own_lengths():
    found = measure(measured_body(block(SIDES), sigma_m=0.0))
    assert [length.value for length in found.dimensions_m] == pytest.approx(SIDES, abs=1e-9)
    assert np.abs(np.array(found.axes) @ POSE[:3, :3]) == pytest.approx(np.eye(3), abs=1e-6)
    assert found.center_m == pytest.approx(tuple(POSE[:3, 3]), abs=1e-9)
    assert found.volume_m3.value == pytest.approx(np.prod(SIDES))
    assert found.area_m2.value == pytest.approx(2 * (24 + 12 + 8) * 1e-4)
    assert found.seen_fraction == 1.0


def test_uncertainties_are_those_of_the_samples():
    """A displacement that all points share, on a sphere: dV = A d, dA = 8 pi r d, dc = 0."""
    r, moved = 0.03, 1e-5 * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    mesh = ball(r, 4)
    n = len(mesh.vertices)
    found = measure(body_of(mesh, moved_m=np.repeat(moved[:, None], n, axis=1)))
    sigma = np.std(moved, ddof=1)
    assert found.volume_m3.sigma == pytest.approx(4 * np.pi * r**2 * sigma, rel=0.01)
    assert found.area_m2.sigma == pytest.approx(8 * np.pi * r * sigma, rel=0.01)
    assert [length.sigma for length in found.dimensions_m] == pytest.approx(
        [2 * sigma] * 3, rel=0.01
    )
    assert max(found.center_sigma_m) < 1e-2 * sigma


def test_parts_come_apart_largest_first_and_crumbs_stay_out():
    three = joined(
        block((0.02, 0.02, 0.02), (0.05, 0, 0)), block(SIDES), block((0.002,) * 3, (0, 0, 0.05))
    )
    n = len(three.vertices)
    likely = replace(three, expected_error_m=np.arange(n) * 1e-6, confidence=np.full(n, 0.75))
    whole = replace(body_of(likely), seen=np.arange(n) % 2 == 0)
    parts = split_bodies(whole)
    assert [len(p.mesh.faces) for p in parts] == [
        len(block(SIDES).faces),
        len(three.faces) - len(block(SIDES).faces) - len(block((0.002,) * 3).faces),
    ]
    at = int(np.flatnonzero((three.vertices == parts[0].mesh.vertices[7]).all(axis=1))[0])
    assert parts[0].sigma_m[7] == whole.sigma_m[at]
    assert parts[0].seen[7] == whole.seen[at]
    assert (parts[0].moved_m[:, 7] == whole.moved_m[:, at]).all()
    assert measure(parts[0]).probability == 0.75


def test_a_surface_without_errors_takes_them_from_the_glints():
    mesh = block(SIDES)
    up = np.flatnonzero(mesh.vertices[:, 2] > 0.0099)[:1]
    glints = glints_at(mesh.vertices[up] + [0, 0, 0.001], np.array([[0.0, 0.0, 1.0]]))
    body = body_of(mesh, glints)
    far = np.linalg.norm(mesh.vertices - glints.positions, axis=1) > 0.009
    assert body.seen.any()
    assert not body.seen[far].any()
    assert not body.seen[mesh.vertices[:, 2] < 0].any()
    assert (body.sigma_m[body.seen] < body.sigma_m[far].min()).all()
