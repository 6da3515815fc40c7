"""Draw how a capture becomes a mesh, from the code: the stages of each preset.

    python tools/draw_flow.py [--check]

Writes them between the markers of docs/architecture.md. With --check it writes nothing and reports
whether the page agrees with the code, `geraf2.pipeline.presets`.
"""

import argparse
import sys
from pathlib import Path

from geraf2.pipeline.presets import PRESETS, stages_of

DOC = Path(__file__).resolve().parent.parent / "docs" / "architecture.md"
BEGIN, END = "<!-- drawn by tools/draw_flow.py -->\n", "<!-- end -->\n"
SHOWN = ("fast", "best", "paper")


def stages_text() -> str:
    lines = ["```mermaid", "flowchart LR"]
    for preset in SHOWN:
        lines.append(f"    subgraph {preset}")
        for stage in stages_of(PRESETS[preset]()):
            sources = [entry.name for entry in stage.inputs] or ["capture"]
            here = f"{preset}_{stage.name}[{stage.name}]"
            lines += [f"    {preset}_{source}[{source}] --> {here}" for source in sources]
        lines.append("    end")
    return "\n".join([*lines, "```", ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    text = DOC.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    drawn = f"{before}{BEGIN}{stages_text()}{END}{after}"
    if drawn == text:
        return 0
    if check:
        print(f"{DOC.name} is not what the code gives: run tools/draw_flow.py", file=sys.stderr)
        return 1
    DOC.write_text(drawn, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
