"""Measured share of the expected echo of some patches of a model."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geraf2._types import Array

_COHERENT = 0.46
"""Coherence of the residual heat maps with the echo of a patch: root mean square of the normalised
errors of 490 patches of four development parts, 0.43 to 0.48 each."""
_CERTAIN = 2.6
"""Standard uncertainties below one half at which a patch is absent: 1 % of ten groups err."""


class Share(NamedTuple):
    """Ratio of the measured to the expected echo of some surface of a model."""

    value: float
    """1 where present, 0 where absent."""
    sigma: float
    """Standard uncertainty; infinite where no window sees the surface."""

    @property
    def is_absent(self) -> bool:
        """Whether certainly less than half of the echo was measured.

        A share below zero is no better explained by absence than zero is.
        """
        return max(self.value, 0.0) + _CERTAIN * self.sigma < 0.5


class PatchEchoes(NamedTuple):
    """Heat maps of the visible patches of a window, and the residual of the measured one."""

    group: int
    """Group of neighbouring planes."""
    rest: Array
    echoes: dict[int, Array]


def share_of(windows: Sequence[PatchEchoes], members: Sequence[int]) -> Share:
    """Measured share a of the echo h of some patches, with the residual r of all patches.

        a = 1 + sum_w Re <h_w, r_w> / s_w / sum_w |h_w|^2 / s_w,    s_w the mean of |r_w|^2,

    with an uncertainty from the residual where h is strong, common to neighbouring planes.
    """
    kept, above, below = [], 0.0, 0.0
    for window in windows:
        parts = [window.echoes[q] for q in members if q in window.echoes]
        if not parts:
            continue
        echo = np.sum(parts, axis=0)
        noise = max(float(np.mean(np.abs(window.rest) ** 2)), 1e-300)
        weight = power_of(echo) / noise
        if weight > 0.0:
            above += float(np.vdot(echo, window.rest).real) / noise
            below += weight
            kept.append((window, echo, weight))
    if not kept:
        return Share(1.0, np.inf)
    value, errors = 1.0 + above / below, dict[int, float]()
    for window, echo, weight in kept:
        bright = np.abs(echo) ** 2
        residual = np.abs(window.rest + (1.0 - value) * echo) ** 2
        error = np.sqrt(0.5 * float(bright @ residual) / float(bright @ bright))
        errors[window.group] = errors.get(window.group, 0.0) + weight * error
    together = np.sqrt(sum(error**2 for error in errors.values()))
    return Share(value, _COHERENT * float(together) / below)


def power_of(image: Array) -> float:
    """Sum of squared magnitudes."""
    return float(np.vdot(image, image).real)
