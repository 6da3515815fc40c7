"""Adam on arrays."""

import numpy as np

from geraf2._types import Floats

_BETAS = (0.9, 0.95)
_SMALLEST = 1e-8


class Adam:
    """Steps against gradients, each value's in units of what its gradient usually is.

    Kingma and Ba, Adam: a method for stochastic optimization, 2015.

    groups: arrays, changed in place, each with its rate.
    """

    def __init__(self, *groups: tuple[Floats, float]) -> None:
        self._groups = groups
        self._moments = [(np.zeros_like(x), np.zeros_like(x)) for x, _ in groups]
        self._n_steps = 0

    def step(self, gradients: tuple[Floats, ...], share: float) -> None:
        """One step, at `share` of the rates."""
        self._n_steps += 1
        (keep_1, keep_2), n = _BETAS, self._n_steps
        for group, moments, gradient in zip(self._groups, self._moments, gradients, strict=True):
            (values, rate), (first, second) = group, moments
            np.add(first, (1.0 - keep_1) * (gradient - first), out=first)
            np.add(second, (1.0 - keep_2) * (gradient * gradient - second), out=second)
            size = np.sqrt(second / (1.0 - keep_2**n)) + _SMALLEST
            np.subtract(values, (share * rate / (1.0 - keep_1**n)) * first / size, out=values)
