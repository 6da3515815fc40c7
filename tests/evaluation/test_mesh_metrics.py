from functools import partial

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.evaluation import evaluate_mesh, sample_surface
from geraf2.io.mesh import Evidence, TriangleMesh
from helpers import solids
from reference import mesh_metrics as twin

sphere = partial(solids.ball, subdivisions=4)


def square(side, height):
    corners = np.array([[0, 0, height], [side, 0, height], [side, side, height], [0, side, height]])
    return TriangleMesh(vertices=corners.astype(float), faces=np.array([[0, 1, 2], [0, 2, 3]]))


def test_whole_evaluation_agrees_with_the_slow_twin_on_the_same_samples():
    mesh, truth = sphere(0.052, subdivisions=2), sphere(0.05, subdivisions=2)
    metrics = evaluate_mesh(mesh, truth, n_samples=150, seed=7, thresholds_m=(0.004,))
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(7).spawn(2)]
    on_mesh = sample_surface(mesh, 150, streams[0])
    on_truth = sample_surface(truth, 150, streams[1])
    assert metrics.chamfer_1e3_m2 == pytest.approx(1e3 * twin.chamfer(on_mesh, on_truth))
    assert metrics.f1(0.004) == pytest.approx(twin.f1(on_mesh, on_truth, 0.004)[2])


def test_vertices_without_a_triangle_are_no_extent_and_an_open_surface_has_no_volume():
    ball = sphere(0.05, subdivisions=2)
    far = TriangleMesh(vertices=np.vstack([ball.vertices, [[1.0, 0, 0]]]), faces=ball.faces)
    assert evaluate_mesh(far, ball, n_samples=50).size.extent_errors_m == (0.0, 0.0, 0.0)
    for pair in ((square(0.1, 0.0), ball), (ball, square(0.1, 0.0))):
        metrics = evaluate_mesh(*pair, n_samples=50)
        assert metrics.size.volume_ratio is None
        assert "volume_ratio" not in metrics.headline()


def test_concentric_spheres_are_their_difference_of_radii_apart():
    gap = 0.004
    metrics = evaluate_mesh(sphere(0.05 + gap), sphere(0.05))
    # The icosphere's facets lie up to 0.05 (1 - cos(2 deg)) = 3e-5 m inside the sphere.
    assert metrics.surface_bias_m == pytest.approx(gap, abs=3e-5)
    assert metrics.surface_mesh_to_truth.median_m == pytest.approx(gap, abs=3e-5)
    assert metrics.surface_mesh_to_truth.p95_m == pytest.approx(gap, abs=6e-5)
    assert metrics.surface_truth_to_mesh.median_m == pytest.approx(gap, abs=3e-5)
    # Nearest samples lie sideways of the foot point; with density n / A the mean square of that
    # offset is A / (pi n), so each direction gives gap^2 + A / (pi n) (times (1 + gap / r) for
    # distances measured from the other radius, left inside the 3 % tolerance).
    n, radius = 10000, 0.05
    spread = 4 * radius**2 / n
    expected = 1e3 * 2 * (gap**2 + spread * (1 + gap / radius))
    assert metrics.chamfer_1e3_m2 == pytest.approx(expected, rel=0.03)
    assert metrics.f1(0.005) == pytest.approx(1.0, abs=0.002)
    assert metrics.f1(0.003) == 0.0


def test_shifted_squares_have_the_shift_as_exact_distance_and_no_bias():
    metrics = evaluate_mesh(square(0.1, 0.002), square(0.1, 0.0), n_samples=2000)
    assert metrics.surface_mesh_to_truth.median_m == pytest.approx(0.002, abs=1e-9)
    assert metrics.surface_mesh_to_truth.max_m == pytest.approx(0.002, abs=1e-9)
    assert metrics.surface_bias_m is None  # an open truth has no outside
    assert not metrics.truth.is_watertight


