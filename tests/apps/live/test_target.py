"""Target of a scan: forms of its text, and when a surface meets it."""

from types import SimpleNamespace

import numpy as np
import pytest

from geraf2.apps.live.target import Target
from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh

# Two triangles apart, the second with nine times the area.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 3, 0]], float)
FACES = np.array([[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("expected 1 mm over 90 %", Target(error_m=0.001, share=0.9)),
        (" expected  2.5 mm over 50%", Target(error_m=0.0025, share=0.5)),
    ],
)
def test_a_target_is_read(text, wanted):
    assert Target.of(text) == wanted
    assert Target.of(wanted) is wanted


@pytest.mark.parametrize(
    "text",
    [
        "",
        "F1 5 mm 0.9",
        "expected 1 m over 90 %",
        "expected 0 mm over 9 %",
        "expected 1 mm over 0%",
    ],
)
def test_another_text_is_no_target(text):
    with pytest.raises(UserError, match="is no target of a scan"):
        Target.of(text)


@pytest.mark.parametrize(("share", "is_met"), [(50, True), (89, True), (95, False)])
def test_a_target_is_met_where_the_error_is_kept_on_the_share_of_the_area(share, is_met):
    errors_m = np.array([0.010] * 3 + [0.001] * 3)
    mesh = TriangleMesh(vertices=VERTICES, faces=FACES, expected_error_m=errors_m)
    found = Target.of(f"expected 2 mm over {share} %").is_met(SimpleNamespace(content_mesh=mesh))
    assert found == is_met
