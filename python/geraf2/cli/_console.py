"""Console of all commands: results, progress, warnings, common arguments."""

import json
import logging
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from geraf2._types import Progress as Report
from geraf2.errors import printable
from geraf2.pipeline.events import Listener
from geraf2.scene.checks import Finding

# Nothing is wrapped or highlighted: lines stay lines for grep, and paths stay copyable.
out = Console(highlight=False, soft_wrap=True, markup=False)
"""Console of results, stdout."""
err = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
"""Console of progress and warnings, stderr."""
PLAIN_PROGRESS_S = 60.0
"""Seconds between two lines of progress without a terminal."""


@dataclass
class _Output:
    """What the flags of all commands ask for, and what the command found."""

    quiet: bool = False
    """Warnings and errors alone."""
    threads: int | None = None
    """Most threads; all when None."""
    found: dict[str, Any] = field(default_factory=dict)
    """Results by name, for --json."""
    rows: dict[str, str] = field(default_factory=dict)
    """Rows by name, for a command that keeps no results."""
    warnings: list[str] = field(default_factory=list)
    """Warnings, for --json."""

    def as_json(self) -> dict[str, Any]:
        """Return what was found and warned of, in SI units, but for degrees and decibels."""
        found = self.found or ({"rows": self.rows} if self.rows else {})
        return {**_in_si(found), "warnings": self.warnings}


_TO_SI = {
    "_mm": ("_m", 1e-3),
    "_cm3": ("_m3", 1e-6),
    "_1e3_m2": ("_m2", 1e-3),
    "_percent": ("_share", 1e-2),
    "_mib": ("_bytes", 2.0**20),
}
"""Endings of names of values in other units: the ending in SI units, and the unit in them."""


def _in_si(value: Any, scale: float = 1.0) -> Any:
    """Values by names in SI units; None for what is not finite.

    >>> _in_si({"center_mm": [1.5, 2.0], "name": "ball"})
    {'center_m': [0.0015, 0.002], 'name': 'ball'}
    """
    if isinstance(value, Mapping):
        found = {}
        for name, inner in value.items():
            end = next((end for end in _TO_SI if str(name).endswith(end)), None)
            to, factor = _TO_SI[end] if end else ("", 1.0)
            found[f"{str(name).removesuffix(end or '')}{to}"] = _in_si(inner, scale * factor)
        return found
    if isinstance(value, list | tuple):
        return [_in_si(inner, scale) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(f"{scale * value:.9g}") if is_number and scale != 1.0 else value


_output = _Output()


@contextmanager
def show_output(
    command: str,
    *,
    as_json: bool = False,
    quiet: bool = False,
    verbose: bool = False,
    n_threads: int | None = None,
) -> Iterator[dict[str, Any]]:
    """Print, and use threads, as the flags of all commands ask for.

    With `as_json` everything goes to stderr, and stdout gets one JSON object at the end: what the
    block puts into the dictionary it gets, what the command kept, and all warnings.
    """
    result: dict[str, Any] = {"command": command}
    _output.quiet, _output.threads = quiet, n_threads
    _output.found, _output.rows, _output.warnings = {}, {}, []
    out.stderr = as_json
    handler = _LogHandler(logging.INFO if verbose else logging.WARNING)
    loggers = [logging.getLogger(name) for name in ("geraf2", "py.warnings")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.propagate = False
        logger.addHandler(handler)
        if verbose:
            logger.setLevel(logging.INFO)
    try:
        yield result
        if as_json:
            print(json.dumps(result | _output.as_json(), default=str))
    finally:
        _output.quiet, out.stderr = False, False
        for logger, level in zip(loggers, levels, strict=True):
            logger.propagate = True
            logger.setLevel(level)
            logger.removeHandler(handler)


def threads() -> int | None:
    """Most threads, of `--threads`; None for all."""
    return _output.threads


def keep(found: Mapping[str, Any]) -> None:
    """Keep results for `--json`."""
    _output.found.update(found)


class _LogHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        text = printable(" ".join(record.getMessage().split()))
        style = "yellow" if record.levelno >= logging.WARNING else None
        if style:
            _output.warnings.append(text)
        err.print(f"{record.levelname.lower()}: {text}", style=style)


def say(text: str = "", style: str | None = None) -> None:
    """Print one line of results, unless only warnings are asked for."""
    if not _output.quiet:
        out.print(printable(text), style=style)


def warn(text: str) -> None:
    """Print a warning, and keep it for `--json`."""
    _output.warnings.append(text)
    err.print(f"warning: {printable(text)}", style="yellow")


def print_findings(findings: Iterable[Finding]) -> None:
    """Print findings, errors in red."""
    for finding in findings:
        style = "red" if finding.severity == "error" else "yellow"
        _output.warnings.append(str(finding))
        err.print(f"{finding.severity}: {printable(str(finding))}", style=style)


def rows(pairs: list[tuple[str, str]], style: str | None = None) -> None:
    """Print names and values in two columns."""
    width = max((len(name) for name, _ in pairs), default=0)
    for name, value in pairs:
        say(f"{name:<{width}}  {value}", style)
    _output.rows.update(pairs)


def _bar() -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=err)


@contextmanager
def progress_bar(label: str) -> Iterator[Report]:
    """Progress of one step with the time left; a plain line a minute without a terminal."""
    start = time.perf_counter()
    if _output.quiet:
        yield lambda _: None
        return
    if not err.is_terminal:
        err.print(f"{label} ...")
        yield _PlainProgress(label)
        err.print(f"{label}: {time.perf_counter() - start:.1f} s")
        return
    with _bar() as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)
        bar.update(task, completed=1.0)


