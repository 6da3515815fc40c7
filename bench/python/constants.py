"""Number of constants of a preset: fields of its config, and constants of the modules that it runs.

    python bench/python/constants.py [--preset best] [--list]

A field of the config counts once, whatever it holds. A module counts if the stages of the preset,
or the search of the box and the calibration before them, import it, at any depth, and it is about
the method: echoes, free space, images, surfaces, calibration. Its constants are names in capitals
of numbers (versions of formats and stages are none), numeric defaults of its dataclasses that the
config does not hold, and floats inside its functions but those of arithmetic.
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

CHECK = "geraf2.pipeline.box_check"
START = ("geraf2.pipeline.stages.direct", "geraf2.pipeline.stages.calibration", CHECK)
METHOD = ("echoes", "freespace", "imaging", "surfaces", "calibration")


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


# Factors and units of equations, and guards against a division by zero.
_ARITHMETIC = {0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 8.0, 10.0, 20.0, 60.0, 90.0, 100.0, 180.0}
_ARITHMETIC |= {270.0, 360.0, 1e3, 1e6, 1e9, 1e-3, 0.25e-6}
_GUARD = 1e-9
# Defaults of results that hold nothing yet, and of weights without effect.
_NEUTRAL = {"0", "0.0", "1.0", "(0.0, 0.0)"}


def dataclass_defaults(tree: ast.Module, config: set[str]) -> Iterator[str]:
    """Numeric defaults of fields of dataclasses, as Class.field; without classes of the config."""
    for node in tree.body:
        if not isinstance(node, ast.ClassDef) or node.name in config:
            continue
        for field in node.body:
            named = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
            value = field.value if named else None
            if value is not None and is_number(value) and ast.unparse(value) not in _NEUTRAL:
                yield f"{node.name}.{field.target.id}"


def literals(tree: ast.Module) -> Iterator[str]:
    """Floats inside functions that are no factor or unit of an equation, as function:line."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in ast.walk(function):
            is_float = isinstance(node, ast.Constant) and type(node.value) is float
            if is_float and node.value not in _ARITHMETIC and node.value > _GUARD:
                yield f"{function.name}:{node.lineno}"


def config_classes(config: Any) -> set[str]:
    """Names of the classes of a config and its groups."""
    found = {type(config).__name__}
    for entry in fields(config):
        value = getattr(config, entry.name)
        if is_dataclass(value):
            found |= config_classes(value)
    return found


def is_number(node: ast.expr) -> bool:
    """Whether an expression holds numbers and nothing but numbers, signs and operations."""
    parts = [part for part in ast.walk(node) if isinstance(part, ast.expr)]
    numbers = [p for p in parts if isinstance(p, ast.Constant) and type(p.value) in (int, float)]
    others = (ast.BinOp, ast.UnaryOp, ast.Tuple)
    return bool(numbers) and all(p in numbers or isinstance(p, others) for p in parts)


def method_modules() -> Iterator[tuple[str, ast.Module]]:
    """Modules of the method that the stages and the calibration import, at any depth."""
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
        if name == CHECK or name.split(".")[1] in METHOD:
            yield name.removeprefix("geraf2."), tree


def module_constants() -> Iterator[str]:
    """Constants of the modules of the method, as module.NAME."""
    for name, tree in method_modules():
        for node in tree.body:
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
                        yield f"{name}.{one.id}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--preset", default="best")
    parser.add_argument("--list", action="store_true", help="print their names, too")
    options = parser.parse_args()
    config = preset_type(options.preset)()
    modules = list(method_modules())
    groups = {
        "fields of the config": list(config_fields(config)),
        "constants of modules": sorted(set(module_constants())),
        "defaults of other dataclasses": [
            f"{name}.{one}"
            for name, tree in modules
            for one in dataclass_defaults(tree, config_classes(config))
        ],
        "literals in functions": [
            f"{name}.{one}" for name, tree in modules for one in literals(tree)
        ],
    }
    for title, names in groups.items():
        print(f"{len(names):5d} {title}")
        if options.list:
            print("".join(f"          {name}\n" for name in names), end="")
        elif title != "fields of the config":
            rooms = Counter(name.split(".")[0] for name in names)
            print("".join(f"          {room} {n}\n" for room, n in sorted(rooms.items())), end="")
    print(f"{sum(map(len, groups.values())):5d} in all, of {options.preset}")


if __name__ == "__main__":
    main()
