"""Texts that are targets of a scan."""

import pytest

from geraf2.apps.live.target import Target
from geraf2.errors import UserError


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
