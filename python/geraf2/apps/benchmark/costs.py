"""Processor time of a benchmark: spent, and estimated for the remaining rows."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from geraf2.apps.benchmark.rows import Row
from geraf2.apps.benchmark.runner import Runner
from geraf2.apps.benchmark.suite import Suite

_SCENE = "a scene"
"""Key beside the names of methods."""


@dataclass
class Cost:
    """Cost of one experiment, or of all; shared rows and scenes count for the first one."""

    n_rows: int = 0
    """Number of different rows."""
    n_known: int = 0
    """Number of finished rows."""
    spent_s: float = 0.0
    """Processor time of finished rows and scenes [s]."""
    remaining_s: float = 0.0
    """Estimate for the others [s]: mean of the method, and of scenes per plane."""
    n_unknown: int = 0
    """Number of remaining rows and scenes without an estimate."""


def costs(runner: Runner, rows: Sequence[Row]) -> dict[str, Cost]:
    """Cost of each experiment, in the order of the rows; failed rows count as remaining."""
    known: dict[str, float] = {}
    sums: dict[str, float] = defaultdict(float)
    counts: dict[str, float] = defaultdict(float)
    for row in rows:
        scene, run = (folder.name for folder in runner.place(row))
        result, scene_s = runner.known(row), runner.known_scene_seconds(row)
        if result is not None and result.error is None and run not in known:
            known[run] = result.all_cpu_seconds or 0.0
            sums[row.method] += known[run]
            counts[row.method] += 1.0
        if scene_s is not None and scene not in known:
            known[scene] = scene_s
            sums[_SCENE] += scene_s
            counts[_SCENE] += _size_of_scene(row)
    means = {kind: sums[kind] / count for kind, count in counts.items() if count}
    total: dict[str, Cost] = {}
    seen: set[str] = set()
    for row in rows:
        scene, run = (folder.name for folder in runner.place(row))
        cost = total.setdefault(row.experiment, Cost())
        per_size, size = means.get(_SCENE), _size_of_scene(row)
        scene_guess = 0.0 if size == 0.0 else None if per_size is None else per_size * size
        for folder, guess in ((scene, scene_guess), (run, means.get(row.method))):
            if folder in seen:
                continue
            seen.add(folder)
            cost.n_rows += folder == run
            if folder in known:
                cost.n_known += folder == run
                cost.spent_s += known[folder]
            elif guess is not None:
                cost.remaining_s += guess
            else:
                cost.n_unknown += 1
    return total


def _size_of_scene(row: Row) -> float:
    """Quantity to which the cost is proportional; 0 for a copy with other walls."""
    return float(row.spec.scan.n_planes) if row.case.told_permittivity == "true" else 0.0


def listed(suite: Suite, spent: Mapping[str, Cost]) -> list[tuple[str, str]]:
    """Names of experiments with their rows and processor time, and those of all, as text."""
    lines, total = [], Cost()
    for name, cost in spent.items():
        lines.append((name, f"{suite.experiments[name].title} ({_text(cost)})"))
        for entry in fields(Cost):
            sum_ = getattr(total, entry.name) + getattr(cost, entry.name)
            setattr(total, entry.name, sum_)
    return [*lines, ("all", _text(total))]


def _text(cost: Cost) -> str:
    parts = [f"{cost.n_rows} rows"]
    if cost.n_known:
        parts.append(f"{cost.n_known} made in {_minutes(cost.spent_s)}")
    if cost.remaining_s:
        parts.append(f"about {_minutes(cost.remaining_s)} left")
    if cost.n_unknown and (cost.n_known or cost.remaining_s):
        parts.append(f"and {cost.n_unknown} rows and scenes of unknown cost")
    return ", ".join(parts)


def _minutes(seconds: float) -> str:
    return f"{seconds / 60.0:.1f} CPU minutes"
