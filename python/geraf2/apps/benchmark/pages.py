"""Pages of a benchmark: tables as Markdown and CSV, and one HTML page with pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geraf2.apps.benchmark.ladder import ladder
from geraf2.apps.benchmark.pictures import draw_gallery, draw_slices, draw_sweep
from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.apps.benchmark.suite import Case, Experiment, Suite
from geraf2.io.atomic import write_text_atomic
from geraf2.io.text import csv_text
from geraf2.report import html

MARKDOWN_NAME, PAGE_NAME = "benchmark.md", "benchmark.html"
TABLES_FOLDER, FIGURES_FOLDER = "tables", "figures"

# Column, field, digits, factor.
_COLUMNS = (
    ("F1 15 mm", "f1_15mm", 3, 1.0),
    ("F1 5 mm", "f1_5mm", 3, 1.0),
    ("F1 3 mm", "f1_3mm", 3, 1.0),
    ("F1 2 mm", "f1_2mm", 3, 1.0),
    ("CD [1e-3 m2]", "chamfer_1e3_m2", 4, 1.0),
    ("volume / true", "volume_ratio", 3, 1.0),
    ("extent x [mm]", "extent_x_m", 1, 1e3),
    ("extent y [mm]", "extent_y_m", 1, 1e3),
    ("extent z [mm]", "extent_z_m", 1, 1e3),
    ("offset [mm]", "offset_m", 2, 1e3),
    ("median [mm]", "median_m", 2, 1e3),
    ("expected [mm]", "expected_m", 2, 1e3),
    ("pieces, holes right", "same_topology", 2, 1.0),
    ("pieces, holes (true)", "topology", 0, 1.0),
    ("PSNR [dB]", "psnr_db", 1, 1.0),
    ("CPU [s]", "cpu_seconds", 0, 1.0),
)
# What a smaller value is better for, and the value that others are best near to.
_SMALLER_IS_BETTER = ("chamfer_1e3_m2", "median_m")
_BEST_AT = {
    "volume_ratio": 1.0,
    **dict.fromkeys(("extent_x_m", "extent_y_m", "extent_z_m", "offset_m"), 0.0),
}
_OURS = "fast"
_AGAINST = "The preset fast against each method"
_AGAINST_HEAD = ("method", "rows", "fast better by F1 5 mm", "by CD")
_NOTE = (
    "All values are of simulated captures: single bounce, fixed seed, nothing aligned, scaled or "
    "cropped (docs/benchmark.md). Columns marked 'real data, published' are the paper's own, of "
    "other objects, another scan and after an alignment: they cannot be compared directly."
)


@dataclass(frozen=True)
class Table:
    """Table of one experiment, as text."""

    name: str
    """Name of the experiment."""
    experiment: Experiment
    """The experiment."""
    head: tuple[str, ...]
    """Columns."""
    rows: tuple[tuple[str, ...], ...]
    """Cells."""
    failures: tuple[str, ...]
    """One line for each row that failed."""
    n_names: int
    """Number of columns that name the row: scene, setting if several, method."""
    best: frozenset[tuple[int, int]]
    """Cells (row, column) with the best value of all methods on the same scene and setting."""
    rungs: tuple[tuple[str, ...], ...] = ()
    """Loss by each setting, a line each, after the head; only for ladders."""


Results = Sequence[tuple[Row, RowResult]]


def write_pages(
    out: Path, suite: Suite, results: Results, *, num_threads: int | None = None
) -> Path:
    """Write tables and pictures of all finished rows; returns the HTML page.

    out: folder of the benchmark. suite: its experiments. results: rows with their values.
    num_threads: of the ray tracer; all when None.
    """
    of = {
        name: [pair for pair in results if pair[0].experiment == name] for name in suite.experiments
    }
    tables = [
        make_table(name, experiment, suite, of[name])
        for name, experiment in suite.experiments.items()
        if of[name]
    ]
    for table in tables:
        write_text_atomic(
            out / TABLES_FOLDER / f"{table.name}.csv", csv_text(table.head, table.rows)
        )
        if table.rungs:
            rungs = out / TABLES_FOLDER / f"{table.name}_rungs.csv"
            write_text_atomic(rungs, csv_text(table.rungs[0], table.rungs[1:]))
    losses = lost_rows(suite, results)
    against = against_default(suite, results)
    words = {
        "note": _NOTE,
        "losses": losses,
        "against_title": _AGAINST,
        "against": [_AGAINST_HEAD, *against],
    }
    text = html.rendered("benchmark.md", tables=tables, is_quick=suite.is_quick, **words)
    write_text_atomic(out / MARKDOWN_NAME, text)
    sections = [
        (table, _pictures(out, table, of[table.name], suite, num_threads)) for table in tables
    ]
    page = out / PAGE_NAME
    text = html.rendered(
        "benchmark.html",
        title="geraf2 benchmark",
        facts=[("rows", len(results)), ("failed", sum(r.error is not None for _, r in results))],
        sections=sections,
        **words,
    )
    write_text_atomic(page, text)
    return page


def make_table(name: str, experiment: Experiment, suite: Suite, results: Results) -> Table:
    """Table of one experiment; columns without any value are omitted."""
    used = [c for c in _COLUMNS if any(getattr(result, c[1]) is not None for _, result in results)]
    # Only of the methods in the table.
    published = list(
        dict.fromkeys(
            name
            for row, _ in results
            for name in experiment.published.get(row.scene, {}).get(row.method, {})
        )
    )
    has_cases = any(case.label for case in experiment.cases)
    head = ["scene", *(["setting"] if has_cases else []), "method", *(c[0] for c in used)]
    head += [f"{key} (real data, published)" for key in published]
    lines, failures = [], []
    for row, result in results:
        cells = [row.scene, *([row.case.label] if has_cases else []), row.how.title]
        cells += [_number(getattr(result, c[1]), c[2], c[3]) for c in used]
        if result.error is not None:
            failures.append(f"{row.name}: {result.error}")
            cells = [*cells[: -len(used)], *(["failed"] * len(used))] if used else cells
        own = experiment.published.get(row.scene, {}).get(row.method, {})
        lines.append((*cells, *(_number(own.get(key), 3, 1.0) for key in published)))
    lines += _mean_lines(experiment, suite, results, used, has_cases, len(published))
    n_names = 3 if has_cases else 2
    best = _best_cells(results, [c[1] for c in used], n_names)
    rows = tuple(lines)
    rungs: tuple[tuple[str, ...], ...] = ()
    if experiment.ladder:
        rungs_head, rungs_lines = ladder(experiment, suite, results)
        rungs = (rungs_head, *rungs_lines)
    return Table(name, experiment, tuple(head), rows, tuple(failures), n_names, best, rungs)


def _best_cells(
    results: Results, columns: Sequence[str], first_column: int
) -> frozenset[tuple[int, int]]:
    """Cells with the best value of several methods on one scene and setting."""
    groups: dict[tuple[str, str], list[int]] = {}
    for number, (row, _) in enumerate(results):
        if row.how.kind != "oracle":  # a bound, not a method
            groups.setdefault((row.scene, row.case.label), []).append(number)
    best = set()
    for numbers in groups.values():
        for column, key in enumerate(columns):
            values = {n: getattr(results[n][1], key) for n in numbers}
            known = {n: value for n, value in values.items() if value is not None}
            if len(known) < 2 or key in ("cpu_seconds", "topology", "expected_m"):
                continue
            if key in _BEST_AT:
                known = {n: abs(value - _BEST_AT[key]) for n, value in known.items()}
            is_small = key in _SMALLER_IS_BETTER or key in _BEST_AT
            top = (min if is_small else max)(known.values())
            best |= {(n, first_column + column) for n, value in known.items() if value == top}
    return frozenset(best)


def _ours(results: Results) -> dict[tuple[str, str, str], RowResult]:
    """Return the default's results by table, scene and setting."""
    return {
        (row.experiment, row.scene, row.case.label): result
        for row, result in results
        if row.method == _OURS and result.f1_5mm is not None
    }


