import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from geraf2.evaluation import evaluate_mesh
from geraf2.evaluation.alignment import rigid_alignment
from geraf2.evaluation.mesh_metrics import sample_surface
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import LosPrior
from helpers import solids


def test_a_motion_is_found_again_and_wrong_parts_do_not_turn_it():
    box = LosPrior.from_box((0.1, 0.06, 0.04)).mesh
    points = sample_surface(box, 4000, np.random.default_rng(0))
    turn, shift = Rotation.from_rotvec([0.02, -0.03, 0.04]), np.array([1e-3, 2e-3, -1.5e-3])
    moved = turn.apply(points) + shift
    wrong = np.concatenate([moved, np.random.default_rng(1).normal(0.3, 0.02, (300, 3))])
    fine = solids.triangles(trimesh.creation.box((0.1, 0.06, 0.04)))
    true = sample_surface(fine, 40_000, np.random.default_rng(2))
    # Normals of a box: the axis on whose face a point lies.
    axis = np.argmax(np.abs(true) / [0.05, 0.03, 0.02], axis=1)
    normals = np.eye(3)[axis] * np.sign(true[np.arange(len(true)), axis])[:, None]
    back = rigid_alignment(wrong, true, normals).apply(moved)
    assert np.abs(back - points).max() < 2e-4


def test_an_offset_of_the_frame_leaves_the_aligned_coverage():
    ball = solids.ball(0.05, 4)
    bumps = 1e-3 * np.sin(60.0 * ball.vertices[:, 0])
    truth = TriangleMesh(
        vertices=ball.vertices + bumps[:, None] * vertex_normals(ball.vertices, ball.faces),
        faces=ball.faces,
    )
    shifted = solids.ball(
        0.05, 4, middle=(4e-3, 0.0, 0.0), expected_error_m=np.full(len(ball.vertices), 1e-3)
    )
    metrics = evaluate_mesh(shifted, truth, n_samples=4000)
    assert metrics.expected_error.within_one < 0.6
    assert metrics.expected_error_aligned.within_one > 0.9
    assert evaluate_mesh(ball, truth, n_samples=500).expected_error_aligned is None
    assert metrics.expected_error_aligned.within_two == pytest.approx(1.0, abs=0.02)
