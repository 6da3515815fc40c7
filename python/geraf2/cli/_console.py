"""Console of all commands: results, progress, warnings, common arguments."""

import logging
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from datetime import timedelta
from typing import Annotated

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from geraf2._bounds import Arg, ThreadCount
from geraf2._types import Progress as Report
from geraf2.errors import printable
from geraf2.pipeline.events import Listener
from geraf2.scene.checks import Finding

Threads = Annotated[ThreadCount | None, Arg(metavar="N")]

__all__ = [
    "CONSOLE",
    "Threads",
    "err",
    "out",
    "print_findings",
    "progress_bar",
    "rows",
    "say",
    "showing_log_records",
    "warn",
]

# Nothing is wrapped or highlighted: lines stay lines for grep, and paths stay copyable.
out = Console(highlight=False, soft_wrap=True, markup=False)
"""Console of results, stdout."""
err = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
"""Console of progress and warnings, stderr."""
PLAIN_PROGRESS_S = 60.0
"""Seconds between two lines of progress without a terminal."""


def say(text: str = "") -> None:
    """Print one line of results."""
    out.print(printable(text))


def warn(text: str) -> None:
    """Print a warning."""
    err.print(f"warning: {printable(text)}", style="yellow")


def print_findings(findings: Iterable[Finding]) -> None:
    """Print findings, errors in red."""
    for finding in findings:
        style = "red" if finding.severity == "error" else "yellow"
        err.print(f"{finding.severity}: {printable(str(finding))}", style=style)


def rows(pairs: list[tuple[str, str]]) -> None:
    """Print names and values in two columns."""
    width = max((len(name) for name, _ in pairs), default=0)
    for name, value in pairs:
        say(f"{name:<{width}}  {value}")


@contextmanager
def progress_bar(label: str) -> Iterator[Report]:
    """Progress of one step with the time left; a plain line a minute without a terminal."""
    start = time.perf_counter()
    if not err.is_terminal:
        err.print(f"{label} ...")
        yield _PlainProgress(label)
        err.print(f"{label}: {time.perf_counter() - start:.1f} s")
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)
        bar.update(task, completed=1.0)


class _PlainProgress:
    """A line a minute: how much is done, and how long the rest takes at the pace so far."""

    def __init__(self, label: str) -> None:
        self._label, self._told = label, time.monotonic()
        self._first: tuple[float, float] | None = None

    def __call__(self, fraction: float) -> None:
        now = time.monotonic()
        if self._first is None:  # a resumed run does not begin at zero
            self._first = now, fraction
        if now - self._told < PLAIN_PROGRESS_S:
            return
        self._told = now
        start, before = self._first
        rest = ""
        if fraction > before:
            left_s = (now - start) * (1.0 - fraction) / (fraction - before)
            rest = f", {timedelta(seconds=round(left_s))} left"
        err.print(f"{self._label}: {100.0 * fraction:.0f} %{rest}")


class _ConsoleListener(Listener):
    """Progress, warnings, notes and findings of a job on the terminal."""

    def step(self, label: str) -> AbstractContextManager[Report]:
        return progress_bar(label)

    def warning(self, text: str) -> None:
        warn(text)

    def note(self, text: str) -> None:
        err.print(printable(text))

    def findings(self, findings: Iterable[Finding]) -> None:
        print_findings(findings)


CONSOLE = _ConsoleListener()


class _PrintableFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(" ".join(super().format(record).split()))


@contextmanager
def showing_log_records() -> Iterator[None]:
    """Show warnings that modules log, and Python's own, on the terminal."""
    from rich.logging import RichHandler  # noqa: PLC0415 - 0.1 s, needed by long commands only

    handler = RichHandler(
        level=logging.WARNING, console=err, show_time=False, show_path=False, markup=False
    )
    handler.setFormatter(_PrintableFormatter())
    loggers = [logging.getLogger(name) for name in ("geraf2", "py.warnings")]
    for logger in loggers:
        logger.propagate = False
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger in loggers:
            logger.propagate = True
            logger.removeHandler(handler)
