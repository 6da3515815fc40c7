"""The F1 that a surface is stated to have, against draws of its errors."""

import numpy as np
import pytest

from geraf2.geometry.triangles import vertex_areas
from geraf2.surfaces.stated_score import ELSEWHERE, LOG_SCALE, SIGMA, THRESHOLD_M, stated_f1
from helpers.solids import ball


def surface(seed=0, median_m=0.002):
    errors = median_m * np.exp(np.random.default_rng(seed).normal(size=642))
    return ball(0.03, expected_error_m=errors)


def drawn_scores(mesh, failure, n=4000):
    """Scores of surfaces whose errors are as expected, up to a factor, and of failed runs."""
    rng, scores = np.random.default_rng(1), []
    areas = vertex_areas(mesh.vertices, mesh.faces)
    while len(scores) < n:
        if rng.random() < failure:
            scores.append(0.5 * rng.random() * (rng.random() > ELSEWHERE))
            continue
        score = 0.0
        while score < 0.5:
            off = (
                np.exp(LOG_SCALE + SIGMA * rng.normal())
                * mesh.expected_error_m
                * rng.normal(size=642)
            )
            score = areas[np.abs(off) < THRESHOLD_M].sum() / areas.sum()
        scores.append(score)
    return np.array(scores)


@pytest.mark.parametrize("failure", [0.0, 0.03, 0.3, 0.9])
def test_it_is_the_median_and_90_percent_of_what_may_be(failure):
    mesh = surface()
    expected = np.quantile(drawn_scores(mesh, failure), [0.05, 0.5, 0.95])
    assert stated_f1(mesh, failure) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("median_m", [1e-9, 1e-3, 1.0])
@pytest.mark.parametrize("failure", [0.0, 0.5, 1.0])
def test_it_is_between_0_and_1_and_falls_with_the_probability_of_failure(median_m, failure):
    low, middle, high = stated_f1(surface(median_m=median_m), failure)
    assert 0.0 <= low <= middle <= high <= 1.0
    assert low <= stated_f1(surface(median_m=median_m), 0.0)[0]
