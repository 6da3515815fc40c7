import numpy as np
import pytest

from geraf2.ops.pair_density import PairModel, PeakPoints, pair_densities
from reference import pair_density as twin

MODEL = {
    "reach": 0.02,
    "least_cosine": 0.5,
    "spread": 0.011,
    "offset_variance": 4e-6,
    "bend": 60.0,
    "turn_variance": 0.125,
    "curvature": 8.0,
    "least_density": 10.0,
}


def points_of(n, seed, size_m=0.05, shift_m=0.0):
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((n, 3)) * 0.5 + [0.0, 0.0, 1.0]
    return PeakPoints(
        rng.uniform(-size_m, size_m, (n, 3)) * [1.0, 1.0, 0.1] + shift_m,
        normals / np.linalg.norm(normals, axis=1)[:, None],
        rng.integers(0, 3, n),
        rng.integers(0, 20, n),
    )


@pytest.mark.parametrize("shift_m", [0.0, 3.0, -2e5])
def test_densities_are_those_of_the_twin(shift_m):
    points, others = points_of(150, 1, shift_m=shift_m), points_of(200, 2, shift_m=shift_m)
    expected = twin.matrix(points, others, MODEL)
    found = pair_densities(points, others, PairModel(**MODEL)).toarray()
    assert (expected > 0.0).sum() > 500
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_point_predicts_another_as_that_predicts_it():
    points = points_of(100, 3)
    dense = pair_densities(points, points, PairModel(**MODEL)).toarray()
    for part in np.hsplit(dense, 2):
        np.testing.assert_allclose(part, part.T, rtol=1e-12)
        assert not part.diagonal().any()  # of one sub-aperture


def test_empty_single_and_strided_points():
    many, none = points_of(40, 4), points_of(0, 0)
    model = PairModel(**MODEL)
    assert pair_densities(none, many, model).shape == (0, 80)
    assert pair_densities(many, none, model).shape == (40, 0)
    whole = pair_densities(many, many, model).toarray()
    turned = PeakPoints(np.asfortranarray(many.positions), *many[1:])
    assert np.array_equal(pair_densities(turned, many, model).toarray(), whole)
    assert np.array_equal(pair_densities(many.rows(7, 8), many, model).toarray(), whole[7:8])


def test_what_cannot_be_is_refused():
    points, model = points_of(5, 5), PairModel(**MODEL)
    with pytest.raises(ValueError, match=r"others.positions must be finite"):
        pair_densities(points, points._replace(positions=points.positions * np.nan), model)
    with pytest.raises(ValueError, match=r"points.normals must have shape \(5, 3\)"):
        pair_densities(points._replace(normals=points.normals[:4]), points, model)
