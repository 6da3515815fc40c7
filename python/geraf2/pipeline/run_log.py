"""Log of a run: records and warnings go to its folder and to the listener."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager

from geraf2._types import Progress
from geraf2.io.run_folder import RunFolder
from geraf2.pipeline.events import LOGGER, Listener
from geraf2.scene.checks import Finding

_LOGGERS = ("geraf2", "py.warnings")


class _RunLogHandler(logging.Handler):
    """Writes one JSON line per record; warnings also go to the run's record."""

    def __init__(self, run: RunFolder) -> None:
        super().__init__(logging.INFO)
        self._run = run

    def emit(self, record: logging.LogRecord) -> None:
        if record.name == LOGGER.name:  # RunListener records these
            return
        message, level = " ".join(record.getMessage().split()), record.levelname.lower()
        if record.levelno >= logging.WARNING:
            self._run.warn(message, level)
        else:
            self._run.log(message, level=level, logger=record.name)


@contextmanager
def record_logs(run: RunFolder) -> Iterator[None]:
    """Send records of geraf2 and warnings of Python to the run's log."""
    handler = _RunLogHandler(run)
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.INFO)
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
            logger.removeHandler(handler)


class RunListener(Listener):
    """Records warnings, notes and findings in the run, and forwards them to another listener."""

    def __init__(self, run: RunFolder, listener: Listener) -> None:
        self._run, self._listener = run, listener

    def step(self, label: str) -> AbstractContextManager[Progress]:
        """Forward the step."""
        return self._listener.step(label)

    def warning(self, text: str) -> None:
        """Record and forward it."""
        self._run.warn(text)
        self._listener.warning(text)

    def note(self, text: str) -> None:
        """Record and forward it."""
        self._run.warn(text, "info")
        self._listener.note(text)

    def findings(self, findings: Iterable[Finding]) -> None:
        """Record and forward them."""
        found = tuple(findings)
        for finding in found:
            self._run.warn(str(finding), finding.severity)
        self._listener.findings(found)
