"""Verdict on a run: how far its result can be trusted, why, and what to do about it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

VERDICT_STAGE = "verdict"
"""Stage of run.json whose numbers are a verdict."""


class Trust(StrEnum):
    """How far a result can be trusted."""

    RELIABLE = "reliable"
    DOUBTFUL = "doubtful"
    NOT_TO_BE_TRUSTED = "not to be trusted"


@dataclass(frozen=True)
class Cause:
    """One reason why a result may be wrong."""

    name: str
    """Short name of the test that found it, for programs."""
    text: str
    """What is wrong with the scan: a clause without a full stop."""
    action: str
    """What to do about it, in the imperative, without a full stop."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How far the result of a run can be trusted, why, and what to do about it."""

    trust: Trust
    """`reliable`, `doubtful` or `not to be trusted`."""
    probability_of_failure: float
    """Probability that less than half of the surface is right: an F1 at 5 mm below 0.5."""
    causes: tuple[Cause, ...] = ()
    """Reasons, the weightiest first; none of a reliable result."""
    tests: Mapping[str, Any]
    """Numbers of each test, by its name."""

    @classmethod
    def from_numbers(cls, numbers: Mapping[str, Any]) -> "Verdict | None":
        """Verdict of the numbers of its stage in run.json; None of a run without one."""
        if "verdict" not in numbers:
            return None
        return cls(
            trust=Trust(numbers["verdict"]),
            probability_of_failure=float(numbers["probability_of_failure"]),
            causes=tuple(Cause(**cause) for cause in numbers["causes"]),
            tests=numbers["tests"],
        )

    def numbers(self) -> dict[str, Any]:
        """Numbers of its stage in run.json."""
        return {
            "verdict": str(self.trust),
            "probability_of_failure": self.probability_of_failure,
            "causes": [asdict(cause) for cause in self.causes],
            "tests": dict(self.tests),
        }
