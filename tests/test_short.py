import numpy as np
import pytest

import geraf2
from geraf2.evaluation import evaluate_mesh
from helpers.solids import ball


def test_what_holds_arrays_has_a_short_text():
    mesh = ball(0.03)
    assert repr(mesh).startswith("TriangleMesh(vertices=642 x 3 float64, faces=1280 x 3 int64")
    assert len(repr(mesh)) < 200
    result = geraf2.examples.small_run()
    for found in (result.glints, result.sdf, result.samples(2)):
        assert "array" not in repr(found)
        assert len(repr(found)) < 400


def test_scores_are_short_and_f1_takes_any_threshold():
    metrics = evaluate_mesh(ball(0.030), ball(0.031), n_samples=2000)
    assert repr(metrics).startswith("MeshMetrics(F1 15 mm 1.000, F1 5 mm 1.000")
    assert len(repr(metrics)) < 200
    values = [metrics.f1(t) for t in (0.0005, 0.0012, 0.002, 0.005, 0.0123)]
    assert values == sorted(values)
    assert values[-1] == 1.0
    for score in metrics.scores:
        assert metrics.f1(score.threshold_m) == score.f1
    assert "distances_m" not in metrics.to_dict()
    with pytest.raises(ValueError, match="threshold_m"):
        metrics.f1(-1.0)


def test_a_cube_is_one_side():
    cube = geraf2.LosPrior.from_box(0.16)
    np.testing.assert_allclose(cube.size_m, (0.16, 0.16, 0.16))
    with pytest.raises(ValueError, match="size_m"):
        geraf2.LosPrior.from_box(-0.1)


def test_a_preset_is_given_by_name():
    with pytest.raises(geraf2.UserError, match="unknown preset 'fastt'"):
        geraf2.reconstruct(geraf2.examples.small_capture()[0], preset="fastt")
