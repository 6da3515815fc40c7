"""Progress and messages of a job, for a console, a log, a notebook or a scheduler."""

import logging
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext

from geraf2._types import Progress
from geraf2.scene.checks import Finding

LOGGER = logging.getLogger("geraf2.events")


class Listener:
    """Receives steps, findings, notes and warnings of a job; override what you want to show.

    By default steps are silent, and messages go to the logger "geraf2.events". Only the command
    line prints: its listener writes to the terminal. What a listener raises ends the job.

    Examples
    --------
    >>> class Loud(geraf2.Listener):
    ...     def step(self, label):
    ...         print(label)  # a context manager that yields a function of 0 to 1
    ...         return super().step(label)
    >>> prior = geraf2.load_prior((0.16, 0.16, 0.16), listener=Loud())
    """

    def step(self, label: str) -> AbstractContextManager[Progress]:
        """Context of one step of the job, whose value is called with the fraction done."""
        return nullcontext(lambda _: None)

    def warning(self, text: str) -> None:
        """Receive a warning."""
        LOGGER.warning("%s", text)

    def note(self, text: str) -> None:
        """Receive a note about a change of the data."""
        LOGGER.info("%s", text)

    def findings(self, findings: Iterable[Finding]) -> None:
        """Receive findings about implausible input."""
        for finding in findings:
            level = logging.ERROR if finding.severity == "error" else logging.WARNING
            LOGGER.log(level, "%s", finding)
