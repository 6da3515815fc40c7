"""Tables of scenes by seed: means, quantiles, failures, paired differences with intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from geraf2._types import Floats

FAILED_F1 = 0.5
"""F1 at 5 mm below which a reconstruction counts as failed."""
_N_RESAMPLES = 2000
"""Resamples of the bootstrap."""
METRICS = (
    ("f1_5mm", "F1 at 5 mm", 3),
    ("f1_3mm", "F1 at 3 mm", 3),
    ("f1_2mm", "F1 at 2 mm", 3),
    ("chamfer_1e3_m2", "Chamfer distance [1e-3 m2]", 4),
    ("volume_ratio", "volume over the true one", 3),
    ("extent_x_mm", "error of extent, x [mm]", 2),
    ("extent_y_mm", "error of extent, y [mm]", 2),
    ("extent_z_mm", "error of extent, z [mm]", 2),
    ("offset_mm", "offset along the normal, median [mm]", 2),
    ("within_one", "within one expected error", 3),
    ("within_two", "within two expected errors", 3),
    ("rank", "rank correlation of errors", 3),
    ("volume_covered", "volume within its 95 % interval", 3),
    ("extents_covered", "extents within their 95 % intervals", 3),
    ("cpu_seconds", "CPU seconds", 1),
)
"""Names of scores, titles and digits."""
_ZERO_IF_FAILED = ("f1_5mm", "f1_3mm", "f1_2mm")
VOLUME_TOLERANCE, EXTENT_TOLERANCE_MM = 0.05, 2.0
"""Errors of volume, relative, and of an extent [mm] that an inspection accepts."""
_EXTENTS = ("extent_x_mm", "extent_y_mm", "extent_z_mm")
_GROUP_SCORES = ("within_one", "within_two", "rank", "f1_5mm", "f1_2mm")
_GROUPS = (
    ("world", ("none", "plausible", "hard")),
    ("material", ("metal", "plastic")),
    ("far walls", ("without", "with echoes")),
    ("scan", ("one ring", "raised planes")),
)


@dataclass(frozen=True, kw_only=True)
class SeedResult:
    """Scores of a preset on one seed, or why there are none."""

    seed: int
    """Of the population."""
    preset: str
    """Of the reconstruction."""
    version: str
    """Digest of all that the scores depend on but the seed."""
    scores: dict[str, float] = field(default_factory=dict)
    """By name; lengths in millimetres."""
    error: str | None = None
    """One line, where it failed."""

    def score(self, name: str) -> float:
        """One score; of a run that ended with an error 0 for F1, NaN for others."""
        missing = 0.0 if self.error is not None and name in _ZERO_IF_FAILED else np.nan
        return self.scores.get(name, missing)


class Interval(NamedTuple):
    """An estimate and the bounds that hold it with 95 %."""

    value: float
    low: float
    high: float


Records = Mapping[int, Mapping[str, Any]]
"""What was drawn, by seed."""


def mean_interval(values: Floats) -> Interval:
    """Mean of values, (n,), with the bootstrap's 95 % interval."""
    means = values[_draws(len(values))].mean(axis=1)
    return Interval(float(values.mean()), *_bounds(means))


def quantile_change(before: Floats, after: Floats) -> Interval:
    """Change of the 5 % quantile between paired values, (n,) each, with its 95 % interval."""
    draws = _draws(len(before))
    low = np.quantile(before[draws], 0.05, axis=1)
    high = np.quantile(after[draws], 0.05, axis=1)
    value = np.quantile(after, 0.05) - np.quantile(before, 0.05)
    return Interval(float(value), *_bounds(high - low))


def _draws(n: int) -> "np.ndarray[tuple[int, int], np.dtype[np.int64]]":
    """Draw the indices of resamples; equal numbers of values get equal ones, so pairs stay."""
    return np.random.default_rng(0).integers(0, n, (_N_RESAMPLES, n))


def _bounds(values: Floats) -> tuple[float, float]:
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def preset_table(
    preset: str, results: Sequence[SeedResult], records: Records | None = None
) -> list[str]:
    """Lines of one preset: each score with mean, interval, and quantiles.

    Then shares of scenes whose sizes are right, and means by what was drawn, where `records`
    has the seeds.
    """
    errors = [result for result in results if result.error is not None]
    poor = [r for r in results if r.error is None and r.score("f1_5mm") < FAILED_F1]
    n_failed = len(errors) + len(poor)
    lines = [
        f"{preset}: {len(results)} seeds, {n_failed} failed ({n_failed / len(results):.1%}): "
        f"{len(errors)} with an error, {len(poor)} with F1 at 5 mm below {FAILED_F1:g}",
        f"  {'':38}{'mean':>9}{'95 % interval':>21}{'5 %':>9}{'95 %':>9}{'seeds':>7}",
    ]
    for name, title, digits in METRICS:
        values = _known(results, name)
        if not len(values):
            continue
        low, high = np.quantile(values, (0.05, 0.95))
        ends = f"{low:9.{digits}f}{high:9.{digits}f}"
        lines.append(f"  {title:38}{_text(mean_interval(values), digits)}{ends}{len(values):7d}")
    lines += _size_lines(results)
    lines += _group_lines(results, records or {})
    if errors or poor:
        lines.append("  failed: " + ", ".join(str(r.seed) for r in [*errors, *poor]))
    return lines


