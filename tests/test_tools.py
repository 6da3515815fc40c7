"""The scripts in tools/: limits of size, the table of coverage, the oldest dependencies."""

import importlib.util
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def check_files(project_root):
    return load(project_root / "tools" / "check_files.py")


def function(n_lines, docstring=""):
    """Source of a function of n_lines, its docstring not counted."""
    return f"def f():\n{docstring}" + "    x = 1\n" * (n_lines - 1)


@pytest.mark.parametrize("docstring", ["", '    """One\n\n    two\n    three.\n    """\n'])
def test_a_function_is_measured_without_its_docstring(check_files, docstring):
    path, limit = Path("python/geraf2/a.py"), check_files.MAX_FUNCTION_LINES
    assert not list(check_files.longer(path, function(limit, docstring)))
    found = list(check_files.longer(path, function(limit + 1, docstring)))
    assert found == [("f()", limit + 1, limit)]


@pytest.mark.parametrize("folder", ["io", "cli"])
def test_a_file_of_the_command_line_has_the_lower_limit(check_files, folder):
    path = Path("python/geraf2") / folder / "a.py"
    limit = {"io": check_files.MAX_PACKAGE_LINES, "cli": check_files.MAX_CLI_LINES}[folder]
    assert not list(check_files.size_complaints(path, "x = 1\n" * limit))
    (complaint,) = check_files.size_complaints(path, "x = 1\n" * (limit + 1))
    assert f"a.py has {limit + 1} lines, limit {limit}" in complaint


def test_the_table_of_coverage_sums_by_package(project_root):
    tool = load(project_root / "tools" / "coverage_table.py")

    def file(n_lines, covered):
        return {"summary": {"num_statements": n_lines, "covered_lines": covered}}

    files = {
        "python/geraf2/errors.py": file(10, 10),
        "python/geraf2/io/a.py": file(30, 15),
        "python/geraf2/io/b.py": file(10, 5),
        "python/geraf2/io/raw/c.py": file(50, 10),
    }
    rows = [row.split() for row in tool.table({"files": files})[1:]]
    assert rows == [
        ["io/raw", "50", "20.0%"],
        ["io", "40", "50.0%"],
        ["geraf2", "10", "100.0%"],
        ["all", "100", "40.0%"],
    ]


def test_the_oldest_dependencies_are_the_bounds_of_pyproject(project_root):
    project = tomllib.loads((project_root / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"].values()
    bounds = dict(
        re.fullmatch(r"([\w.-]+)>=([\d.]+)", requirement).groups()
        for requirement in [*project["dependencies"], *(one for extra in extras for one in extra)]
    )
    lines = (project_root / "tools" / "oldest.txt").read_text().splitlines()
    assert dict(line.split("==") for line in lines) == bounds


def test_the_place_of_each_planted_bug_is_unique_in_the_kernels(project_root):
    planted_bugs = load(project_root / "tools" / "planted_bugs.py")
    for bug in planted_bugs.BUGS.values():
        right = (project_root / "cpp" / "src" / bug.file).read_text(encoding="utf-8")
        wrong = planted_bugs.planted(right, bug)
        assert planted_bugs.planted(wrong, replace(bug, right=bug.wrong, wrong=bug.right)) == right
        with pytest.raises(ValueError, match="occurs 0 times"):
            planted_bugs.planted(wrong, bug)
