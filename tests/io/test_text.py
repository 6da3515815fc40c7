"""JSON and TOML from strangers: one parser each, whose errors its callers catch."""

import re


def test_json_and_toml_are_parsed_in_one_module_each(project_root):
    """Which bound the depth; a parser's own error for it is none that a reader catches."""
    found = {
        (path.name, word)
        for path in (project_root / "python").rglob("*.py")
        for word in ("json.loads(", "json.load(", "tomllib.loads(", "tomllib.load(")
        if re.search(rf"(?<!parse_){re.escape(word)}", path.read_text())
    }
    assert found == {("text.py", "json.loads("), ("toml.py", "tomllib.loads(")}
