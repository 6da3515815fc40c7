"""Hygiene of the given files: final newline, trailing space, size, syntax, absolute paths.

Without arguments, every file that git tracks is checked.
"""

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BINARY = {".png", ".npy", ".npz", ".glb", ".gz"}
VERBATIM = {"LICENSE"}
MAX_BYTES = 500_000  # a picture or a test mesh fits; a capture does not belong in the repository
MAX_LINES = 600
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
    except ValueError as error:
        return str(error)
    return None


def complaints(path: Path) -> Iterator[str]:
    full = ROOT / path
    if full.stat().st_size > MAX_BYTES:
        yield f"larger than {MAX_BYTES} bytes"
    if path.suffix in BINARY or path.name in VERBATIM or "fuzzing" in path.parts[:-2]:
        return
    text = full.read_text(encoding="utf-8")
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
    n_lines = text.count("\n")
    if path.suffix in {".py", ".cpp", ".hpp"} and n_lines > MAX_LINES:
        yield f"{n_lines} lines, limit {MAX_LINES}: split it"
    error = syntax_error(path, text)
    if error is not None:
        yield f"not valid: {error}"


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
