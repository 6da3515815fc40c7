"""What the scripts in tools/ state: the oldest dependencies, planted bugs."""

import importlib.util
import re
import tomllib
from dataclasses import replace

import pytest


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_oldest_dependencies_are_the_bounds_of_pyproject(project_root):
    project = tomllib.loads((project_root / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"].values()
    bounds = dict(
        re.fullmatch(r"([\w.-]+)>=([\d.]+)", requirement).groups()
        for requirement in [*project["dependencies"], *(one for extra in extras for one in extra)]
    )
    lines = (project_root / "tools" / "oldest.txt").read_text().splitlines()
    assert dict(line.split("==") for line in lines) == bounds


def test_the_line_of_each_planted_bug_is_unique_in_the_kernels(project_root):
    planted_bugs = load(project_root / "tools" / "planted_bugs.py")
    for bug in planted_bugs.BUGS.values():
        right = (project_root / "cpp" / "src" / bug.file).read_text(encoding="utf-8")
        wrong = planted_bugs.planted(right, bug)
        assert planted_bugs.planted(wrong, replace(bug, right=bug.wrong, wrong=bug.right)) == right
        with pytest.raises(ValueError, match="occurs 0 times"):
            planted_bugs.planted(wrong, bug)