def test_precision_and_recall_distinguish_missing_from_false():
    half = TriangleMesh(
        vertices=square(0.1, 0.0).vertices * [0.5, 1, 1], faces=square(0.1, 0.0).faces
    )
    metrics = evaluate_mesh(half, square(0.1, 0.0), thresholds_m=(0.005,))
    (score,) = metrics.scores
    assert score.precision == 1.0
    # 5 mm beyond the half count as matched: (0.05 + 0.005) / 0.1, less the samples' spacing
    assert score.recall == pytest.approx(0.55, abs=0.02)
    assert score.f1 == pytest.approx(2 * score.recall / (1 + score.recall))


def test_a_surface_against_itself_reaches_the_floor_and_not_zero():
    truth = sphere(0.05)
    metrics = evaluate_mesh(truth, truth)
    # P(d > tau) = exp(-pi density tau^2) = 1.2e-4 of the samples have no neighbour
    assert metrics.f1(0.003) == pytest.approx(1.0, abs=5e-4)
    # E[d^2] = A / (pi n) in each direction
    assert metrics.chamfer_1e3_m2 == pytest.approx(1e3 * 2 * 4 * 0.05**2 / 10000, rel=0.05)
    assert metrics.floor_chamfer_1e3_m2 == pytest.approx(metrics.chamfer_1e3_m2, rel=0.05)
    # Rayleigh median: sqrt(ln 2 / (pi density))
    assert metrics.floor_median_m == pytest.approx(np.sqrt(np.log(2) * 4 * 0.05**2 / 1e4), rel=0.03)
    assert metrics.surface_mesh_to_truth.max_m < 1e-6


def test_samples_are_uniform_by_area():
    tall = TriangleMesh(
        vertices=np.array(
            [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 1, 0]], float
        ),
        faces=np.array([[0, 1, 2], [3, 4, 5]]),
    )
    points = sample_surface(tall, 40000, np.random.default_rng(0))
    on_second = points[:, 0] > 4
    # areas 0.5 and 1.5; standard error of the share is 0.0022
    assert on_second.mean() == pytest.approx(0.75, abs=0.01)
    first = points[~on_second]
    np.testing.assert_allclose(first.mean(axis=0), [1 / 3, 1 / 3, 0], atol=0.01)
    assert (first[:, 0] + first[:, 1]).max() <= 1.0


@pytest.mark.parametrize(("stated_m", "one", "two"), [(6e-3, 1, 1), (3e-3, 0, 1)])
def test_expected_errors_are_compared_with_true_ones(stated_m, one, two):
    ball = sphere(0.05)
    bumped = ball.vertices.copy()
    upper = bumped[:, 2] > 0
    bumped[upper] *= 1.1  # 5 mm off
    mesh = TriangleMesh(
        vertices=bumped,
        faces=ball.faces,
        expected_error_m=np.where(upper, stated_m, 1e-3),
        evidence=np.where(upper, Evidence.NOT_SEEN, Evidence.SEEN).astype(np.uint8),
    )
    held = evaluate_mesh(mesh, ball).expected_error
    # 1.21 of 2.21 parts of the area are 5 mm off; between lies a strip of one triangle's height
    assert held.within_one == pytest.approx((1 + 1.21 * one) / 2.21, abs=0.03)
    assert held.within_two == pytest.approx((1 + 1.21 * two) / 2.21, abs=0.05)
    assert [part.evidence for part in held.parts] == ["seen", "not seen"]
    seen, guessed = held.parts
    assert guessed.area_fraction == pytest.approx(1.21 / 2.21, abs=0.03)
    assert guessed.median_m == pytest.approx(0.005, abs=2e-4)
    assert guessed.expected_m == pytest.approx(stated_m, rel=1e-6)
    assert guessed.within_one == pytest.approx(one, abs=0.05)
    assert seen.median_m < 2e-4
    assert seen.within_one > 0.94
    assert held.rank_correlation > 0.6


def test_an_empty_mesh_is_a_user_error():
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(UserError, match="the mesh has no surface"):
        evaluate_mesh(empty, sphere(0.05))
