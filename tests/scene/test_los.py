from dataclasses import replace

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.scene import LosPrior, Wall


def box_mesh():
    return LosPrior.from_box((0.2, 0.3, 0.4), (0.01, 0.02, 0.03)).mesh


@pytest.mark.parametrize("size", [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (np.nan, 1.0, 1.0)])
def test_a_box_without_extent_is_refused(size):
    with pytest.raises(ValueError, match="size_m must be finite and positive"):
        LosPrior.from_box(size)


def test_a_closed_mesh_is_taken_and_turned_outward():
    mesh = box_mesh()
    inward = replace(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1]))
    assert enclosed_volume_m3(inward.vertices, inward.faces) == pytest.approx(-0.024)
    for given in (mesh, inward):
        assert np.array_equal(LosPrior.from_mesh(given).faces, mesh.faces)


def test_an_open_mesh_is_refused_with_its_open_edges_and_a_remedy():
    mesh = box_mesh()
    with pytest.raises(UserError, match=r"box.ply: the mesh is not closed: 3 open edges") as caught:
        LosPrior.from_mesh(replace(mesh, faces=mesh.faces[1:]), where="box.ply")
    assert "box X Y Z" in str(caught.value)


def test_corners_are_farthest_and_few():
    rng = np.random.default_rng(0)
    vertices = rng.uniform(-0.1, 0.1, (2000, 3))
    prior = LosPrior(vertices=vertices, faces=np.array([[0, 1, 2]]))
    assert len(prior.corners) < 300
    for position in rng.normal(0.0, 0.5, (20, 3)):
        farthest = np.linalg.norm(vertices - position, axis=1).max()
        assert np.linalg.norm(prior.corners - position, axis=1).max() == farthest
        assert (prior.corners @ position).min() == (vertices @ position).min()
    np.testing.assert_array_equal(
        np.sort(LosPrior.from_box((1, 1, 1)).corners),
        np.sort(LosPrior.from_box((1, 1, 1)).vertices),
    )
    flat = LosPrior(vertices=np.eye(3)[:, [0, 1, 1]], faces=np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(flat.corners, flat.vertices)


def test_a_cropped_prior_is_its_bounding_box_without_walls_and_never_empty():
    wall = Wall(size_m=(0.2, 0.3, 0.4), thickness_m=0.004, permittivity=2.0)
    prior = LosPrior.from_box((0.2, 0.3, 0.4), (0.01, 0.0, -0.02), walls=(wall,))
    cropped = prior.crop(0.03)
    np.testing.assert_allclose(cropped.size_m, (0.14, 0.24, 0.34))
    np.testing.assert_allclose(cropped.center_m, prior.center_m)
    assert cropped.walls == ()
    with pytest.raises(UserError, match="below half of its shortest side, 100 mm, got 100 mm"):
        prior.crop(0.1)


@pytest.mark.parametrize("degrees", [0.0, 30.0, -44.0, 80.0])
def test_a_cuboid_knows_its_own_axes_and_sides(degrees):
    turn = np.deg2rad(degrees)
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    prior = LosPrior.from_box((0.2, 0.3, 0.4), (0.01, 0.02, 0.03), axes=axes)
    found, size, center = prior.cuboid
    np.testing.assert_allclose(center, (0.01, 0.02, 0.03))
    # Of the names of the axes those nearest to the frame's: past 45 degrees they change.
    np.testing.assert_allclose(size, (0.2, 0.3, 0.4) if degrees < 45 else (0.3, 0.2, 0.4))
    assert np.linalg.det(found) == pytest.approx(1.0)
    np.testing.assert_allclose(np.abs(found @ axes.T).max(axis=1), 1.0)


def test_other_shapes_are_no_cuboids():
    box = LosPrior.from_box((0.2, 0.3, 0.4))
    skewed = box.vertices + 0.1 * box.vertices[:, ::-1]
    assert LosPrior(vertices=skewed, faces=box.faces).cuboid is None
    pyramid = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    assert LosPrior(vertices=pyramid, faces=faces).cuboid is None


def test_assumed_faces_make_points_beyond_the_certain_part_less_likely():
    known = LosPrior.from_box((0.2, 0.3, 0.4), (0.0, 0.0, 0.1))
    part = LosPrior.from_box((0.2, 0.3, 0.2), (0.0, 0.0, 0.05))  # top at 0.15 to 0.3, bottom -0.05
    box = replace(known, certain=part.vertices)
    heights = np.array([0.1, 0.15, 0.225, 0.2999, -0.05, -0.075])
    points = np.column_stack([np.full(6, 0.05), np.zeros(6), heights])
    np.testing.assert_allclose(box.presence(points), [1, 1, 0.5, 0.05, 1, 0.5], atol=1e-9)
    np.testing.assert_array_equal(known.presence(points), 1.0)
    assert box.expected_volume_m3 == pytest.approx(0.2 * 0.3 * 0.3)
    assert known.expected_volume_m3 == pytest.approx(0.024)
    cosine, sine = np.cos(0.5), np.sin(0.5)
    turn = np.array(
        [[cosine, -sine, 0, 0.1], [sine, cosine, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1.0]]
    )
    np.testing.assert_allclose(
        box.move(turn).presence(points @ turn[:3, :3].T + turn[:3, 3]), box.presence(points)
    )
    assert known.move(turn).expected_volume_m3 == pytest.approx(0.024)
