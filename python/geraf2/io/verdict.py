"""Verdict on a run: how far its result can be trusted, why, and what to do about it."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

VERDICT_STAGE = "verdict"
"""Stage of run.json whose numbers are a verdict."""
WITHDRAWN = (
    "expected_error_median_mm",
    "expected_error_95_percent_mm",
    "volume_95_percent_cm3",
    "extents_95_percent_mm",
    "likely_ghosts",
    "ruled_out",
    "permittivity",
    "permittivity_sigma",
    "thickness_m",
)
"""Numbers of stages that say how well the surface agrees with what is in the box: they are not
stated of a result that is not to be trusted. What describes the mesh itself is."""


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

    @classmethod
    def joined(cls, verdicts: Mapping[str, "Verdict"]) -> "Verdict | None":
        """Verdict on what rests on several runs, by their names; None without any."""
        if not verdicts:
            return None
        order = sorted(verdicts, key=lambda name: -verdicts[name].probability_of_failure)
        right = math.prod(1.0 - one.probability_of_failure for one in verdicts.values())
        return cls(
            trust=max((one.trust for one in verdicts.values()), key=list(Trust).index),
            probability_of_failure=1.0 - right,
            causes=tuple(
                replace(cause, text=f"in {name}, {cause.text}")
                for name in order
                for cause in verdicts[name].causes
            ),
            tests={name: verdicts[name].tests for name in order},
        )

    @property
    def likely_wrong(self) -> str:
        """Probability of failure in words: "97 % likely wrong"."""
        percent = 100.0 * self.probability_of_failure
        if percent < 1.0:
            return "less than 1 % likely wrong"
        return f"{min(percent, 99.0):.0f} % likely wrong"

    @property
    def condition(self) -> str:
        """Clause after what a doubtful result states; empty of other ones."""
        return f", if the scan is right ({self.likely_wrong})" * (self.trust is Trust.DOUBTFUL)

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """Name and text of the verdict, and of its first cause and what to do about it."""
        found = ("verdict", f"{self.trust} ({self.likely_wrong})")
        causes = self.causes[:1]
        because, do = [("because", c.text) for c in causes], [("do", c.action) for c in causes]
        return (found, *because, *do)

    @property
    def reason(self) -> str:
        """First cause."""
        return self.causes[0].text if self.causes else f"the result is {self.likely_wrong}"

    def __str__(self) -> str:
        return "; ".join(f"{name}: {text}" for name, text in self.lines)

    def numbers(self) -> dict[str, Any]:
        """Numbers of its stage in run.json."""
        return {
            "verdict": str(self.trust),
            "probability_of_failure": self.probability_of_failure,
            "causes": [asdict(cause) for cause in self.causes],
            "tests": dict(self.tests),
        }


def confidence(verdict: Verdict | None) -> float:
    """Factor of the probability of all that a run states: 0 where it is withdrawn, 0 to 1.

    1 for a reliable result, whose intervals were found to hold, and where there is no verdict.
    """
    if verdict is None or verdict.trust is Trust.RELIABLE:
        return 1.0
    is_withdrawn = verdict.trust is Trust.NOT_TO_BE_TRUSTED
    return 0.0 if is_withdrawn else 1.0 - verdict.probability_of_failure


def not_determined(verdict: Verdict | None) -> str:
    """Text in place of what a result that is not to be trusted would state; else empty."""
    if verdict is None or verdict.trust is not Trust.NOT_TO_BE_TRUSTED:
        return ""
    return f"not determined, because {verdict.reason}"


def stated_numbers(numbers: Mapping[str, Any], verdict: Verdict | None) -> dict[str, Any]:
    """Numbers of a stage without those that the verdict withdraws."""
    gone = WITHDRAWN if not_determined(verdict) else ()
    return {name: value for name, value in numbers.items() if name not in gone}
