"""Score that a surface is stated to have: closed forms, and the target of a scan."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from geraf2.apps.live.target import Target
from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh
from geraf2.surfaces.stated_score import StatedScore, kept_share, log_odds, stated_f1

# Two triangles apart, the second with nine times the area.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 3, 0]], float)
FACES = np.array([[0, 1, 2], [3, 4, 5]])


def _mesh(errors_m):
    return TriangleMesh(vertices=VERTICES, faces=FACES, expected_error_m=np.array(errors_m))


def test_the_share_is_that_of_the_area_within_tau():
    mesh = _mesh([0.005] * 3 + [0.010] * 3)
    one, half = (norm.cdf(d) - norm.cdf(-d) for d in (1.0, 0.5))
    assert kept_share(mesh) == pytest.approx(0.1 * one + 0.9 * half)
    assert kept_share(_mesh([0.0] * 6)) == pytest.approx(1.0)
    assert kept_share(mesh, 0.010) > kept_share(mesh)


def test_the_score_is_normal_on_the_scale_of_its_odds():
    stated = StatedScore(median=0.8, sigma=0.5)
    assert stated.odds(0.8) == pytest.approx(0.5)
    low, high = stated.interval
    assert low < 0.8 < high
    assert stated.odds(low) == pytest.approx(0.95, abs=1e-4)
    assert stated.odds(high) == pytest.approx(0.05, abs=1e-4)
    # 84 % lie above one standard deviation below the median.
    assert stated.odds(1.0 / (1.0 + np.exp(0.5 - log_odds(0.8)))) == pytest.approx(0.8413, abs=1e-4)
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
