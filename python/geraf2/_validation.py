"""Checks of user input; each message names the value, the contract and what was got."""

import math
from collections.abc import Callable
from typing import Any


def require_positive(name: str, value: float) -> None:
    """Raise ValueError unless `value` is finite and above zero."""
    if not (math.isfinite(value) and value > 0):
        msg = f"{name} must be finite and positive, got {value!r}"
        raise ValueError(msg)


def require_finite(name: str, value: float) -> None:
    """Raise ValueError unless `value` is finite."""
    if not math.isfinite(value):
        msg = f"{name} must be finite, got {value!r}"
        raise ValueError(msg)


def require_between(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError unless `value` lies between two numbers and is neither."""
    if not low < value < high:
        msg = f"{name} must lie between {low:g} and {high:g}, got {value!r}"
        raise ValueError(msg)


def require_least(record: object, **least: float) -> None:
    """Raise ValueError unless each field named is at least the number given for it."""
    for name, limit in least.items():
        value = getattr(record, name)
        if not value >= limit:
            msg = f"{name} must be at least {limit:g}, got {value}"
            raise ValueError(msg)


def require_each(require: Callable[[str, Any], None], record: object, *names: str) -> None:
    """Apply one of these checks to each field named."""
    for name in names:
        require(name, getattr(record, name))


def require_shape(name: str, array: Any, shape: tuple[int | None, ...]) -> None:
    """Raise ValueError unless `array.shape` matches `shape`; None accepts any length."""
    got = tuple(array.shape)
    ok = len(got) == len(shape) and all(
        want is None or have == want for have, want in zip(got, shape, strict=True)
    )
    if not ok:
        want_text = "(" + ", ".join("*" if n is None else str(n) for n in shape) + ")"
        msg = f"{name} must have shape {want_text}, got {got}"
        raise ValueError(msg)
