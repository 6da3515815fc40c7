"""Tables of a benchmark: as Markdown, and as one HTML page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.apps.benchmark.suite import Experiment, Suite
from geraf2.io.atomic import write_text_atomic
from geraf2.report import html

MARKDOWN_NAME, PAGE_NAME = "benchmark.md", "benchmark.html"
Results = Sequence[tuple[Row, RowResult]]

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


def write_pages(out: Path, suite: Suite, results: Results) -> Path:
    """Write the tables of all finished rows; returns the HTML page.

    out: folder of the benchmark. suite: its experiments. results: rows with their values.
    """
    of = {
        name: [pair for pair in results if pair[0].experiment == name] for name in suite.experiments
    }
    tables = [make_table(name, suite, own) for name, own in of.items() if own]
    n_failed = sum(result.error is not None for _, result in results)
    about = {"tables": tables, "is_quick": suite.is_quick, "note": _NOTE}
    write_text_atomic(out / MARKDOWN_NAME, html.render_template("benchmark.md", **about))
    facts = [("rows", len(results)), ("failed", n_failed)]
    text = html.render_template("benchmark.html", title="geraf2 benchmark", facts=facts, **about)
    write_text_atomic(out / PAGE_NAME, text)
    return out / PAGE_NAME


def make_table(name: str, suite: Suite, results: Results) -> Table:
    """Table of one experiment; columns without any value are omitted."""
    experiment = suite.experiments[name]
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
        if result.error is not None:
            failures.append(f"{row.name}: {result.error}")
            cells += ["failed"] * len(used)
        else:
            cells += [_number(getattr(result, c[1]), c[2], c[3]) for c in used]
        own = experiment.published.get(row.scene, {}).get(row.method, {})
        lines.append((*cells, *(_number(own.get(key), 3, 1.0) for key in published)))
    lines += _mean_lines(experiment, suite, results, used, has_cases, len(published))
    return Table(
        name=name,
        experiment=experiment,
        head=tuple(head),
        rows=tuple(lines),
        failures=tuple(failures),
        n_names=3 if has_cases else 2,
    )


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
