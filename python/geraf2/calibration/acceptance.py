"""Rule of acceptance: held-out data must fit better by more than three standard errors."""

from dataclasses import dataclass, field

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError

N_SIGMAS = 3.0
"""Least growth of the held-out log-likelihood, in standard errors."""
N_INDEPENDENT = 4.0
"""Independent phases of an echo. Its shift, slopes and curvatures take six of 24 sums, and
neighbouring sub-apertures share their antennas with six others."""


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Decision about one correction."""

    name: str
    """leakage, channels, delay, frame, axis or positions."""
    applied: bool
    text: str
    """Values, uncertainties and result on held-out data, in one line."""
    against: str = ""
    """Reason for not applying it."""
    error: UserError | None = None
    """Reason for a failed estimate, raised if the user requested this correction."""
    numbers: dict[str, float] = field(default_factory=dict)
    """Values and standard deviations in SI units; gain of the log-likelihood and its error."""

    def __str__(self) -> str:
        return f"{self.name}: {self.text}" + (
            f"; not applied, {self.against}" if self.against else ""
        )


@dataclass(frozen=True, kw_only=True)
class Gain:
    """Growth of the log-likelihood of held-out data [nats]."""

    nats: float
    error: float
    """Standard error [nats]."""

    @classmethod
    def of(cls, nats: Floats, *, is_modelled: bool = False, prior: float = 0.0) -> "Gain":
        """Sum over data, with its standard error.

        A Gaussian log-likelihood ratio of mean g has the standard deviation sqrt(2 g). Its mean is
        about -g without the error to correct and about +g with it. From 4.5 nats on, both differ by
        three standard deviations, so the error is at least sqrt(g / 2).

        nats: growth at each datum, (n,).
        is_modelled: whether the likelihood has its own standard deviations; else the spread of the
            data also counts.
        prior: growth of the log-density of unknowns that held-out data share with the rest.
        """
        total = float(nats.sum()) + prior
        error = (0.5 * max(total, 0.0)) ** 0.5
        if not is_modelled:
            error = max(error, float(nats.std()) * len(nats) ** 0.5 if len(nats) else 0.0)
        return cls(nats=total, error=error)

    @property
    def is_sure(self) -> bool:
        """Whether the gain exceeds three standard errors."""
        return self.nats > N_SIGMAS * self.error

    def __str__(self) -> str:
        return f"held-out log-likelihood {self.nats:+z.1f} +- {self.error:.1f}"


def coherence_nats(before: Floats, after: Floats, powers: Floats | float = 1.0) -> Floats:
    """Growth of the log-likelihood of echoes to first order, (n,).

    The terms z of an echo are a constant plus noise of power P (1 - c^2), c = |sum z| / sum |z|.
    All echoes have the same noise, so strong ones count most.

    before, after: coherence c, (n,). powers: P, (n,).
    """
    noise = powers * (1.0 - np.stack([before, after]) ** 2)
    mean = float(noise.mean()) if noise.size else 0.0
    return np.asarray(N_INDEPENDENT * (noise[0] - noise[1]) / max(mean, 1e-300))


def judge(name: str, text: str, numbers: dict[str, float], gain: Gain) -> Judgement:
    """Accept or refuse a correction by its gain; text and numbers describe the estimate."""
    return Judgement(
        name=name,
        applied=gain.is_sure,
        text=f"{text}; {gain}",
        against="" if gain.is_sure else "held-out echoes fit no better",
        numbers=numbers | {"gain": gain.nats, "gain_error": gain.error},
    )


def nothing_found(name: str, text: str, against: str, error: UserError | None = None) -> Judgement:
    """Judgement of a failed estimate."""
    return Judgement(name=name, applied=False, text=text, against=against, error=error)
