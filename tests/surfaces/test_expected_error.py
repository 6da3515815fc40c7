from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.surfaces.expected_error import (
    bounded_factor,
    nearness,
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


def test_a_direct_return_nearby_bounds_the_error():
    """The factor is that of draws, of which a share p is redrawn until it is within the bound."""
    rng = np.random.default_rng(0)
    for spread_m, bound_m, p in ((3e-3, 2e-3, 1.0), (8e-3, 2e-3, 0.7), (1e-3, 4e-3, 0.9)):
        drawn = spread_m * rng.standard_normal(400_000)
        within = drawn[np.abs(drawn) <= bound_m]
        variance = p * np.mean(within**2) + (1.0 - p) * spread_m**2
        factor = bounded_factor(np.array([spread_m]), np.array([bound_m]), np.array([p]))[0]
        assert factor * spread_m == pytest.approx(np.sqrt(variance), rel=0.01)


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
    assert not none.support.any()
    assert not none.seen.any()
    assert np.isinf(none.distance_m).all()
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    assert nearness(empty, glints_at([[0, 0, 0]], [[0, 0, 1]])).support.shape == (0,)
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
