from dataclasses import replace

import numpy as np
import trimesh

from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.surfaces.expected_error import (
    nearness,
    own_errors_m,
    quality_numbers,
    seen_vertices,
    typical_error_m,
)
from helpers.glint_sets import glints_at

PLANE_SIDE = 0.1


def plane():
    grid = trimesh.creation.box((PLANE_SIDE, PLANE_SIDE, 1e-3)).subdivide_to_size(0.006)
    top = grid.face_normals[:, 2] > 0.5
    sheet = trimesh.Trimesh(grid.vertices, grid.faces[top], process=False)
    sheet.remove_unreferenced_vertices()
    return TriangleMesh(vertices=np.array(sheet.vertices), faces=np.array(sheet.faces))


def test_the_error_grows_with_the_distance_from_what_was_seen():
    mesh = plane()
    seen = glints_at([mesh.vertices[7]], [[0.0, 0.0, 1.0]])
    glints = replace(seen, position_sigma_m=np.array([1e-3]))
    kinds = np.full(len(mesh.vertices), Evidence.NOT_SEEN, dtype=np.uint8)
    error_m = own_errors_m(nearness(mesh, glints), kinds)
    away_m = np.linalg.norm(mesh.vertices - mesh.vertices[7], axis=1)
    np.testing.assert_allclose(error_m / error_m[7], np.hypot(away_m, 1e-3) / 1e-3)
    beside = own_errors_m(nearness(mesh, glints), np.full_like(kinds, Evidence.OUTLINE))
    assert beside.max() < error_m.max()
    assert (beside <= error_m).all()


def test_seen_requires_a_similar_normal():
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
    none = nearness(mesh, glints_at(np.zeros((0, 3)), np.zeros((0, 3))))
    assert not none.seen.any()
    assert np.isinf(none.distance_m).all()
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    assert nearness(empty, glints_at([[0, 0, 0]], [[0, 0, 1]])).seen.shape == (0,)
    assert quality_numbers(empty) == {}


def test_the_typical_error_is_the_median_over_the_area():
    mesh = plane()
    far = mesh.vertices[:, 0] > 0.3 * PLANE_SIDE  # a fifth of the area, with many vertices or few
    errors = np.where(far, 0.004, 0.001)
    evidence = np.full(len(errors), Evidence.SEEN, dtype=np.uint8)
    known = replace(mesh, expected_error_m=errors, evidence=evidence)
    assert typical_error_m(known) == 0.001
    assert typical_error_m(known, 0.95) == 0.004
    assert quality_numbers(known)["expected_error_median_mm"] == 1.0
