"""Pages of a benchmark: tables as Markdown and CSV, and one HTML page with pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geraf2.apps.benchmark.pictures import Results, draw_gallery, draw_sweep
from geraf2.apps.benchmark.rows import RowResult
from geraf2.apps.benchmark.suite import Experiment, Suite
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
    ("CPU [s]", "cpu_seconds", 0, 1.0),
)
# What a smaller value is better for, and the value that others are best near to.
_SMALLER_IS_BETTER = ("chamfer_1e3_m2", "median_m")
_BEST_AT = {
    "volume_ratio": 1.0,
    **dict.fromkeys(("extent_x_m", "extent_y_m", "extent_z_m", "offset_m"), 0.0),
}
# Of a ladder: field, digits, factor.
_RUNG_FIGURES = (
    ("f1_15mm", 3, 1.0),
    ("f1_5mm", 3, 1.0),
    ("f1_3mm", 3, 1.0),
    ("f1_2mm", 3, 1.0),
    ("chamfer_1e3_m2", 4, 1.0),
    ("volume_ratio", 3, 1.0),
    ("extent_m", 1, 1e3),
)
_RUNG_HEAD = "F1 15 / 5 / 3 / 2 mm / CD / volume / worst extent [mm]"
_NOTE = (
    "All values are of simulated captures: single bounce, fixed seed, nothing aligned, scaled or "
    "cropped (docs/benchmark.md). Columns marked 'real data, published' are the paper's own, of "
    "other objects, another scan and after an alignment: they cannot be compared directly."
)


@dataclass(frozen=True, kw_only=True)
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
    text = html.render_template("benchmark.md", tables=tables, is_quick=suite.is_quick, note=_NOTE)
    write_text_atomic(out / MARKDOWN_NAME, text)
    sections = [
        (table, _pictures(out, table, of[table.name], suite, num_threads)) for table in tables
    ]
    page = out / PAGE_NAME
    text = html.render_template(
        "benchmark.html",
        title="geraf2 benchmark",
        facts=[("rows", len(results)), ("failed", sum(r.error is not None for _, r in results))],
        sections=sections,
        note=_NOTE,
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
    return Table(
        name=name,
        experiment=experiment,
        head=tuple(head),
        rows=tuple(lines),
        failures=tuple(failures),
        n_names=n_names,
        best=best,
        rungs=_rungs(experiment, suite, results) if experiment.ladder else (),
    )


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


def _rungs(experiment: Experiment, suite: Suite, results: Results) -> tuple[tuple[str, ...], ...]:
    """Head and lines of a ladder: means of each method, and its loss against the first case.

    The loss is the mean over common scenes of F1 at 5 mm of the first case minus that of this one.
    """
    by_case: dict[tuple[str, str], dict[str, RowResult]] = {}
    for row, result in results:
        by_case.setdefault((row.case.label, row.method), {})[row.scene] = result
    ideal = experiment.cases[0].label
    head = ["rung"]
    for method in experiment.methods:
        title = suite.methods[method].title
        head += [f"{title}: {_RUNG_HEAD}", "lost at 5 mm"]
    lines = [tuple(head)]
    for case in experiment.cases:
        cells = [case.label]
        for method in experiment.methods:
            own = by_case.get((case.label, method), {})
            cells += [_means(own, len(experiment.scenes))]
            cells += [_lost(by_case.get((ideal, method), {}), own)]
        if any(cells[1:]):
            lines.append(tuple(cells))
    return tuple(lines)


def _means(own: dict[str, RowResult], n_scenes: int) -> str:
    """Means of a method over the scenes of a case, with their number if not all."""
    if not own:
        return ""
    done = [result for result in own.values() if result.error is None]
    n_failed = len(own) - len(done)
    parts = []
    if done:
        parts.append(" / ".join(_mean(done, *figure) for figure in _RUNG_FIGURES))
        if len(done) < n_scenes:
            parts.append(f"of {len(done)}")
    if n_failed:
        parts.append(f"{n_failed} failed")
    return ", ".join(parts)


def _mean(done: Sequence[RowResult], key: str, digits: int, factor: float) -> str:
    values = [getattr(result, key) for result in done]
    known = [value for value in values if value is not None]
    return f"{factor * sum(known) / len(known):.{digits}f}" if known else "-"


def _lost(ideal: dict[str, RowResult], own: dict[str, RowResult]) -> str:
    pairs = [
        (ideal[scene].f1_5mm, result.f1_5mm) for scene, result in own.items() if scene in ideal
    ]
    known = [(a, b) for a, b in pairs if a is not None and b is not None]
    if not known or own is ideal:
        return ""
    return f"{sum(a - b for a, b in known) / len(known):+.3f}"


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
    sweep = figures / f"{table.name}_sweep.png"
    titles = {name: method.title for name, method in suite.methods.items()}
    if draw_sweep(sweep, table.experiment, results, titles):
        parts.append(html.picture(sweep, "F1 at 15 mm (full) and 5 mm (dashed)."))
    return parts