class _PlainProgress:
    """A line a minute: how much is done, and how long the rest takes at the pace so far."""

    def __init__(self, label: str) -> None:
        self._label, self._reported_s = label, time.monotonic()
        self._first: tuple[float, float] | None = None

    def __call__(self, fraction: float) -> None:
        now = time.monotonic()
        if self._first is None:  # a resumed run does not begin at zero
            self._first = now, fraction
        if now - self._reported_s < PLAIN_PROGRESS_S:
            return
        self._reported_s = now
        start, before = self._first
        rest = ""
        if fraction > before:
            left_s = (now - start) * (1.0 - fraction) / (fraction - before)
            rest = f", {timedelta(seconds=round(left_s))} left"
        err.print(f"{self._label}: {100.0 * fraction:.0f} %{rest}")


class _Steps:
    """Progress of all steps of a command, on one bar of a terminal."""

    def __init__(self, steps: Mapping[str, tuple[str, float]], bar: Progress | None) -> None:
        """Start; `steps` has users' words and share of the time of each, by its label."""
        self._steps, self._bar = steps, bar
        self._total = sum(share for _, share in steps.values())
        self._done, self._start = 0.0, time.perf_counter()
        self._task = bar.add_task("", total=self._total) if bar else None

    @contextmanager
    def step(self, label: str) -> Iterator[Report]:
        name, bracket, rest = label.partition(" (")
        words, share = self._steps.get(name, (name, 0.0))
        words += bracket + rest
        before, start = self._done, time.perf_counter()
        if self._bar is None or self._task is None:
            err.print(f"{words} ...")
            yield _PlainProgress(words)
        else:
            bar, task = self._bar, self._task
            bar.update(task, description=words)
            yield lambda fraction: bar.update(task, completed=before + share * fraction)
            bar.update(task, completed=before + share)
        self._done = before + share
        if self._bar is None:
            now = time.perf_counter()
            left = (now - self._start) * (self._total / self._done - 1.0) if self._done else 0.0
            of_all = f"{100.0 * self._done / self._total:.0f} % of all"
            err.print(f"{words}: {now - start:.1f} s; {of_all}, about {left:.0f} s left")


class _ConsoleListener(Listener):
    """Steps, warnings and findings of a job on the terminal."""

    _whole: _Steps | None = None

    @contextmanager
    def show_as_one(self, steps: Mapping[str, tuple[str, float]]) -> Iterator[None]:
        """Show the steps inside the block as one; see `_Steps`."""
        shown = err.is_terminal and not _output.quiet
        with _bar() if shown else nullcontext() as bar:
            self._whole = None if _output.quiet else _Steps(steps, bar)
            try:
                yield
            finally:
                self._whole = None

    def step(self, label: str) -> AbstractContextManager[Report]:
        return self._whole.step(label) if self._whole else progress_bar(label)

    def warning(self, text: str) -> None:
        warn(text)

    def note(self, text: str) -> None:
        if not _output.quiet:
            err.print(printable(text))

    def findings(self, findings: Iterable[Finding]) -> None:
        print_findings(findings)


CONSOLE = _ConsoleListener()
