import numpy as np
import pytest
import trimesh

from geraf2.io.mesh import TriangleMesh
from geraf2.surfaces.confidence import ConfidenceConfig, surface_evidence, with_confidence
from glint_sets import glints_at

PLANE_SIDE = 0.1


def plane():
    grid = trimesh.creation.box((PLANE_SIDE, PLANE_SIDE, 1e-3)).subdivide_to_size(0.006)
    top = grid.face_normals[:, 2] > 0.5
    sheet = trimesh.Trimesh(grid.vertices, grid.faces[top], process=False)
    sheet.remove_unreferenced_vertices()
    return TriangleMesh(vertices=np.array(sheet.vertices), faces=np.array(sheet.faces))


def test_one_full_glint_at_a_vertex_gives_one_minus_exp_minus_one():
    mesh = plane()
    evidence = surface_evidence(mesh, glints_at([mesh.vertices[7]], [[0, 0, 1]]))
    assert evidence.confidence[7] == pytest.approx(1 - np.exp(-1), rel=1e-9)
    assert evidence.confidence.argmax() == 7


def test_evidence_is_the_sum_that_the_docstring_says():
    rng = np.random.default_rng(1)
    mesh = plane()
    points = mesh.vertices[rng.integers(0, len(mesh.vertices), 40)] + rng.normal(0, 2e-3, (40, 3))
    normals = rng.normal((0, 0, 1), 0.4, (40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    strengths = rng.random(40)
    got = surface_evidence(mesh, glints_at(points, normals, strengths))
    weights = np.minimum(strengths / np.quantile(strengths, 0.98), 1) ** 0.5
    for vertex in range(0, len(mesh.vertices), 37):
        total = 0.0
        for p, n, w in zip(points, normals, weights, strict=True):
            offset = np.linalg.norm(mesh.vertices[vertex] - p)
            total += w * np.exp(-(offset**2) / (2 * 0.004**2)) * max(0.0, n[2])
        # glints beyond three standard deviations are left out: 0.011 each
        assert got.confidence[vertex] == pytest.approx(1 - np.exp(-total), abs=0.03)


def test_a_glint_that_faces_away_is_no_evidence():
    mesh = plane()
    evidence = surface_evidence(mesh, glints_at([mesh.vertices[7]], [[0, 0, -1]]))
    assert evidence.confidence.max() == 0.0
    assert not evidence.seen.any()
    assert evidence.unseen_area_fraction == 1.0
    assert evidence.nearest_normal_angle_rad[7] == pytest.approx(np.pi)


def test_unseen_area_is_the_part_without_glints():
    mesh = plane()
    left = mesh.vertices[mesh.vertices[:, 0] < -0.008 + 1e-9]
    evidence = surface_evidence(mesh, glints_at(left, np.tile([0, 0, 1.0], (len(left), 1))))
    # seen to within 8 mm of the last glint, give or take one 5 mm triangle
    assert evidence.unseen_area_fraction == pytest.approx(0.5, abs=0.06)
    assert evidence.confidence[mesh.vertices[:, 0] > 0.015].max() == 0.0
    assert evidence.confidence[mesh.vertices[:, 0] < -0.012].min() > 0.5


def test_seen_asks_for_a_similar_normal():
    mesh = plane()
    for degrees, seen in ((40, True), (50, False)):
        normal = [np.sin(np.deg2rad(degrees)), 0, np.cos(np.deg2rad(degrees))]
        evidence = surface_evidence(mesh, glints_at([mesh.vertices[7]], [normal]))
        assert evidence.seen[7] == seen
        assert evidence.nearest_normal_angle_rad[7] == pytest.approx(np.deg2rad(degrees))


def test_weak_glints_count_less():
    mesh = plane()
    strengths = np.concatenate([np.full(99, 1.0), [0.01]])
    far = np.tile([1.0, 1.0, 1.0], (99, 1))
    points = np.concatenate([far, mesh.vertices[7:8]])
    evidence = surface_evidence(mesh, glints_at(points, np.tile([0, 0, 1.0], (100, 1)), strengths))
    assert evidence.confidence[7] == pytest.approx(1 - np.exp(-0.1), rel=1e-6)


def test_no_glints_and_no_mesh_are_not_errors():
    mesh = plane()
    nothing = glints_at(np.zeros((0, 3)), np.zeros((0, 3)))
    assert surface_evidence(mesh, nothing).unseen_area_fraction == 1.0
    assert with_confidence(mesh, nothing).confidence.max() == 0.0
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    assert surface_evidence(empty, glints_at([[0, 0, 0]], [[0, 0, 1]])).unseen_area_fraction == 1.0


def test_scales_are_checked():
    with pytest.raises(ValueError, match="reach_m must be finite and positive, got 0"):
        ConfidenceConfig(reach_m=0.0)
    with pytest.raises(ValueError, match=r"strength_quantile must lie in \(0, 1\], got 1.5"):
        ConfidenceConfig(strength_quantile=1.5)
