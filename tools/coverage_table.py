"""Print lines and coverage of each package of geraf2, from coverage.py's JSON report."""

import json
import sys
from collections import Counter
from pathlib import Path, PurePath


def package_of(file: str) -> str:
    """Folder of a file below geraf2; geraf2 itself for modules beside the folders."""
    parts = PurePath(file).parts
    return "/".join(parts[parts.index("geraf2") + 1 : -1]) or "geraf2"


def table(report: dict) -> list[str]:
    """A line for each package, the least covered first, and one for all."""
    lines, covered = Counter(), Counter()
    for file, found in report["files"].items():
        for name in (package_of(file), "all"):
            lines[name] += found["summary"]["num_statements"]
            covered[name] += found["summary"]["covered_lines"]
    share = {name: covered[name] / max(1, lines[name]) for name in lines}
    names = sorted(set(lines) - {"all"}, key=lambda name: (share[name], name))
    rows = [f"{name:24} {lines[name]:6} {share[name]:7.1%}" for name in [*names, "all"]]
    return [f"{'package':24} {'lines':>6} {'covered':>7}", *rows]


def main(path: str) -> None:
    print("\n".join(table(json.loads(Path(path).read_text(encoding="utf-8")))))


if __name__ == "__main__":
    main(sys.argv[1])
