"""Print the run-time requirements of pyproject.toml, one a line, for pip."""

import tomllib
from pathlib import Path

PYPROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"


def main() -> None:
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    print("\n".join(project["dependencies"]))


if __name__ == "__main__":
    main()
