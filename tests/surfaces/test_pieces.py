from dataclasses import replace

import numpy as np
import pytest

from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.report.answer import answer_of
from geraf2.surfaces.pieces import (
    LIKELY,
    ghost_texts,
    piece_numbers,
    pieces_of,
    separate_pieces,
)
from helpers.glint_sets import glints_at, glints_on_sphere
from helpers.solids import ball


def scene(planes, probability=0.9, radius_m=0.004):
    """A large ball with many glints, and a small one seen from some planes."""
    large = ball(0.03)
    small = ball(radius_m)
    small = TriangleMesh(vertices=small.vertices + np.array([0.0, 0.0, 0.06]), faces=small.faces)
    both = TriangleMesh.joined([large, small])
    n = len(large.vertices)
    index = np.append(np.arange(n), n + np.arange(len(planes)))
    poses = np.append(np.arange(n) % 8, planes).astype(np.int64)
    normals = vertex_normals(both.vertices, both.faces)[index]
    sure = {"position_sigma_m": 1e-4, "normal_sigma_rad": 0.1}
    glints = glints_at(both.vertices[index], normals, poses=poses, **sure)
    glints.probability[:] = np.append(np.full(n, 0.9), np.full(len(planes), probability))
    return separate_pieces(both, glints), n


def test_a_small_piece_exists_by_its_number_of_planes_not_of_glints():
    seen, n = scene(planes=[0, 1, 2, 3, 4, 5] * 2)
    assert not len(seen.ghosts.faces)
    assert (seen.content.confidence[:n] > 0.9).all()
    assert (seen.content.confidence[n:] > LIKELY).all()
    once, _ = scene(planes=[0] * 12)
    assert len(once.content.vertices) == n
    assert (once.ghosts.confidence < LIKELY).all()
    doubted, _ = scene(planes=[0, 1, 2, 3, 4, 5] * 2, probability=0.05)
    assert doubted.ghosts.confidence.max() < seen.content.confidence.min()


def test_a_likely_ghost_is_apart_with_its_position_and_probability():
    found, _n = scene(planes=[0] * 12)
    numbers = piece_numbers(found.content)
    assert numbers["n_pieces"] == 1
    assert numbers["extents_mm"] == pytest.approx([60, 60, 60], abs=0.5)
    assert numbers["center_mm"] == pytest.approx([0, 0, 0], abs=0.5)
    (piece,) = pieces_of(found.ghosts)
    assert piece.numbers()["center_mm"] == pytest.approx([0, 0, 60], abs=0.5)
    assert piece.numbers()["volume_cm3"] == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=0.05)
    assert 0.0 < piece.probability < LIKELY


@pytest.mark.parametrize(("planes", "radius_m"), [([], 0.004), ([0, 1, 2, 3] * 4, 0.002)])
def test_points_and_pieces_without_glints_are_in_neither(planes, radius_m):
    both, _ = scene(planes=planes, radius_m=radius_m)
    assert not len(both.ghosts.faces)
    assert len(pieces_of(both.content)) == 1


def test_voids_are_in_neither():
    shell, glints = ball(0.03), glints_on_sphere(0.03, 200)
    inner = ball(0.02)
    void = TriangleMesh(vertices=inner.vertices, faces=inner.faces[:, ::-1])
    found = separate_pieces(TriangleMesh.joined([shell, void]), glints)
    assert len(found.content.faces) == len(shell.faces)
    assert not len(found.ghosts.faces)


@pytest.mark.parametrize(("n_on_other", "n_kept"), [(12, 1), (80, 2)])
def test_a_large_piece_with_few_glints_bridges_air(n_on_other, n_kept):
    well, other = ball(0.02), ball(0.022)
    moved = TriangleMesh(vertices=other.vertices - [0.06, 0.0, 0.0], faces=other.faces)
    glints = glints_on_sphere(0.02, 400).join(
        glints_on_sphere(0.022, n_on_other, center=[-0.06, 0, 0])
    )
    glints = replace(glints, poses=np.arange(len(glints)) % 8)
    found = separate_pieces(TriangleMesh.joined([well, moved]), glints)
    assert len(pieces_of(found.content)) == n_kept
    # The piece with most glints stays, though the other one is larger.
    assert found.content.vertices[:, 0].max() > 0.019


def test_the_report_lists_likely_ghosts_separately():
    found, _ = scene(planes=[0] * 12)
    stage = {"likely_ghosts": [piece.numbers() for piece in pieces_of(found.ghosts)]}
    answer = answer_of(found.content, None, {"mesh": stage}, {})
    assert answer.found.startswith("One body, 60 x 60 x 60 mm, its centre at (0, 0, 0) mm.")
    assert f"Likely ghosts, not counted: {ghost_texts(stage)[0]}." in answer.found
