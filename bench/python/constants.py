"""Number of constants of a preset: fields of its config, and constants of the modules that it runs.

    python bench/python/constants.py [--preset best] [--list]

A field of the config counts once, whatever it holds. A module counts if the stages of the preset,
or the calibration before them, import it, at any depth, and it is about the method: glints, images,
surfaces, calibration. Its constants are names in capitals of numbers; versions of formats and
stages are none.
"""

import argparse
import ast
import importlib.util
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from geraf2.pipeline.presets import preset_type

START = ("geraf2.pipeline.stages.direct", "geraf2.pipeline.stages.calibration")
METHOD = ("glints", "imaging", "surfaces", "rendering", "calibration")


def config_fields(config: Any, prefix: str = "") -> Iterator[str]:
    """Names of the constants of a config, dotted; of its groups, too."""
    for entry in fields(config):
        value = getattr(config, entry.name)
        if is_dataclass(value):
            yield from config_fields(value, f"{prefix}{entry.name}.")
        elif not isinstance(value, str):
            yield prefix + entry.name


def _path(module: str) -> Path | None:
    try:
        found = importlib.util.find_spec(module)
    except ModuleNotFoundError:  # a name of a module, not a module
        return None
    origin = None if found is None else found.origin
    return Path(origin) if origin is not None and origin.endswith(".py") else None


def imported(tree: ast.Module) -> Iterator[str]:
    """Modules, and names that may be modules, that a module imports from the package."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("geraf2"):
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def is_number(node: ast.expr) -> bool:
    """Whether an expression holds numbers and nothing but numbers, signs and operations."""
    parts = [part for part in ast.walk(node) if isinstance(part, ast.expr)]
    numbers = [p for p in parts if isinstance(p, ast.Constant) and type(p.value) in (int, float)]
    others = (ast.BinOp, ast.UnaryOp, ast.Tuple)
    return bool(numbers) and all(p in numbers or isinstance(p, others) for p in parts)


def module_constants() -> Iterator[str]:
    """Constants of the modules of the method, as module.NAME."""
    left, seen = list(START), set(START)
    while left:
        name = left.pop(0)
        path = _path(name)
        if path is None:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        more = [m for m in imported(tree) if m.split(".")[1:2] and m.split(".")[1] in METHOD]
        left += [m for m in dict.fromkeys(more) if m not in seen]
        seen.update(more)
        for node in tree.body if name.split(".")[1] in METHOD else ():
            targets: list[ast.expr] = []
            if isinstance(node, ast.Assign):
                targets, value = node.targets, node.value
            elif isinstance(node, ast.AnnAssign) and node.value is not None:
                targets, value = [node.target], node.value
            for target in targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                for one in names:
                    named = isinstance(one, ast.Name) and one.id.isupper()
                    if named and is_number(value) and not one.id.endswith("VERSION"):
                        yield f"{name.removeprefix('geraf2.')}.{one.id}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--preset", default="best")
    parser.add_argument("--list", action="store_true", help="print their names, too")
    options = parser.parse_args()
    of_config = list(config_fields(preset_type(options.preset)()))
    of_modules = sorted(set(module_constants()))
    if options.list:
        print("\n".join([*of_config, *of_modules]))
    print(f"{options.preset}: {len(of_config)} fields of the config, ", end="")
    print(f"{len(of_modules)} constants of modules, {len(of_config) + len(of_modules)} in all")
    for package, n in sorted(Counter(name.split(".")[0] for name in of_modules).items()):
        print(f"    {package} {n}")


if __name__ == "__main__":
    main()
