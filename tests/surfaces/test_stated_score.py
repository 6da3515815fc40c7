"""Score that a surface is stated to have: closed forms, and the target of a scan."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from geraf2.apps.live.target import Target
from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh
from geraf2.surfaces.stated_score import stated_f1

# Two triangles apart, the second with nine times the area.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 3, 0]], float)
FACES = np.array([[0, 1, 2], [3, 4, 5]])


def _mesh(errors_m):
    return TriangleMesh(vertices=VERTICES, faces=FACES, expected_error_m=np.array(errors_m))


def test_the_median_is_the_share_of_the_area_within_tau():
    mesh = _mesh([0.005] * 3 + [0.010] * 3)
    one, half = (norm.cdf(d) - norm.cdf(-d) for d in (1.0, 0.5))
    # Expected errors are rounded to 2 %, which changes such a share by less than 0.006.
    assert stated_f1(mesh).median == pytest.approx(0.1 * one + 0.9 * half, abs=0.006)
    assert stated_f1(_mesh([0.0] * 6)).median == pytest.approx(1.0)
    assert stated_f1(mesh, 0.010).median > stated_f1(mesh).median


def test_quantiles_of_the_score_are_those_of_the_factor_of_all_errors():
    stated = stated_f1(_mesh([0.003] * 6))
    low, high = stated.interval
    for score, deviations in ((low, 1.645), (high, -1.645)):
        error_m = 0.003 * np.exp(deviations * stated.sigma)
        assert score == pytest.approx(1.0 - 2.0 * norm.sf(0.005 / error_m), abs=0.006)
    assert stated.odds(stated.median) == pytest.approx(0.5)
    assert stated.odds(low) == pytest.approx(0.95, abs=1e-3)
    assert stated.odds(high) == pytest.approx(0.05, abs=1e-3)
    assert stated.odds(1.0) < 1e-4
    assert stated.odds(0.0) > 0.9999


def test_a_target_score_is_met_when_it_is_nine_times_as_likely_as_not():
    """The more so, the smaller the expected errors are."""
    met = []
    for error_m in (0.0005, 0.001, 0.002, 0.003, 0.004, 0.006):
        mesh = _mesh([error_m] * 6)
        result = SimpleNamespace(content_mesh=mesh)
        met.append(Target.of("F1 5 mm 0.9").is_met(result))
        assert met[-1] == (stated_f1(mesh).odds(0.9) >= 0.9)
    assert met[0]
    assert not met[-1]
    assert met == sorted(met, reverse=True)


def test_a_surface_without_expected_errors_states_nothing():
    with pytest.raises(UserError, match="does not state its expected error"):
        stated_f1(TriangleMesh(vertices=VERTICES, faces=FACES))


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("expected 1 mm over 90 %", Target(error_m=0.001, share=0.9)),
        (" expected  2.5 mm over 50%", Target(error_m=0.0025, share=0.5)),
        ("F1 5 mm 0.95", Target(share=0.95)),
        ("F1 5 mm .9", Target(share=0.9)),
    ],
)
def test_a_target_is_read(text, wanted):
    assert Target.of(text) == wanted
    assert Target.of(wanted) is wanted


@pytest.mark.parametrize(
    "text", ["", "F1 0.9", "F1 2 mm 0.9", "F1 5 mm 0", "F1 5 mm 1.2", "expected 1 m over 90 %"]
)
def test_another_text_is_no_target(text):
    with pytest.raises(UserError, match="is no target of a scan"):
        Target.of(text)
