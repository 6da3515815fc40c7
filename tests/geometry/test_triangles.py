"""Each function against the same with plain loops, and on what has no extent."""

import math

import numpy as np
import pytest

from geraf2.geometry.boxes import FACES, box_corners
from geraf2.geometry.triangles import (
    barycentric,
    closed_edges,
    count_open_edges,
    directed_edges,
    enclosed_volume_m3,
    face_areas,
    six_fold_volumes,
    split_triangles,
    unit_normals,
    used_vertices,
    vertex_areas,
    vertex_normals,
    volume_centroid_m,
    with_area,
)

NO_FACES = np.zeros((0, 3), dtype=np.int64)
FLAT = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]], [[3.0, 1.0, 2.0]] * 3])


@pytest.fixture
def corners():
    return np.random.default_rng(1).normal(size=(20, 3, 3))


@pytest.fixture
def mesh():
    """Open, with a vertex that nothing uses (the last)."""
    rng = np.random.default_rng(2)
    return rng.normal(size=(9, 3)), np.array([rng.permutation(8)[:3] for _ in range(12)])


def cross(u, v):
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]


def edge_vectors(triangle):
    a, b, c = triangle.tolist()
    return [q - p for p, q in zip(a, b, strict=True)], [q - p for p, q in zip(a, c, strict=True)]


def heron(triangle):
    a, b, c = (math.dist(triangle[k], triangle[k - 1]) for k in range(3))
    half = 0.5 * (a + b + c)
    return math.sqrt(half * (half - a) * (half - b) * (half - c))


def test_areas_follow_heron_and_normals_are_right_handed(corners):
    assert face_areas(corners) == pytest.approx([heron(t) for t in corners])
    for triangle, normal in zip(corners, unit_normals(corners), strict=True):
        vector = cross(*edge_vectors(triangle))
        assert normal == pytest.approx([v / math.hypot(*vector) for v in vector])


def test_triangles_without_area_have_no_normal_and_are_dropped(corners):
    assert not face_areas(FLAT).any()
    assert not unit_normals(FLAT).any()
    mixed = np.concatenate([FLAT, corners, FLAT])
    np.testing.assert_array_equal(with_area(mixed), corners)
    assert with_area(FLAT).shape == (0, 3, 3)


def test_vertices_have_a_third_of_their_faces_and_the_mean_of_their_normals(mesh):
    vertices, faces = mesh
    areas, normals = np.zeros(9), np.zeros((9, 3))
    for face in faces:
        for vertex in face:
            areas[vertex] += heron(vertices[face]) / 3.0
            normals[vertex] += cross(*edge_vectors(vertices[face]))
    assert vertex_areas(vertices, faces) == pytest.approx(areas)
    got = vertex_normals(vertices, faces)
    for vertex in range(8):
        assert got[vertex] == pytest.approx(normals[vertex] / math.hypot(*normals[vertex]))
    assert not got[8].any()
    assert not vertex_areas(vertices, NO_FACES).any()
    assert not vertex_normals(vertices, NO_FACES).any()


def test_barycentric_weights_are_ratios_of_areas(corners):
    rng = np.random.default_rng(3)
    points = np.einsum("nk,nkc->nc", rng.dirichlet(np.ones(3), len(corners)), corners)
    for point, triangle, got in zip(points, corners, barycentric(points, corners), strict=True):
        parts = [heron(np.stack([point, triangle[k - 2], triangle[k - 1]])) for k in range(3)]
        assert got == pytest.approx([part / heron(triangle) for part in parts], abs=1e-6)
    np.testing.assert_allclose(barycentric(corners[:, 1], corners), [[0.0, 1.0, 0.0]] * 20)


def test_barycentric_weights_outside_and_without_area():
    triangle = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    np.testing.assert_allclose(
        barycentric(np.array([[-1.0, 0.5, 3.0]]), triangle), [[2 / 3, 0, 1 / 3]]
    )
    np.testing.assert_allclose(barycentric(FLAT[:, 0], FLAT), np.full((2, 3), 1.0 / 3.0))


def test_the_volume_of_a_box_does_not_depend_on_its_position():
    for center in ((0.0, 0.0, 0.0), (1e4, -2e4, 3e4)):
        vertices = box_corners(center, (0.2, 0.3, 0.4))
        assert enclosed_volume_m3(vertices, FACES) == pytest.approx(0.024, rel=1e-6)
        assert enclosed_volume_m3(vertices, FACES[:, ::-1]) == pytest.approx(-0.024, rel=1e-6)


@pytest.mark.parametrize("center", [(0.0, 0.0, 0.0), (1e3, -2e3, 3e3)])
def test_centroid_is_that_of_the_volume(center):
    vertices = box_corners(center, (0.2, 0.3, 0.4))
    some = split_triangles(vertices[FACES[:1]], 0.05).reshape(-1, 3)  # more vertices on one face
    rest = vertices[FACES[1:]].reshape(-1, 3)
    corners = np.concatenate([some, rest])
    got = volume_centroid_m(corners, np.arange(len(corners)).reshape(-1, 3))
    assert got == pytest.approx(np.array(center), abs=1e-8)
    assert abs(corners.mean(axis=0) - center).max() > 0.05


def test_six_fold_volumes_are_determinants(mesh):
    vertices, faces = mesh
    middle = vertices.mean(axis=0)
    want = [np.linalg.det(vertices[face] - middle) for face in faces]
    assert six_fold_volumes(vertices, faces) == pytest.approx(want)
    assert enclosed_volume_m3(np.zeros((0, 3)), NO_FACES) == 0.0


def closed_slowly(faces):
    edges = [(int(f[k]), int(f[(k + 1) % 3])) for k in range(3) for f in faces]
    return [edges.count((a, b)) == 1 and edges.count((b, a)) == 1 for a, b in edges]


@pytest.mark.parametrize(
    "faces",
    [
        FACES,
        FACES[1:],
        np.concatenate([FACES[:1, ::-1], FACES[1:]]),
        np.concatenate([FACES, FACES[:1]]),
        np.concatenate([FACES, FACES[:1, ::-1]]),
        np.concatenate([FACES, [[3, 3, 3], [1, 1, 2]]]),
        NO_FACES,
    ],
    ids=["closed", "hole", "flipped", "twice", "both directions", "flat", "none"],
)
def test_closed_edges_equals_a_plain_count(faces):
    want = closed_slowly(faces)
    np.testing.assert_array_equal(closed_edges(faces), np.array(want, dtype=bool))
    assert count_open_edges(faces) == want.count(False)
    assert len(directed_edges(faces)) == 3 * len(faces)


def test_used_vertices_are_renumbered_in_their_order():
    used, faces = used_vertices(np.array([[7, 2, 9], [2, 7, 4]]))
    assert used.tolist() == [2, 4, 7, 9]
    assert faces.tolist() == [[2, 0, 3], [0, 2, 1]]
    assert [array.size for array in used_vertices(NO_FACES)] == [0, 0]