def against_default(suite: Suite, results: Results) -> list[tuple[str, ...]]:
    """Wins of the default over each method: (method, rows, by F1 5 mm, by CD).

    Counted over all common rows of the same table, scene and setting.
    """
    ours, counts_of = _ours(results), dict[str, list[int]]()
    for row, result in results:
        own = ours.get((row.experiment, row.scene, row.case.label))
        if row.method == _OURS or own is None or result.f1_5mm is None:
            continue
        count = counts_of.setdefault(row.method, [0, 0, 0])
        count[0] += 1
        count[1] += (own.f1_5mm or 0.0) > result.f1_5mm
        count[2] += (own.chamfer_1e3_m2 or 0.0) < (result.chamfer_1e3_m2 or 0.0)
    return [
        (suite.methods[method].title, str(n), f"{f1} of {n}", f"{chamfer} of {n}")
        for method, (n, f1, chamfer) in counts_of.items()
    ]


def lost_rows(suite: Suite, results: Results) -> list[str]:
    """One line for each value of F1 at 5 mm or Chamfer distance in which the default loses.

    It loses to another method on the same scene, or to itself with other settings.
    """
    plain = {
        row.scene: result
        for row, result in results
        if row.method == _OURS
        and result.f1_5mm is not None
        and row.case == Case(label=row.case.label)
    }
    ours = _ours(results)
    lines = []
    for row, result in results:
        own = ours.get((row.experiment, row.scene, row.case.label))
        what = row.how.title
        if row.method == _OURS:
            changed = Case(label=row.case.label, settings=row.case.settings)
            if not row.case.settings or row.case != changed:
                continue
            own, what = plain.get(row.scene), "with this setting"
        if own is None:
            continue
        where = f"{suite.experiments[row.experiment].title}: {row.scene} {row.case.label}".rstrip()
        if (result.f1_5mm or 0.0) > (own.f1_5mm or 0.0):
            lines.append(f"{where}: F1 5 mm {own.f1_5mm:.3f}, {what} {result.f1_5mm:.3f}")
        if (result.chamfer_1e3_m2 or np.inf) < (own.chamfer_1e3_m2 or 0.0):
            lines.append(
                f"{where}: Chamfer {own.chamfer_1e3_m2:.4f}, {what} {result.chamfer_1e3_m2:.4f}"
            )
    return lines


