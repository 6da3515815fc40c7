"""Processor time of a benchmark: spent, and estimated for the remaining rows."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

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


class _Piece(NamedTuple):
    """A run or a scene, which rows may share."""

    experiment: str
    kind: str
    """Name of its method, or _SCENE."""
    size: float
    """Quantity to which the cost is proportional; 0 for a scene copied with other walls."""
    seconds: float | None
    """Processor time; None where it is to be made."""


def costs(runner: Runner, rows: Sequence[Row]) -> dict[str, Cost]:
    """Cost of each experiment, in the order of the rows; failed rows count as remaining."""
    pieces: dict[str, _Piece] = {}
    for row in rows:
        scene, run = (folder.name for folder in runner.folders(row))
        size = float(row.spec.scan.n_planes) if row.case.given_permittivity == "true" else 0.0
        scene_s, result = runner.known_scene_seconds(row), runner.known(row)
        is_done = result is not None and result.error is None
        seconds = (result.all_cpu_seconds or 0.0) if is_done and result is not None else None
        pieces.setdefault(scene, _Piece(row.experiment, _SCENE, size, scene_s))
        pieces.setdefault(run, _Piece(row.experiment, row.method, 1.0, seconds))
    spent: dict[str, float] = defaultdict(float)
    sizes: dict[str, float] = defaultdict(float)
    for piece in pieces.values():
        if piece.seconds is not None:
            spent[piece.kind] += piece.seconds
            sizes[piece.kind] += piece.size
    total = {row.experiment: Cost() for row in rows}
    for piece in pieces.values():
        cost = total[piece.experiment]
        cost.n_rows += piece.kind != _SCENE
        if piece.seconds is not None:
            cost.n_known += piece.kind != _SCENE
            cost.spent_s += piece.seconds
        elif sizes[piece.kind] or not piece.size:
            cost.remaining_s += piece.size * spent[piece.kind] / max(sizes[piece.kind], 1.0)
        else:
            cost.n_unknown += 1
    return total


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
