"""The package as a whole: import time, stubs, layers."""

import ast
import graphlib
import re
import subprocess
import sys

import pytest

from geraf2.ops.simd import VECTOR_KERNELS, kernel_paths

HEAVY = ("torch", "matplotlib", "trimesh", "zarr")


def _run_python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_takes_less_than_two_seconds():
    # The clock starts inside the interpreter: its own start is not the package's. The best of
    # three, because the first may read the files from a cold disk.
    code = (
        "import time; start = time.perf_counter(); import geraf2; "
        "print(time.perf_counter() - start)"
    )
    assert min(float(_run_python(code)) for _ in range(3)) < 2.0


def test_import_leaves_heavy_packages_out():
    code = f"import geraf2, sys; print([name for name in {HEAVY} if name in sys.modules])"
    assert _run_python(code).strip() == "[]"


def _stub_names(tree: ast.Module) -> set[str]:
    names = set()
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return {name for name in names if not name.startswith("_")}


def test_stub_names_are_those_of_the_built_module(project_root):
    from geraf2 import _core  # noqa: PLC0415, TID251 - the stub of this very module is checked

    stub = project_root / "python" / "geraf2" / "_core.pyi"
    stub_names = _stub_names(ast.parse(stub.read_text(encoding="utf-8")))
    built_names = {name for name in dir(_core) if not name.startswith("_")}
    assert stub_names == built_names


def test_stub_names_see_a_difference():
    assert _stub_names(ast.parse("def f() -> int: ...\nx: int\nclass C: ...\n_p: int")) == {
        "f", "x", "C",
    }  # fmt: skip


def test_imports_respect_the_layers(project_root):
    pytest.importorskip("importlinter", reason="import-linter is not installed")
    done = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()",
         "--no-cache"],
        cwd=project_root, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


def _ops_imported(source: str) -> set[str]:
    """Modules of `geraf2.ops` that are imported anywhere, also inside functions."""
    modules = [n.module or "" for n in ast.walk(ast.parse(source)) if isinstance(n, ast.ImportFrom)]
    return {name.removeprefix("geraf2.ops.") for name in modules if name.startswith("geraf2.ops.")}


def test_imports_of_ops_do_not_go_in_circles(project_root):
    paths = (project_root / "python" / "geraf2" / "ops").glob("*.py")
    graph = {path.stem: _ops_imported(path.read_text(encoding="utf-8")) for path in paths}
    assert "_matched_filter_torch" in graph["matched_filter"]  # imported in a function
    graphlib.TopologicalSorter(graph).prepare()  # CycleError names the circle


def test_every_kernel_of_several_instruction_sets_is_named(project_root):
    """`geraf2 doctor` says which path each takes: none may be forgotten."""
    build = (project_root / "cpp" / "CMakeLists.txt").read_text(encoding="utf-8")
    compiled = set(re.findall(r"^geraf2_add_levels\(geraf2_kernels (\w+) ", build, re.MULTILINE))
    lanes = list((project_root / "cpp" / "src").glob("*/lanes.hpp"))
    # compiled for every instruction set in one file, by function attributes
    compiled |= {path.parent.name for path in lanes if "gnu::target(" in path.read_text()}
    assert compiled == {path.parent.name for path in lanes}
    assert compiled == set(VECTOR_KERNELS)
    headers = {path.stem for path in (project_root / "cpp/include/geraf2").glob("*.hpp")}
    shared = {"antennas", "error", "simd", "types", "version", "voxel_grid", "wave"}
    assert headers - shared == set(kernel_paths())
