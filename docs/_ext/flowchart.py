"""Flow charts of Markdown pages, drawn as SVG when the site is built: no script, no network.

Reads the part of Mermaid that the pages use: `flowchart LR`, nodes `a[text]`, `a[(text)]`,
`a{{text}}`, steps `a --> b --> c` and `a -.-> b`, subgraphs.
"""

import re
from dataclasses import dataclass, field
from html import escape
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive

NODE = re.compile(r"(\w+)(?:\[\((.*?)\)\]|\{\{(.*?)\}\}|\[(.*?)\])?")
ARROW = re.compile(r"\s*(-->|-\.->)\s*")
CHARACTER, HEIGHT, GAP_X, GAP_Y = 7.4, 30, 34, 14  # pixels


@dataclass
class Chart:
    """Nodes with their text and steps between them."""

    texts: dict[str, str] = field(default_factory=dict)
    steps: list[tuple[str, str, bool]] = field(default_factory=list)


def parse(lines: list[str]) -> dict[str, Chart]:
    """Read charts by their subgraph's name, "" for one without."""
    charts, name = {"": Chart()}, ""
    for line in lines:
        text = line.strip()
        if not text or text.startswith("flowchart"):
            continue
        if text == "end":
            name = ""
        elif text.startswith("subgraph "):
            name = text.removeprefix("subgraph ")
            charts[name] = Chart()
        else:
            _read_steps(text, charts[name])
    return {name: chart for name, chart in charts.items() if chart.texts}


def _read_steps(text: str, chart: Chart) -> None:
    parts = ARROW.split(text)
    names = []
    for part in parts[::2]:
        found = NODE.fullmatch(part)
        if found is None:
            msg = f"no step of a flow chart: {text!r}"
            raise ValueError(msg)
        names.append(found[1])
        label = found[2] or found[3] or found[4]
        if label or found[1] not in chart.texts:
            chart.texts[found[1]] = label or found[1]
    chart.steps += [
        (a, b, arrow == "-.->")
        for a, b, arrow in zip(names[:-1], names[1:], parts[1::2], strict=True)
    ]


def positions(chart: Chart) -> dict[str, tuple[int, int]]:
    """Column (the longest way from a start) and row of each node."""
    column = dict.fromkeys(chart.texts, 0)
    for _ in chart.texts:
        for a, b, dotted in chart.steps:
            if not dotted:
                column[b] = max(column[b], column[a] + 1)
    for a, b, dotted in chart.steps:
        if dotted:
            column[a] = max(min(column[t] for s, t, _ in chart.steps if s == a) - 1, 0)
            column[b] = max(column[b], 1)
    rows: dict[str, float] = {}
    for number in range(max(column.values()) + 1):
        here = [name for name in chart.texts if column[name] == number]
        before = {b: [rows[a] for a, t, _ in chart.steps if t == b and a in rows] for b in here}
        here.sort(key=lambda name: sum(before[name]) / len(before[name]) if before[name] else 99)
        rows |= {name: row for row, name in enumerate(here)}
    return {name: (column[name], int(rows[name])) for name in chart.texts}


def svg(chart: Chart) -> str:
    """Draw one chart from left to right."""
    at = positions(chart)
    n_columns = max(column for column, _ in at.values()) + 1
    widths = [
        max(len(chart.texts[name]) for name in at if at[name][0] == number) * CHARACTER + 22
        for number in range(n_columns)
    ]
    lefts = [sum(widths[:number]) + GAP_X * number + 2 for number in range(n_columns)]
    box = {
        name: (lefts[column], row * (HEIGHT + GAP_Y) + 2, widths[column])
        for name, (column, row) in at.items()
    }
    parts = []
    for a, b, dotted in chart.steps:
        (x, y, width), (u, v, _) = box[a], box[b]
        start, end, middle = (x + width, y + HEIGHT / 2), (u - 7, v + HEIGHT / 2), GAP_X / 2
        style = ' stroke-dasharray="4 4"' if dotted else ""
        parts.append(
            f'<path d="M{start[0]:.0f},{start[1]:.0f} C{start[0] + middle:.0f},{start[1]:.0f} '
            f'{end[0] - middle:.0f},{end[1]:.0f} {end[0]:.0f},{end[1]:.0f}"{style}/>'
            f'<path class="head" d="M{end[0]:.0f},{end[1] - 4:.0f} l7,4 l-7,4 z"/>'
        )
    for name, (x, y, width) in box.items():
        parts.append(
            f'<rect x="{x:.0f}" y="{y:.0f}" width="{width:.0f}" height="{HEIGHT}" rx="5"/>'
            f'<text x="{x + width / 2:.0f}" y="{y + 20:.0f}">{escape(chart.texts[name])}</text>'
        )
    width = lefts[-1] + widths[-1] + 2
    height = max(y for _, y, _ in box.values()) + HEIGHT + 2
    words = ", ".join(f"{chart.texts[a]} to {chart.texts[b]}" for a, b, _ in chart.steps)
    return (
        f'<svg class="flowchart" role="img" aria-label="{escape(words, quote=True)}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" style="width:{width:.0f}px">'
        f"{''.join(parts)}</svg>"
    )


class Mermaid(Directive):
    """A fence of the language mermaid."""

    has_content: ClassVar[bool] = True

    def run(self) -> list[nodes.Node]:
        """Draw each chart of the fence as a figure."""
        parts = []
        for name, chart in parse(list(self.content)).items():
            caption = f"<figcaption>{escape(name)}</figcaption>" if name else ""
            parts.append(f'<figure class="flowchart">{caption}{svg(chart)}</figure>')
        return [nodes.raw("", "\n".join(parts), format="html")]


def setup(app: object) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("mermaid", Mermaid)  # type: ignore[attr-defined]
    return {"parallel_read_safe": True}
