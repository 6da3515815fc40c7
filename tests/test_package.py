"""The package as a whole: import time, stubs, layers."""

import ast
import graphlib
import re
import subprocess
import sys

import grimp

from geraf2.ops.simd import VECTOR_KERNELS, kernel_paths

# `.pth` files and hooks of an editable install load modules before the first line; those are not
# the package's.
LOADED = """
import sys
before = set(sys.modules)
import geraf2
names = {name.partition(".")[0] for name in set(sys.modules) - before}
print(sorted(names - sys.stdlib_module_names), "geraf2._core" in sys.modules)
"""


def test_import_loads_no_library_and_no_native_code():
    """What takes time is loaded where it is used: each of these libraries takes 0.1 s and more."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "['geraf2', 'lazy_loader'] False"


def _parameters(node: ast.FunctionDef) -> tuple[str, ...]:
    return tuple(a.arg for a in node.args.posonlyargs + node.args.args + node.args.kwonlyargs)


def _stub_signatures(body: list[ast.stmt], owner: str = "") -> set[tuple[str, ...]]:
    """Names with the parameters' names; an overload is one more."""
    found: set[tuple[str, ...]] = set()
    classes = {node.name: node for node in body if isinstance(node, ast.ClassDef)}
    for node in body:
        if isinstance(node, ast.ClassDef):
            bases = [classes.get(ast.unparse(base).partition("[")[0], node) for base in node.bases]
            members = [member for one in [node, *bases] for member in one.body]
            found |= {(node.name,)} | _stub_signatures(members, node.name + ".")
        elif isinstance(node, ast.FunctionDef):
            is_value = "property" in [getattr(d, "id", "") for d in node.decorator_list]
            found.add((owner + node.name, *(() if is_value else _parameters(node))))
        elif isinstance(node, ast.AnnAssign | ast.Assign):
            targets = [node.target] if isinstance(node, ast.AnnAssign) else node.targets
            found |= {(owner + ast.unparse(target),) for target in targets}
    return {names for names in found if not re.search(r"(^|\.)_(?!_init__)", names[0])}


def _built_signatures(holder, owner: str = "") -> set[tuple[str, ...]]:
    found: set[tuple[str, ...]] = set()
    # What the binding library gives to every enumeration is in no stub.
    given = {"name", "value", "__init__"} if hasattr(holder, "__members__") else set()
    for name, value in vars(holder).items():
        if name in given or (name.startswith("_") and name != "__init__"):
            continue
        stated = [] if isinstance(value, type | property) else (value.__doc__ or "").splitlines()
        signatures = [re.search(rf"\b{name}\((?!\*args).*\) -> .*", line) for line in stated]
        found |= {
            (owner + name, *_parameters(ast.parse(f"def {match[0]}: ...").body[0]))
            for match in signatures
            if match
        }
        if isinstance(value, type):
            found |= _built_signatures(value, name + ".")
        if not any(signatures) and name != "__init__":
            found.add((owner + name,))
    return found


def test_stubs_are_those_of_the_built_module(project_root):
    from geraf2 import _core  # noqa: PLC0415, TID251 - the stub of this very module is checked

    stub = project_root / "python" / "geraf2" / "_core.pyi"
    reported = _stub_signatures(ast.parse(stub.read_text(encoding="utf-8")).body)
    assert reported == _built_signatures(_core)


def test_imports_do_not_go_in_circles():
    """Not even those inside functions and those for type checkers."""
    graph = grimp.build_graph("geraf2", exclude_type_checking_imports=False, cache_dir=None)
    imported = {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}
    in_function = "geraf2.ops._matched_filter_torch"
    assert in_function in imported["geraf2.ops.matched_filter"]
    graphlib.TopologicalSorter(imported).prepare()  # CycleError names the circle


def test_every_kernel_of_several_instruction_sets_is_named(project_root):
    """`geraf2 doctor` names the path that each takes: none may be forgotten."""
    build = (project_root / "cpp" / "CMakeLists.txt").read_text(encoding="utf-8")
    compiled = set(re.findall(r"^geraf2_add_levels\(geraf2_kernels (\w+) ", build, re.MULTILINE))
    lanes = list((project_root / "cpp" / "src").glob("*/lanes.hpp"))
    # compiled for every instruction set in one file, by function attributes
    headers = [path for lane in lanes for path in lane.parent.glob("*.hpp")]
    compiled |= {path.parent.name for path in headers if "gnu::target(" in path.read_text()}
    assert compiled == {path.parent.name for path in lanes}
    assert compiled == set(VECTOR_KERNELS)
    headers = {path.stem for path in (project_root / "cpp/include/geraf2").glob("*.hpp")}
    shared = {"antennas", "error", "simd", "types", "version", "voxel_grid", "wave"}
    assert headers - shared == set(kernel_paths())
