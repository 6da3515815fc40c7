"""One self-contained HTML page per run: pictures inside, no scripts, no network."""

import base64
import json
from collections.abc import Container, Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from geraf2 import __version__
from geraf2._types import AnyPath

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
       max-width: 1120px; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; }
h2 { font-size: 1.15rem; margin-top: 2.2rem; border-bottom: 1px solid #ddd; padding-bottom: .2rem; }
p.note, figcaption, dl { color: #444; }
.facts { display: flex; flex-wrap: wrap; gap: .7rem; margin: 1rem 0; padding: 0; }
.facts div { border: 1px solid #d5d5d5; border-radius: 6px; padding: .5rem .9rem;
             min-width: 7.5rem; }
.facts b { display: block; font-size: 1.3rem; font-weight: 600; }
.tables { display: flex; flex-wrap: wrap; gap: 1rem 2.5rem; align-items: flex-start; }
table { border-collapse: collapse; margin: .4rem 0 1rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { padding: .25rem .8rem; border-bottom: 1px solid #e4e4e4; text-align: right; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
thead th { border-bottom: 1px solid #999; font-weight: 600; }
table.text td { text-align: left; overflow-wrap: anywhere; }
table.grouped { font-size: 14px; }
table.grouped th, table.grouped td { padding: .12rem .7rem; border: 0; white-space: nowrap; }
table.grouped tr.start td { border-top: 1px solid #ccc; padding-top: .3rem; }
table.grouped th { white-space: normal; vertical-align: bottom; max-width: 6.5rem; }
table.grouped .name { text-align: left; }
.scroll { overflow-x: auto; }
nav a { margin-right: 1rem; white-space: nowrap; }
figure { margin: 1rem 0 1.6rem; }
img { max-width: 100%; height: auto; }
.warning { border-left: 4px solid #D55E00; background: #fdf3ec; padding: .5rem .9rem;
           margin: .5rem 0; }
pre { background: #f5f5f5; padding: .8rem; overflow-x: auto; font-size: 13px; }
dt { font-family: ui-monospace, monospace; font-size: 13px; color: #1a1a1a; }
dd { margin: 0 0 .5rem 1.5rem; }
"""

Cell = str
"""Text of a table's cell, not yet escaped."""


def page(title: str, body: Iterable[str]) -> str:
    """Whole document around sections that are already HTML."""
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta name="generator" content="geraf2 {escape(__version__)}">',
            f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
            f"<h1>{escape(title)}</h1>",
            *body,
            "</body></html>\n",
        ]
    )


def facts(items: Sequence[tuple[str, str]]) -> str:
    """Row of headline numbers, (name, value)."""
    cells = "".join(f"<div>{escape(name)}<b>{escape(value)}</b></div>" for name, value in items)
    return f'<div class="facts">{cells}</div>'


def table(
    caption: str, head: Sequence[Cell], rows: Iterable[Sequence[Cell]], *, text: bool = False
) -> str:
    """Table with a caption; numbers are aligned right unless `text`."""
    kind = ' class="text"' if text else ""
    header = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    thead = f"<thead><tr>{header}</tr></thead>" if any(head) else ""
    return f"<table{kind}><caption>{escape(caption)}</caption>{thead}<tbody>{lines}</tbody></table>"


def grouped_table(
    head: Sequence[Cell],
    rows: Sequence[Sequence[Cell]],
    *,
    n_names: int,
    n_group: int,
    best: Container[tuple[int, int]] = (),
) -> str:
    """Table whose rows belong together where their first `n_group` cells are the same.

    What the rows of a group share is said once. The first `n_names` columns are names, aligned
    left; cells (row, column) of `best` are bold. Scrolls sideways where the page is narrow.
    """

    def kind(column: int) -> str:
        return ' class="name"' if column < n_names else ""

    header = "".join(f'<th scope="col"{kind(c)}>{escape(cell)}</th>' for c, cell in enumerate(head))
    lines = []
    for r, row in enumerate(rows):
        starts = r == 0 or tuple(row[:n_group]) != tuple(rows[r - 1][:n_group])
        cells = []
        for c, cell in enumerate(row):
            text = escape(cell) if starts or c >= n_group else ""
            cells.append(f"<td{kind(c)}>{f'<b>{text}</b>' if (r, c) in best else text}</td>")
        group = ' class="start"' if starts else ""
        lines.append(f"<tr{group}>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table class="grouped"><thead><tr>{header}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def contents(entries: Sequence[tuple[str, str]]) -> str:
    """Links to headings of the page, (id, text)."""
    links = "".join(f'<a href="#{escape(name)}">{escape(text)}</a> ' for name, text in entries)
    return f"<nav>{links}</nav>"


def picture(path: AnyPath, caption: str, *, max_width_px: int | None = None) -> str:
    """PNG as part of the page, with its caption as the text for those who cannot see it."""
    data = base64.b64encode(Path(path).read_bytes()).decode("ascii")
    width = "" if max_width_px is None else f' style="max-width:min(100%,{max_width_px}px)"'
    return (
        f'<figure><img{width} alt="{escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def warning(text: str) -> str:
    """One warning, set apart."""
    return f'<p class="warning">{escape(text)}</p>'


def definitions(entries: Mapping[str, str]) -> str:
    """List of terms and what they mean."""
    items = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in entries.items())
    return f"<dl>{items}</dl>"


def preformatted(text: str) -> str:
    """Text as it is."""
    return f"<pre>{escape(text)}</pre>"


def millimetres(value_m: float | None) -> str:
    """Length in mm with two decimals; n/a where there is none."""
    return "n/a" if value_m is None else f"{1e3 * value_m:.2f}"


def metrics_section(metrics: Mapping[str, Any]) -> list[str]:
    """Tables of what `geraf2.evaluation.write_metrics` wrote."""
    scores = table(
        "Matched within a threshold",
        ("threshold [mm]", "F1", "precision", "recall"),
        [
            (
                f"{1e3 * score['threshold_m']:g}",
                *(f"{score[name]:.4f}" for name in ("f1", "precision", "recall")),
            )
            for score in metrics["scores"]
        ],
    )
    distances = _distance_table(metrics)
    overall = table(
        "Over all",
        ("", "this mesh", "truth against itself"),
        [
            (
                "Chamfer distance [1e-3 m²]",
                f"{metrics['chamfer_1e3_m2']:.4f}",
                f"{metrics['floor_chamfer_1e3_m2']:.4f}",
            ),
            (
                "median, both ways [mm]",
                millimetres(metrics["both_ways"]["median_m"]),
                millimetres(metrics["floor_median_m"]),
            ),
            ("bias, positive outside [mm]", millimetres(metrics["surface_bias_m"]), ""),
        ],
    )
    bands = ""
    if metrics.get("confidence_bands"):
        bands = table(
            "Error by confidence",
            ("confidence", "share of the area [%]", "median error [mm]"),
            [
                (
                    f"{band['low']:g} to {band['high']:g}",
                    f"{100 * band['area_fraction']:.1f}",
                    millimetres(band["median_m"]),
                )
                for band in metrics["confidence_bands"]
            ],
        )
    return [f'<div class="tables">{scores}{overall}{distances}{bands}</div>']


def _distance_table(metrics: Mapping[str, Any]) -> str:
    names = {
        "mesh_to_truth": "mesh to truth, sampled",
        "truth_to_mesh": "truth to mesh, sampled",
        "both_ways": "both ways, sampled",
        "surface_mesh_to_truth": "mesh to truth, exact",
        "surface_truth_to_mesh": "truth to mesh, exact",
    }
    columns = ("median_m", "p95_m", "mean_m", "max_m")
    return table(
        "Distances [mm]",
        ("", "median", "95 %", "mean", "largest"),
        [
            (label, *(millimetres(metrics[key][column]) for column in columns))
            for key, label in names.items()
        ],
    )


def scalar_rows(values: Mapping[str, Any], skip: Iterable[str]) -> list[tuple[str, str]]:
    """Plain values of a mapping as rows of text, nested ones by dotted name."""
    left_out = set(skip)
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if key in left_out or value is None:
            continue
        if isinstance(value, Mapping):
            rows += [(f"{key}.{name}", text) for name, text in scalar_rows(value, ())]
        elif isinstance(value, float):
            rows.append((key, f"{value:.6g}"))
        elif isinstance(value, str | int | bool):
            rows.append((key, str(value)))
        else:
            rows.append((key, json.dumps(value)))
    return rows
