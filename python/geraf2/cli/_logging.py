"""Log records of all layers go to the terminal and into the run's log.jsonl."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from geraf2.cli._console import err
from geraf2.io.run_folder import RunFolder

_LOGGERS = ("geraf2", "py.warnings")


class _RunLogHandler(logging.Handler):
    """One JSON line a record."""

    def __init__(self, run: RunFolder) -> None:
        super().__init__(logging.INFO)
        self._run = run

    def emit(self, record: logging.LogRecord) -> None:
        message = " ".join(record.getMessage().split())
        self._run.log(message, level=record.levelname.lower(), logger=record.name)


@contextmanager
def logging_to(run: RunFolder) -> Iterator[None]:
    """Send records of geraf2 and warnings of Python to the terminal and to the run's log."""
    from rich.logging import RichHandler  # noqa: PLC0415 - 0.1 s, needed by long commands only

    terminal = RichHandler(
        level=logging.WARNING, console=err, show_time=False, show_path=False, markup=False
    )
    handlers: list[logging.Handler] = [terminal, _RunLogHandler(run)]
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    before = [(logger.level, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.INFO)
        logger.propagate = False
        for handler in handlers:
            logger.addHandler(handler)
    try:
        yield
    finally:
        for logger, (level, propagate) in zip(loggers, before, strict=True):
            logger.setLevel(level)
            logger.propagate = propagate
            for handler in handlers:
                logger.removeHandler(handler)