def _size_lines(results: Sequence[SeedResult]) -> list[str]:
    """Shares of scenes with the right volume and extents, a failure counts as a miss; |offset|."""
    volume = np.array([abs(r.score("volume_ratio") - 1.0) for r in results])
    extents = np.abs([[r.score(name) for name in _EXTENTS] for r in results])
    offset = np.abs(_known(results, "offset_mm"))
    small = extents <= EXTENT_TOLERANCE_MM
    rows = [
        (f"share with volume within {VOLUME_TOLERANCE:.0%}", volume <= VOLUME_TOLERANCE),
        (f"share of extents within {EXTENT_TOLERANCE_MM:g} mm", small.mean(axis=1)),
        (f"share with all three within {EXTENT_TOLERANCE_MM:g} mm", small.all(axis=1)),
    ]
    lines = []
    for title, hits in rows:
        mean = mean_interval(np.asarray(hits, dtype=float))
        lines.append(f"  {title:38}{_text(mean, 3)}{'':18}{len(hits):7d}")
    if len(offset):
        medians = np.median(offset[_draws(len(offset))], axis=1)
        median = Interval(float(np.median(offset)), *_bounds(medians))
        title = "median of |offset| [mm]"
        lines.append(f"  {title:38}{_text(median, 2)}{'':18}{len(offset):7d}")
    return lines


def _group_lines(results: Sequence[SeedResult], records: Records) -> list[str]:
    """Coverage of the expected error, offset and F1 of the seeds of each world and material."""
    head = ("within 1", "within 2", "rank", "|offset|", "F1 5 mm", "F1 2 mm", "seeds")
    lines = []
    for key, values in _GROUPS:
        for value in values:
            own = [r for r in results if records.get(r.seed, {}).get(key) == value]
            if own:
                offset = np.abs(_known(own, "offset_mm"))
                of_own = [_known(own, name) for name in _GROUP_SCORES]
                cells = [f"{values.mean():.3f}" if len(values) else "-" for values in of_own]
                cells.insert(3, f"{np.median(offset):.2f}" if len(offset) else "-")
                text = "".join(f"{cell:>10}" for cell in [*cells, str(len(own))])
                lines.append(f"  {f'{key} {value}':22}{text}")
    return [f"  {'':22}" + "".join(f"{name:>10}" for name in head), *lines] if lines else []


def _known(results: Sequence[SeedResult], name: str) -> Floats:
    """Return one score of all results that have it, (n,)."""
    values = np.array([result.score(name) for result in results])
    return np.asarray(values[np.isfinite(values)])


def _text(interval: Interval, digits: int, sign: str = "") -> str:
    number = f"{sign}.{digits}f"
    within = f"{interval.low:{number}} to {interval.high:{number}}"
    return f"{interval.value:{number}}".rjust(9) + within.rjust(21)


def paired_table(
    title: str, before: Sequence[SeedResult], after: Sequence[SeedResult]
) -> list[str]:
    """Lines of paired differences, after less before, on the seeds that both have."""
    known: Mapping[int, SeedResult] = {result.seed: result for result in before}
    pairs = [(known[result.seed], result) for result in after if result.seed in known]
    if not pairs:
        return [f"{title}: no seed in common"]
    lines = [
        f"{title}: paired differences on {len(pairs)} seeds",
        f"  {'':38}{'mean':>9}{'95 % interval':>21}{'5 %':>9}{'95 % interval':>21}{'higher':>9}",
    ]
    for name, label, digits in METRICS:
        values = np.array([[a.score(name), b.score(name)] for a, b in pairs])
        values = values[np.isfinite(values).all(axis=1)]
        if not len(values):
            continue
        first, second = values.T
        mean, quantile = mean_interval(second - first), quantile_change(first, second)
        cells = _text(mean, digits, "+") + _text(quantile, digits, "+")
        higher = f"{int((second > first).sum())}/{len(values)}"
        lines.append(f"  {label:38}{cells}{higher:>9}")
    return lines
