"""Short text of records that hold arrays."""

from dataclasses import fields
from typing import Any

_MAX_LENGTH = 60


class Short:
    """Base of dataclasses with `repr=False`: arrays by shape, records by type, the rest as it is.

    A field whose own `repr` is False is left out.
    """

    def __repr__(self) -> str:
        shown: Any = self
        parts = [f"{f.name}={_short(getattr(self, f.name))}" for f in fields(shown) if f.repr]
        return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{' x '.join(map(str, value.shape)) or 'scalar'} {value.dtype}"
    if isinstance(value, float):
        return f"{value:.4g}"
    text = repr(value)
    if len(text) <= _MAX_LENGTH:
        return text
    if isinstance(value, tuple | list):
        return f"{len(value)} x {type(value[0]).__name__}"
    return f"{type(value).__name__}(...)"
