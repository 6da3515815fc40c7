"""Processor time of a benchmark: what was spent, and about how much is left."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

from geraf2.apps.benchmark.rows import Row
from geraf2.apps.benchmark.runner import Runner
from geraf2.apps.benchmark.suite import Suite


@dataclass
class Cost:
    """Of one experiment, or of all; a row or scene of several counts for the first alone."""

    n_rows: int = 0
    """Different rows."""
    n_known: int = 0
    """Of these, rows that were made."""
    spent_s: float = 0.0
    """Processor time of rows and scenes that were made [s]."""
    left_s: float = 0.0
    """About that of the others [s]: as the mean of the same method, and of scenes per plane."""
    n_unknown: int = 0
    """Rows and scenes to be made of which there is nothing to judge by."""


@dataclass
class _Means:
    """Mean of what was measured, by kind."""

    sums: dict[str, float] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)

    def add(self, kind: str, seconds: float, share: float = 1.0) -> None:
        self.sums[kind] = self.sums.get(kind, 0.0) + seconds
        self.counts[kind] = self.counts.get(kind, 0.0) + share

    def of(self, kind: str) -> float | None:
        return self.sums[kind] / self.counts[kind] if self.counts.get(kind) else None


def costs(runner: Runner, rows: Sequence[Row]) -> dict[str, Cost]:
    """Cost of each experiment, in the order of the rows.

    Failed rows are to be made again.
    """
    means = _Means()
    known: dict[str, float] = {}
    for row in rows:
        scene, run = (folder.name for folder in runner.place(row))
        result, scene_s = runner.known(row), runner.known_scene_seconds(row)
        if result is not None and result.error is None and run not in known:
            known[run] = result.all_cpu_seconds or 0.0
            means.add(f"method {row.method}", known[run])
        if scene_s is not None and scene not in known:
            known[scene] = scene_s
            means.add(_kind_of_scene(row), scene_s, _size_of_scene(row))
    total: dict[str, Cost] = {}
    seen: set[str] = set()
    for row in rows:
        scene, run = (folder.name for folder in runner.place(row))
        cost = total.setdefault(row.experiment, Cost())
        per_size, size = means.of(_kind_of_scene(row)), _size_of_scene(row)
        scene_guess = 0.0 if size == 0.0 else None if per_size is None else per_size * size
        guesses = ((scene, scene_guess), (run, means.of(f"method {row.method}")))
        for folder, guess in guesses:
            if folder in seen:
                continue
            seen.add(folder)
            cost.n_rows += folder == run
            if folder in known:
                cost.n_known += folder == run
                cost.spent_s += known[folder]
            elif guess is not None:
                cost.left_s += guess
            else:
                cost.n_unknown += 1
    return total


def _kind_of_scene(row: Row) -> str:
    return "scene" if row.spec.photos is None else "scene with photos"


def _size_of_scene(row: Row) -> float:
    """Tell what its cost grows with; 0 for a copy that says something else of its walls."""
    if row.case.told_permittivity != "true":
        return 0.0
    return 1.0 if row.spec.photos is not None else float(row.spec.scan.n_planes)


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
    if cost.left_s:
        parts.append(f"about {_minutes(cost.left_s)} left")
    if cost.n_unknown and (cost.n_known or cost.left_s):
        parts.append(f"and {cost.n_unknown} rows and scenes of which nothing is known")
    return ", ".join(parts)


def _minutes(seconds: float) -> str:
    return f"{seconds / 60.0:.1f} CPU minutes"
