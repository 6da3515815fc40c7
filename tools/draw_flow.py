"""Draw how a capture becomes a mesh, from the code: stages of each preset, and modules passed.

    python tools/draw_flow.py [--check]

Writes both between the markers of docs/architecture.md. With --check it writes nothing and reports
whether the page agrees with the code. The stages are those of `geraf2.pipeline.presets`. The
modules come from a run of `geraf2.reconstruct` on the small scene of `geraf2.examples`: each in
which a function received the capture, one of its planes, or an object that holds it.
"""

import argparse
import sys
from pathlib import Path

import geraf2
from geraf2.pipeline.presets import PRESETS, stages_of
from geraf2.scene import Capture, Pose

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


def modules_passed() -> list[str]:
    """Modules that a capture passes in `geraf2.reconstruct`, in the order of passing."""
    capture, seen = geraf2.examples.small_capture()[0], []

    def holds(value: object) -> bool:
        if isinstance(value, Capture | Pose):
            return True
        inside = getattr(value, "__dict__", None)
        return bool(inside) and any(isinstance(v, Capture) for v in inside.values())

    def watch(frame, event, _):
        name = frame.f_globals.get("__name__", "")
        if event != "call" or not name.startswith("geraf2.") or name in seen:
            return
        code = frame.f_code
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(holds(frame.f_locals.get(argument)) for argument in names):
            seen.append(name)

    sys.setprofile(watch)
    try:
        prior = geraf2.LosPrior.from_box(capture.walls[0].size_m)
        geraf2.reconstruct(capture, prior, "fast")
    finally:
        sys.setprofile(None)
    return [name for name in seen if ".examples" not in name]


def flow_text() -> str:
    names = modules_passed()
    packages = list(dict.fromkeys(name.split(".")[1] for name in names))
    listed = ", ".join(f"`{name.removeprefix('geraf2.')}`" for name in names)
    return (
        f"{stages_text()}\nFrom `geraf2.reconstruct()` to the mesh of the preset fast a capture "
        f"is handed to functions of {len(names)} modules in {len(packages)} packages: {listed}.\n"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    text = DOC.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    drawn = f"{before}{BEGIN}{flow_text()}{END}{after}"
    if drawn == text:
        return 0
    if check:
        print(f"{DOC.name} is not what the code gives: run tools/draw_flow.py", file=sys.stderr)
        return 1
    DOC.write_text(drawn, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
