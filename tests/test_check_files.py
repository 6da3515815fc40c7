"""tools/check_files.py: what it finds too long."""

import importlib.util
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def check_files(project_root):
    path = project_root / "tools" / "check_files.py"
    spec = importlib.util.spec_from_file_location("check_files", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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


def test_an_exemption_without_need_is_reported(check_files, project_root, monkeypatch):
    if not (project_root / "python").is_dir():
        pytest.skip("needs the package's sources")
    paths = [path.relative_to(project_root) for path in project_root.glob("python/**/*.py")]
    assert not check_files.needless(paths)
    monkeypatch.setitem(check_files.LONGER, "no_such_file.py", "test")
    assert check_files.needless(paths) == {"no_such_file.py"}
