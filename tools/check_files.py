"""Hygiene of the given files: final newline, trailing space, size, syntax, absolute paths.

A Python file of the package has at most 500 lines (of the command line: 300), a function of it at
most 60 without its docstring. Without arguments, every file that git tracks is checked.
"""

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BINARY = {".png", ".npy", ".npz", ".glb", ".gz", ".safetensors"}
VERBATIM = {"LICENSE"}
MAX_BYTES = 500_000  # a picture or a test mesh fits; a capture does not belong in the repository
MAX_LINES = 600
MAX_PACKAGE_LINES = 500
MAX_CLI_LINES = 300
MAX_FUNCTION_LINES = 60
# A machine's own folders mean nothing elsewhere. (`/tmp`, `/usr` in prose are left alone.)
MACHINE_PATH = re.compile(r"(?<![\w.~])/(home|root|work|Users|mnt|opt)/\w")
CONFLICT = re.compile(r"^(<{7}|>{7}) ", re.MULTILINE)


def tracked_files() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [Path(name) for name in listed.stdout.split("\0") if name]


def syntax_error(path: Path, text: str) -> str | None:
    try:
        if path.suffix == ".toml":
            tomllib.loads(text)
        elif path.suffix == ".json":
            json.loads(text)
        elif path.suffix == ".py":
            ast.parse(text)
    except (ValueError, SyntaxError) as error:
        return str(error)
    return None


def lines_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Number of lines of a function, its docstring left out."""
    n_lines = function.end_lineno - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function) is not None:
        n_lines -= first.end_lineno - first.lineno + 1
    return n_lines


def longer(path: Path, text: str) -> Iterator[tuple[str, int, int]]:
    """Name, lines and limit of what is too long in a file of the package."""
    n_lines = text.count("\n")
    limit = MAX_CLI_LINES if "cli" in path.parts else MAX_PACKAGE_LINES
    if n_lines > limit:
        yield path.name, n_lines, limit
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            n_lines = lines_of(node)
            if n_lines > MAX_FUNCTION_LINES:
                yield f"{node.name}()", n_lines, MAX_FUNCTION_LINES


def text_complaints(text: str) -> Iterator[str]:
    if text and not text.endswith("\n"):
        yield "no newline at the end"
    if "\r" in text:
        yield "carriage return"
    for number, line in enumerate(text.split("\n"), start=1):
        if line != line.rstrip():
            yield f"line {number}: trailing space"
        if MACHINE_PATH.search(line):
            yield f"line {number}: absolute path of one machine"
    if CONFLICT.search(text):
        yield "merge conflict marker"


def size_complaints(path: Path, text: str) -> Iterator[str]:
    n_lines = text.count("\n")
    if path.suffix in {".py", ".cpp", ".hpp"} and n_lines > MAX_LINES:
        yield f"{n_lines} lines, limit {MAX_LINES}: split it"
    if path.suffix == ".py" and path.parts[0] == "python":
        for name, length, limit in longer(path, text):
            yield f"{name} has {length} lines, limit {limit}: split it"


def complaints(path: Path) -> Iterator[str]:
    full = ROOT / path
    if full.stat().st_size > MAX_BYTES:
        yield f"larger than {MAX_BYTES} bytes"
    if path.suffix in BINARY or path.name in VERBATIM or "fuzzing" in path.parts[:-2]:
        return
    text = full.read_text(encoding="utf-8")
    yield from text_complaints(text)
    error = syntax_error(path, text)
    if error is not None:
        yield f"not valid: {error}"
    else:
        yield from size_complaints(path, text)


def main(names: list[str]) -> int:
    found = False
    for path in [Path(name) for name in names] or tracked_files():
        if not (ROOT / path).is_file():
            continue
        for complaint in complaints(path):
            print(f"{path}: {complaint}")
            found = True
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
