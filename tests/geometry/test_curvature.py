import numpy as np
import pytest
import trimesh

from geraf2.geometry.curvature import shape_operators
from geraf2.geometry.triangles import vertex_normals


def operators(made, reach_m=0.008):
    vertices, faces = np.asarray(made.vertices), np.asarray(made.faces)
    normals = vertex_normals(vertices, faces)
    return vertices, normals, shape_operators(vertices, normals, np.arange(len(vertices)), reach_m)


def test_a_sphere_bends_alike_everywhere():
    r = 0.03
    _, normals, found = operators(trimesh.creation.icosphere(4, r))
    across = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    assert np.abs(found - across / r).max() < 0.03 / r


def test_a_torus_has_the_curvatures_of_its_closed_form():
    """1 / b around the tube, cos v / (a + b cos v) along the ring: negative inside."""
    a, b = 0.06, 0.02
    made = trimesh.creation.torus(a, b, major_sections=160, minor_sections=60)
    vertices, normals, found = operators(made, 0.004)
    rim = np.linalg.norm(vertices[:, :2], axis=1)
    cosine = (rim - a) / b
    along = np.column_stack([-vertices[:, 1], vertices[:, 0], np.zeros(len(rim))]) / rim[:, None]
    around = np.cross(normals, along)
    bend = np.einsum("ni,nij,nj->n", along, found, along)
    assert bend == pytest.approx(cosine / (a + b * cosine), abs=0.7)
    assert np.einsum("ni,nij,nj->n", around, found, around) == pytest.approx(1 / b, rel=0.03)


def test_few_neighbours_and_points_in_a_line_give_no_curvature():
    vertices = np.array([[x, 0.0, 0.0] for x in 1e-3 * np.arange(9.0)])
    normals = np.tile([0.0, 0.0, 1.0], (9, 1))
    assert np.isnan(shape_operators(vertices, normals, np.arange(9), 0.1)).all()
    assert np.isnan(shape_operators(vertices, normals, np.arange(9), 1e-4)).all()
