"""One line a rung: what each case of an experiment costs against its first, the ideal."""

from collections.abc import Sequence

from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.apps.benchmark.suite import Experiment, Suite

Results = Sequence[tuple[Row, RowResult]]

_FIGURES = (("f1_15mm", 3), ("f1_5mm", 3), ("f1_3mm", 3), ("chamfer_1e3_m2", 4))
_HEAD = "F1 15 / 5 / 3 mm / CD"


def ladder(
    experiment: Experiment, suite: Suite, results: Results
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of an experiment's cases: for each method the means, and what is lost at 5 mm.

    Lost is the mean of F1 at 5 mm of the first case less that of this one, over the scenes that
    both have. A method that failed on scenes of a case says on how many.

    experiment: whose first case is without the effects of the others.
    suite: where methods have their titles.
    results: of the experiment.

    Returns the head, and a line for each case that has results.
    """
    by_place: dict[tuple[str, str], dict[str, RowResult]] = {}
    for row, result in results:
        by_place.setdefault((row.case.label, row.method), {})[row.scene] = result
    ideal = experiment.cases[0].label
    head = ["rung"]
    for method in experiment.methods:
        title = suite.methods[method].title
        head += [f"{title}: {_HEAD}", "lost at 5 mm"]
    lines = []
    for case in experiment.cases:
        cells = [case.label]
        for method in experiment.methods:
            own = by_place.get((case.label, method), {})
            cells += [_means(own, len(experiment.scenes))]
            cells += [_lost(by_place.get((ideal, method), {}), own)]
        if any(cells[1:]):
            lines.append(tuple(cells))
    return tuple(head), lines


def _means(own: dict[str, RowResult], n_scenes: int) -> str:
    """Means of a method over the scenes of a case, and of how many where not of all."""
    if not own:
        return ""
    done = [result for result in own.values() if result.error is None]
    n_failed = len(own) - len(done)
    parts = []
    if done:
        means = [
            f"{sum(getattr(result, key) or 0.0 for result in done) / len(done):.{digits}f}"
            for key, digits in _FIGURES
        ]
        parts.append(" / ".join(means))
        if len(done) < n_scenes:
            parts.append(f"of {len(done)}")
    if n_failed:
        parts.append(f"{n_failed} failed")
    return ", ".join(parts)


def _lost(ideal: dict[str, RowResult], own: dict[str, RowResult]) -> str:
    pairs = [
        (ideal[scene].f1_5mm, result.f1_5mm) for scene, result in own.items() if scene in ideal
    ]
    known = [(a, b) for a, b in pairs if a is not None and b is not None]
    if not known or own is ideal:
        return ""
    return f"{sum(a - b for a, b in known) / len(known):+.3f}"
