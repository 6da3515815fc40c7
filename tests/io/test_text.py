"""JSON and TOML from strangers: one parser each, whose errors its callers catch."""

import re

import pytest

from geraf2.io.text import parse_json
from geraf2.io.toml import parse_toml


def test_json_and_toml_are_parsed_in_one_module_each(project_root):
    """Which bound the depth; a parser's own error for it is none that a reader catches."""
    found = {
        (path.name, word)
        for path in (project_root / "python").rglob("*.py")
        for word in ("json.loads(", "json.load(", "tomllib.loads(", "tomllib.load(")
        if re.search(rf"(?<!parse_){re.escape(word)}", path.read_text())
    }
    assert found == {("text.py", "json.loads("), ("toml.py", "tomllib.loads(")}


@pytest.mark.parametrize("text", ["[" * 10_000, '{"a":' * 10_000, "NaN", "[-Infinity]", "1e999"])
def test_json_that_is_deep_or_not_finite_is_a_value_error(text):
    with pytest.raises(ValueError, match=r"nested too deep|no finite number"):
        parse_json(text)


@pytest.mark.parametrize(
    "text", ["a=" + "[" * 900 + "]" * 900, "[" + ".".join("a" * 99_999) + "]", '"a".' * 40 + "a=1"]
)
def test_toml_that_is_deep_is_a_value_error(text):
    with pytest.raises(ValueError, match="more than 32 levels"):
        parse_toml(text)
