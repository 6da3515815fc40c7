from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.surfaces.expected_error import (
    ErrorModel,
    nearness,
    quality_numbers,
    seen_vertices,
    with_expected_error,
)
from helpers.glint_sets import glints_at

PLANE_SIDE = 0.1


def plane():
    grid = trimesh.creation.box((PLANE_SIDE, PLANE_SIDE, 1e-3)).subdivide_to_size(0.006)
    top = grid.face_normals[:, 2] > 0.5
    sheet = trimesh.Trimesh(grid.vertices, grid.faces[top], process=False)
    sheet.remove_unreferenced_vertices()
    return TriangleMesh(vertices=np.array(sheet.vertices), faces=np.array(sheet.faces))


def test_what_lies_near_is_what_the_docstring_says():
    rng = np.random.default_rng(1)
    mesh, model = plane(), ErrorModel()
    points = mesh.vertices[rng.integers(0, len(mesh.vertices), 40)] + rng.normal(0, 2e-3, (40, 3))
    tilted = rng.normal((0, 0, 1), 0.4, (40, 3))
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    found = nearness(mesh, glints_at(points, tilted), model)
    made = with_expected_error(mesh, glints_at(points, tilted), 1.5 * model.spacing_m)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    for vertex in range(0, len(mesh.vertices), 37):
        reach, sums = np.inf, np.zeros(3)
        for p, n in zip(points, tilted, strict=True):
            offset = mesh.vertices[vertex] - p
            cosine = normals[vertex] @ n
            turn = model.turn_m * np.arccos(np.clip(cosine, -1, 1))
            reach = min(reach, np.hypot(np.linalg.norm(offset), turn))
            weight = np.exp(-(offset @ offset) / (2 * model.near_m**2)) * max(0.01, cosine)
            off = [abs(p[2] - mesh.vertices[0, 2])]  # a glint's foot lies within the square ...
            off.append(np.linalg.norm(np.maximum(np.abs(p[:2]) - PLANE_SIDE / 2, 0)))  # ... or not
            off_surface = min(np.hypot(*off), model.misfit_cap_m)
            sums += weight * np.array([1.0, (offset @ n) ** 2, off_surface**2])
        assert found.reach_m[vertex] == pytest.approx(reach, rel=1e-9)
        assert found.spread_m[vertex] == pytest.approx(np.sqrt(sums[1] / sums[0]), rel=1e-6)
        assert found.misfit_m[vertex] == pytest.approx(np.sqrt(sums[2] / sums[0]), rel=1e-3)
        expected = (model.overall * found.misfit_overall_m) ** 2
        expected += sums[2] / sums[0] * sums[1] / sums[0] / model.spread_m**2
        expected += sums[2] / sums[0] * (reach / model.reach_m) ** 2
        expected = 1.5 * np.sqrt(expected)
        assert made.expected_error_m[vertex] == pytest.approx(expected, rel=1e-3)


def test_the_error_grows_away_from_the_glints():
    mesh = plane()
    left = mesh.vertices[mesh.vertices[:, 0] < -0.008 + 1e-9]
    up = np.tile([0, 0, 1.0], (len(left), 1))
    made = with_expected_error(
        mesh, glints_at(left + np.array([0, 0, 4e-4]), up), 0.003
    )  # all 0.4 mm off
    error, x = made.expected_error_m, mesh.vertices[:, 0]
    assert error[x < -0.012].max() < 3e-4
    assert error[x > 0.045].min() > 1.2e-3
    twice = with_expected_error(mesh, glints_at(left + np.array([0, 0, 8e-4]), up), 0.003)
    assert (twice.expected_error_m > 1.9 * error).all()
    assert (made.evidence[x < -0.004] == Evidence.SEEN).all()
    assert (made.evidence[x > 0.001] == Evidence.GUESSED).all()


def test_seen_asks_for_a_similar_normal():
    mesh = plane()
    for degrees, seen in ((18, True), (22, False), (180, False)):
        normal = [np.sin(np.deg2rad(degrees)), 0, np.cos(np.deg2rad(degrees))]
        glints = glints_at([mesh.vertices[7]], [normal])
        assert seen_vertices(mesh, glints)[7] == seen
    assert seen_vertices(mesh, None) is None
    known = replace(mesh, evidence=np.full(len(mesh.vertices), Evidence.SEEN, dtype=np.uint8))
    assert seen_vertices(known, None).all()


def test_no_glints_and_no_mesh_are_not_errors():
    mesh = plane()
    nothing = with_expected_error(mesh, glints_at(np.zeros((0, 3)), np.zeros((0, 3))), 0.003)
    assert np.isfinite(nothing.expected_error_m).all()
    assert (nothing.evidence == Evidence.GUESSED).all()
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    made = with_expected_error(empty, glints_at([[0, 0, 0]], [[0, 0, 1]]), 0.003)
    assert made.expected_error_m.shape == (0,)
    assert quality_numbers(made) == {}


def test_coefficients_are_checked():
    with pytest.raises(ValueError, match="reach_m must be finite and positive, got 0"):
        ErrorModel(reach_m=0.0)
