import numpy as np
import pytest

from geraf2.echoes.glint_set import Glints
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.report.answer import answer_of
from geraf2.surfaces.pieces import (
    LIKELY,
    ghost_texts,
    likely_ghosts,
    likely_part,
    piece_numbers,
    piece_probability,
    with_probability,
)
from geraf2.surfaces.samples import SurfaceSamples
from helpers.solids import ball


def scene(planes, probability=0.9):
    """A large ball with many glints, and a small one seen from some planes."""
    large = ball(0.03)
    small = ball(0.004)
    small = TriangleMesh(vertices=small.vertices + np.array([0.0, 0.0, 0.06]), faces=small.faces)
    both = TriangleMesh.joined([large, small])
    n = len(large.vertices)
    index = np.append(np.arange(n), n + np.arange(len(planes)))
    poses = np.append(np.arange(n) % 8, planes).astype(np.int64)
    glints = Glints(
        positions=both.vertices[index],
        normals=vertex_normals(both.vertices, both.faces)[index],
        strengths=np.ones(len(index)),
        position_sigma_m=np.full(len(index), 1e-4),
        normal_sigma_rad=np.full(len(index), 0.1),
        poses=poses,
        probability=np.append(np.full(n, 0.9), np.full(len(planes), probability)),
    )
    marked = TriangleMesh(
        vertices=both.vertices,
        faces=both.faces,
        expected_error_m=np.full(len(both.vertices), 5e-4),
        evidence=np.full(len(both.vertices), 2, dtype=np.uint8),
    )
    return with_probability(marked, piece_probability(marked, glints)), n


def test_a_small_piece_exists_by_its_number_of_planes_not_of_glints():
    seen, n = scene(planes=[0, 1, 2, 3, 4, 5])
    once, _ = scene(planes=[0] * 12)
    assert (seen.confidence[:n] > 0.9).all()
    assert (seen.confidence[n:] > LIKELY).all()
    assert (once.confidence[n:] < LIKELY).all()
    doubted, _ = scene(planes=[0, 1, 2, 3, 4, 5], probability=0.2)
    assert (doubted.confidence[n:] < seen.confidence[n:]).all()


def test_a_likely_ghost_has_a_large_error_and_no_part_in_the_sizes():
    mesh, n = scene(planes=[0, 0])
    ghost = mesh.vertices[n:]
    assert np.ptp(mesh.vertices[:, 2]) > 0.09
    numbers = piece_numbers(likely_part(mesh))
    assert numbers["n_pieces"] == 1
    assert numbers["extents_mm"] == pytest.approx([60, 60, 60], abs=0.5)
    assert numbers["middle_mm"] == pytest.approx([0, 0, 0], abs=0.5)
    (piece,) = likely_ghosts(mesh)
    assert piece.numbers()["middle_mm"] == pytest.approx([0, 0, 60], abs=0.5)
    assert 0.0 < piece.probability < LIKELY
    away = np.linalg.norm(ghost, axis=1) - 0.03
    expected = np.sqrt(piece.probability * 5e-4**2 + (1 - piece.probability) * away**2)
    assert mesh.expected_error_m[n:] == pytest.approx(expected, rel=0.05)
    assert mesh.expected_error_m[:n] == pytest.approx(5e-4)
    samples = SurfaceSamples(mesh, np.zeros((4, len(mesh.vertices))), 1e-4)
    assert samples.size_numbers()["extents_mm"] == pytest.approx([60, 60, 60], abs=0.5)


def test_the_report_lists_likely_ghosts_separately():
    mesh, _ = scene(planes=[0, 0])
    stage = {"likely_ghosts": [piece.numbers() for piece in likely_ghosts(mesh)]}
    answer = answer_of(mesh, None, {"mesh": stage}, {})
    assert answer.found.startswith("One body, 60 x 60 x 60 mm, its middle at (0, 0, 0) mm.")
    assert f"Likely ghosts, not counted: {ghost_texts(stage)[0]}." in answer.found
    assert {card.title: card.value for card in answer.cards}["How sure"] == "0.5 mm"


def test_confidence_is_read_back_only_from_own_files(tmp_path):
    mesh, n = scene(planes=[0, 0])
    write_mesh(mesh, tmp_path / "m.ply")
    again = read_mesh(tmp_path / "m.ply")
    assert again.confidence == pytest.approx(mesh.confidence, abs=1e-6)
    assert len(likely_part(again).vertices) == n
    data = (tmp_path / "m.ply").read_bytes()
    (tmp_path / "other.ply").write_bytes(data.replace(b"uchar evidence", b"uchar elsewise"))
    assert read_mesh(tmp_path / "other.ply").confidence is None
