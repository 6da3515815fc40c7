"""Docstrings of the package as reStructuredText: lists of arguments, links to pages."""

import inspect
import re
from typing import Any

ARGUMENT = re.compile(r"^(\w+(?:, \w+)*): +(.*)$|^(\w+(?:, \w+)*):$")
PAGE = re.compile(r"\bdocs/([\w/-]+)\.md(?:#[\w-]+)?")


def arguments_of(found: object) -> set[str]:
    """Names that a docstring may describe: of a function's or constructor's arguments."""
    try:
        return set(inspect.signature(found).parameters)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return set()


def as_fields(lines: list[str], names: set[str]) -> list[str]:
    """`name: text` and the lines that continue it become a field, `:param name: text`."""
    out: list[str] = []
    twins: list[str] = []  # `a, b: text` says of b that it is as a
    within = False
    for line in [*lines, ""]:
        found = ARGUMENT.match(line)
        words = (found[1] or found[3]).split(", ") if found else []
        starts = found is not None and set(words) <= names
        if within and (starts or not line.strip()):
            out += twins
            twins = []
        if found and starts:
            if not within and out and out[-1]:
                out.append("")
            out.append(f":param {words[0]}: {found[2] or ''}".rstrip())
            twins = [f":param {word}: as `{words[0]}`" for word in words[1:]]
            within = True
        elif within and line.strip():
            out.append(f"    {line.strip()}")
        else:
            within = False
            out.append(line)
    return out


def without_substitutions(lines: list[str]) -> list[str]:
    """Bars of absolute values as characters: between two of them is no name of a substitution."""
    out, indent = [], -1
    for line in lines:
        depth = len(line) - len(line.lstrip())
        if line.strip() and depth <= indent:
            indent = -1
        if line.strip().startswith(".. math::"):
            indent = depth
        code = indent >= 0 or line.lstrip().startswith((">>>", "..."))
        out.append(line if code else re.sub(r"(?<!\\)\|", r"\|", line))
    return out


def process(app: Any, what: str, name: str, found: object, options: Any, lines: list[str]) -> None:
    """Rewrite the lines of one docstring in place."""
    del app, what, name, options
    text = as_fields(without_substitutions(lines), arguments_of(found))
    lines[:] = [PAGE.sub(r":doc:`\1 </\1>`", line) for line in text]


def setup(app: Any) -> dict[str, bool]:
    """Listen before napoleon does."""
    app.connect("autodoc-process-docstring", process, priority=400)
    return {"parallel_read_safe": True}