def _mean_lines(
    experiment: Experiment,
    suite: Suite,
    results: Results,
    used: Sequence[tuple[str, str, int, float]],
    has_cases: bool,
    n_published: int,
) -> list[tuple[str, ...]]:
    """Means over the scenes, for each method and setting with results of all of them."""
    if len(experiment.scenes) < 2:
        return []
    lines = []
    for case in experiment.cases:
        for method in experiment.methods:
            of = [r for row, r in results if row.method == method and row.case == case]
            if len(of) < len(experiment.scenes) or any(r.error is not None for r in of):
                continue
            cells = [f"mean of {len(of)}", *([case.label] if has_cases else [])]
            cells.append(suite.methods[method].title)
            for _, key, digits, factor in used:
                values = [getattr(r, key) for r in of]
                known = None not in values and key != "topology"
                cells.append(_number(sum(values) / len(values) if known else None, digits, factor))
            lines.append((*cells, *([""] * n_published)))
    return lines


def _number(value: float | str | None, digits: int, factor: float) -> str:
    if isinstance(value, str):
        return value
    return "" if value is None else f"{factor * value:.{digits}f}"


def _pictures(
    out: Path, table: Table, results: Results, suite: Suite, num_threads: int | None
) -> list[str]:
    parts, figures = list[str](), out / FIGURES_FOLDER
    gallery = figures / f"{table.name}.png"
    if draw_gallery(gallery, out, results, num_threads=num_threads):
        parts.append(html.picture(gallery, "The truth and the surface of each row, from one side."))
    slices = figures / f"{table.name}_slices.png"
    if draw_slices(slices, out, results):
        caption = (
            "Signed distance on a horizontal cut, its zero level (black), and the truth (green)."
        )
        parts.append(html.picture(slices, caption))
    sweep = figures / f"{table.name}_sweep.png"
    titles: Mapping[str, str] = {name: method.title for name, method in suite.methods.items()}
    if draw_sweep(sweep, table.experiment, results, titles):
        parts.append(html.picture(sweep, "F1 at 15 mm (full) and 5 mm (dashed)."))
    parts += _views(out, results)
    return parts


def _views(out: Path, results: Results) -> list[str]:
    """Projections of held-out planes, measured and rendered."""
    parts: dict[tuple[str, str], list[str]] = {}
    for row, result in results:
        if result.folder is None or row.how.kind != "render":
            continue
        for measured in sorted((out / result.folder / "views").glob("*_measured.png")):
            name = measured.name.removesuffix("_measured.png")
            plane = f"{row.scene}, {name.removeprefix('angle_')} degrees"
            # The measurement once, then the rendering of each method.
            shown = parts.setdefault(
                (row.scene, name), [html.picture(measured, f"{plane}, measured.")]
            )
            rendered = measured.with_name(f"{name}_rendered.png")
            caption = f"{plane}, {row.how.title}, {row.case.label or 'rendered'}."
            shown.append(html.picture(rendered, caption))
    return [picture for shown in parts.values() for picture in shown]
