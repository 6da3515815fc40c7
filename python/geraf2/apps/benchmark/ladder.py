"""Loss of each case of an experiment against its first, the ideal one."""

from collections.abc import Sequence

from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.apps.benchmark.suite import Experiment, Suite

Results = Sequence[tuple[Row, RowResult]]

# Result, digits, factor.
_FIGURES = (
    ("f1_15mm", 3, 1.0),
    ("f1_5mm", 3, 1.0),
    ("f1_3mm", 3, 1.0),
    ("f1_2mm", 3, 1.0),
    ("chamfer_1e3_m2", 4, 1.0),
    ("volume_ratio", 3, 1.0),
    ("extent_m", 1, 1e3),
)
_HEAD = "F1 15 / 5 / 3 / 2 mm / CD / volume / worst extent [mm]"


def ladder(
    experiment: Experiment, suite: Suite, results: Results
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and lines of a table of an experiment's cases: means and loss of each method.

    The loss is the mean over common scenes of F1 at 5 mm of the first case minus that of this one.
    Failed scenes are counted.

    experiment: the first case lacks the effects of the others. suite: has the methods' titles.
    results: of the experiment.
    """
    by_case: dict[tuple[str, str], dict[str, RowResult]] = {}
    for row, result in results:
        by_case.setdefault((row.case.label, row.method), {})[row.scene] = result
    ideal = experiment.cases[0].label
    head = ["rung"]
    for method in experiment.methods:
        title = suite.methods[method].title
        head += [f"{title}: {_HEAD}", "lost at 5 mm"]
    lines = []
    for case in experiment.cases:
        cells = [case.label]
        for method in experiment.methods:
            own = by_case.get((case.label, method), {})
            cells += [_means(own, len(experiment.scenes))]
            cells += [_lost(by_case.get((ideal, method), {}), own)]
        if any(cells[1:]):
            lines.append(tuple(cells))
    return tuple(head), lines


def _means(own: dict[str, RowResult], n_scenes: int) -> str:
    """Means of a method over the scenes of a case, with their number if not all."""
    if not own:
        return ""
    done = [result for result in own.values() if result.error is None]
    n_failed = len(own) - len(done)
    parts = []
    if done:
        parts.append(" / ".join(_mean(done, *figure) for figure in _FIGURES))
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
