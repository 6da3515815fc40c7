"""Bounds in the types of fields: Python, TOML and flags refuse the same, in one line."""

import importlib
import math
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, get_type_hints

import numpy as np
import pytest
from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, BoundsError, _checks_of
from geraf2._memory import memory_limit, require_memory
from geraf2.cli.main import COMMANDS
from geraf2.errors import UserError
from geraf2.io.toml import from_table
from geraf2.pipeline.presets import PRESETS
from geraf2.simulation import SceneSpec

# A raster is a record of its own with bounds, a sign is one of two, a side may be left open by inf.
CHECKED_ELSEWHERE = ("raster", "phase_sign", "bounds", "settings")
Share = Annotated[float, Interval(ge=0.0, le=1.0)]


@dataclass(frozen=True, kw_only=True)
class Record(Bounded):
    """Something with bounds everywhere that they can stand."""

    share: Share = 0.5
    count: Annotated[int, Interval(gt=0, lt=10)] | None = None
    pair: tuple[Share, Annotated[float, Interval(gt=0.0)]] = (0.0, 1.0)
    some: Annotated[tuple[Share, ...], MinLen(1)] = (0.1,)
    free: float = 7.0


BAD = [
    ("share", -0.1),
    ("share", 1.1),
    ("share", math.nan),
    ("share", math.inf),
    ("share", True),
    ("share", "0.5"),
    ("count", 0),
    ("count", 10),
    ("count", 1.5),
    ("pair", (0.0, 0.0)),
    ("pair", (2.0, 1.0)),
    ("pair", (0.0,)),
    ("pair", 0.5),
    ("some", ()),
    ("some", (0.1, 3.0)),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_python_and_toml_refuse_the_same(name, value):
    with pytest.raises(BoundsError, match=f"^{name} must "):
        Record(**{name: value})
    table = {name: list(value) if isinstance(value, tuple) else value}
    with pytest.raises(UserError, match=name):
        from_table(table, Record, "a.toml")


def test_what_lies_on_a_bound_is_good():
    for values in ({"share": 0}, {"share": 1.0}, {"count": 9}, {"some": (0.0, 1.0)}):
        assert Record(**values) == from_table(
            {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}, Record, "a"
        )
    assert Record(share=np.float32(0.5), count=np.int64(3)).count == 3


def _records(kind, seen):
    """A dataclass, and those among the defaults of its fields."""
    if kind in seen:
        return
    seen.add(kind)
    yield kind
    for entry in fields(kind):
        made = entry.default_factory() if callable(entry.default_factory) else entry.default
        if is_dataclass(made):
            yield from _records(type(made), seen)


def _configs():
    seen = set()
    for kind in (*PRESETS.values(), SceneSpec):
        yield from _records(kind, seen)
    for command in COMMANDS.values():
        yield from _records(importlib.import_module(f"geraf2.cli.{command.module}").Config, seen)


def test_every_number_that_a_user_can_set_has_bounds():
    without = []
    for kind in _configs():
        hints, bounded = get_type_hints(kind), dict(_checks_of(kind))
        without += [
            f"{kind.__module__}.{kind.__name__}.{name}"
            for name, hint in hints.items()
            if any(word in str(hint) for word in ("float", "int"))
            and "Literal" not in str(hint)
            and not str(hint).startswith("<class 'geraf2")
            and name not in (*bounded, *CHECKED_ELSEWHERE)
        ]
    assert without == []


def test_memory_is_refused_by_what_is_allowed_and_by_what_is_free():
    require_memory(1e6, "lower it")
    with memory_limit(1e5), pytest.raises(UserError, match=r"of max_memory; lower it"):
        require_memory(1e6, "lower it")
    require_memory(1e6, "lower it")
    with pytest.raises(UserError, match=r"GiB free; lower it"):
        require_memory(1e18, "lower it")
