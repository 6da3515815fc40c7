"""Lines of sight through bodies, and the densities of echoes by their faces, against slow twins."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.echoes import faces
from helpers.glint_sets import glints_at
from helpers.specular import fibonacci_sphere
from reference.faces import chord, densities

CELL_M, RADIUS_M = 0.042, 0.04


def two_plates(glints):
    """Plates of 6 mm and 30 mm across the x axis, 20 mm apart."""
    thin = trimesh.creation.box((0.006, 0.2, 0.2))
    thick = trimesh.creation.box((0.03, 0.2, 0.2)).apply_translation([-0.038, 0.0, 0.0])
    both = trimesh.util.concatenate([thin.subdivide(), thick.subdivide()])
    return both.vertices, both.faces


def ball(glints):
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=RADIUS_M)
    return mesh.vertices, mesh.faces


def scan_of(glints, surface):
    return faces.Scan(
        glints=glints, surface_through=surface, cell_m=CELL_M, volume_m3=0.1, num_threads=1
    )


def test_densities_are_those_of_one_number_at_a_time():
    rng = np.random.default_rng(4)
    positions = np.column_stack([rng.uniform(-0.1, 0.03, 40), np.zeros(40), np.zeros(40)])
    glints = glints_at(positions, np.tile([1.0, 0.0, 0.0], (40, 1)))
    lines = faces._cross(scan_of(glints, two_plates), glints)
    assert lines.exists.all()
    found = faces._densities(lines, CELL_M)
    model = {"index": faces.INDEX, "cell_m": CELL_M}
    model["area_m2"] = 2.0 * (0.2 * 0.2 * 2.0 + 4.0 * 0.2 * 0.018)
    # Where the line crosses a plate, both point out of it along the line.
    paths, agreements = [(-0.003, 0.003), (0.023, 0.053)], [(1.0, 1.0)] * 2
    for x, own in zip(positions[:, 0], found, strict=True):
        np.testing.assert_allclose(own, densities(-x, paths, agreements, model), rtol=1e-6)


def test_a_line_of_sight_is_refracted_where_it_enters_a_ball():
    beside = np.linspace(0.0, 0.8, 9) * RADIUS_M
    positions = np.column_stack([np.zeros(9), beside, np.zeros(9)])
    glints = glints_at(positions, np.tile([1.0, 0.0, 0.0], (9, 1)))
    lines = faces._cross(scan_of(glints, ball), glints)
    expected = [chord(b, RADIUS_M, faces.INDEX) for b in beside]
    np.testing.assert_allclose(lines.thickness_m[:, 0], expected, atol=2e-4)
    # A wave through the middle meets both faces at a right angle, others neither.
    assert lines.entry[0, 0] > 0.99
    assert lines.leave[0, 0] > 0.99
    assert (np.diff(lines.entry[:, 0]) < 0.0).all()
    assert (np.diff(lines.leave[:, 0]) < 0.0).all()


def test_a_line_goes_through_a_shell_and_through_what_it_holds_each_alone():
    def nested(_):
        meshes = [trimesh.creation.icosphere(subdivisions=4, radius=r) for r in (RADIUS_M, 0.01)]
        cavity = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
        cavity.invert()
        both = trimesh.util.concatenate([*meshes, cavity])
        return both.vertices, both.faces

    front_of_each = np.array([[RADIUS_M, 0.0, 0.0], [0.01, 0.0, 0.0]])
    glints = glints_at(front_of_each, np.tile([1.0, 0.0, 0.0], (2, 1)))
    lines = faces._cross(scan_of(glints, nested), glints, faces.AIR)
    assert lines.exists.all()
    np.testing.assert_allclose(np.sort(lines.thickness_m), [[0.02, 2.0 * RADIUS_M]] * 2, atol=1e-4)
    np.testing.assert_allclose(np.abs(lines.behind_m).min(axis=1), 0.0, atol=1e-4)
    front = faces._densities(lines, CELL_M)[..., 0]
    assert (front.max(axis=1) > 100.0 * front.min(axis=1)).all()


def test_a_shell_that_is_inside_out_is_crossed_nonetheless():
    def inverted(_):
        mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
        mesh.invert()
        return mesh.vertices, mesh.faces

    glints = glints_at([[RADIUS_M, 0.0, 0.0]], [[1.0, 0.0, 0.0]])
    lines = faces._cross(scan_of(glints, inverted), glints, faces.AIR)
    np.testing.assert_allclose(lines.thickness_m, [[2.0 * RADIUS_M]], atol=1e-4)


@pytest.mark.parametrize("ratio", [1.0, 0.6])
def test_refraction_follows_snells_law(ratio):
    rng = np.random.default_rng(0)
    normals, directions = rng.standard_normal((2, 200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions -= 2.0 * np.maximum(np.sum(directions * normals, axis=1), 0.0)[:, None] * normals
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    bent = faces.refract(directions, normals, ratio)
    before, behind = np.cross(normals, directions), np.cross(normals, bent)
    np.testing.assert_allclose(behind, ratio * before, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1.0, atol=1e-12)
    assert (np.sum(bent * normals, axis=1) < 0.0).all()


def test_what_comes_from_inside_is_taken_for_grazing():
    bent = faces.refract(np.array([0.0, 0.6, 0.8]), np.array([0.0, 0.0, 1.0]), 0.5)
    assert bent[2] < 0.0
    assert np.isfinite(bent).all()


def test_side_lobes_of_strong_back_faces_are_left_out():
    legs = fibonacci_sphere(200)
    back, false, front = -0.055 * legs, (2.2 * CELL_M - 0.055) * legs, 0.024 * legs
    strengths = np.repeat([1.0, 0.25, 0.25], 200)
    glints = glints_at(np.concatenate([back, false, front]), np.concatenate([legs] * 3), strengths)
    found = faces._side_lobes(scan_of(glints, ball))
    assert not found[:200].any()
    assert found[200:400].all()
    assert not found[400:].any()
    equal = faces._side_lobes(scan_of(replace(glints, strengths=np.ones(600)), ball))
    assert not equal.any()


def test_a_clump_of_clutter_beside_a_body_is_left_out():
    legs = fibonacci_sphere(400)
    clump = np.array([0.0, 0.0, RADIUS_M + 0.02]) + 0.002 * legs[:3]
    glints = glints_at(np.concatenate([RADIUS_M * legs, clump]), np.concatenate([legs, legs[:3]]))
    numbers = np.arange(len(glints))
    found = faces._without_stray(faces.Faces(glints, numbers, numbers % 2 == 0))
    np.testing.assert_array_equal(found.sources, numbers[:400])
    np.testing.assert_array_equal(found.is_back, numbers[:400] % 2 == 0)
    # Another body of a fifth of the size stays.
    other = RADIUS_M * legs[:80] + [0.0, 0.0, 0.2]
    both = glints_at(np.concatenate([RADIUS_M * legs, other]), np.concatenate([legs, legs[:80]]))
    numbers = np.arange(len(both))
    assert len(faces._without_stray(faces.Faces(both, numbers, numbers < 0)).sources) == 480
