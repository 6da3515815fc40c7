"""What should be in the box: the list of CAD models that `--expect contents.toml` gives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, Len
from scipy.optimize import linear_sum_assignment

from geraf2.apps.inspection.bodies import BodyReport
from geraf2.apps.inspection.models import CadModel
from geraf2.errors import UserError
from geraf2.io.toml import read_toml

_LOG_RATIO = float(np.log(1.5))
"""Largest ratio of the diagonals of a swapped part and of the right one, its logarithm."""


@dataclass(frozen=True, kw_only=True)
class ExpectedItem:
    """One kind of thing that should be in the box."""

    name: Annotated[str, Len(min_length=1, max_length=100)]
    """For people."""
    cad: Annotated[str, Len(min_length=1, max_length=4096)]
    """File of its CAD model, relative to the list."""
    material: Literal["metal", "plastic"] | None = None
    """What it should be made of; not checked when not given."""
    count: Annotated[int, Interval(ge=1, le=1000)] = 1
    """How many of them."""


@dataclass(frozen=True, kw_only=True)
class ExpectedContents:
    """List of what should be in the box."""

    item: Annotated[tuple[ExpectedItem, ...], Len(min_length=1, max_length=1000)]
    """Tables `[[item]]`."""

    @property
    def models(self) -> tuple[ExpectedItem, ...]:
        """Items, each as often as it should be there."""
        return tuple(item for item in self.item for _ in range(item.count))


def read_expected(path: Path) -> ExpectedContents:
    """Read a list of contents; UserError for unknown keys and materials, or a CAD file twice."""
    found = read_toml(path, ExpectedContents)
    items = tuple(replace(item, cad=str(path.parent / item.cad)) for item in found.item)
    for names, what in (
        ([item.name for item in items], "name"),
        ([str(Path(item.cad).resolve()) for item in items], "CAD file"),
    ):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise UserError(
                what=f"the same {what} is listed twice",
                where=path,
                expected="one [[item]] with its count",
                got=twice[0],
            )
    return replace(found, item=items)


def material_findings(
    pairs: Sequence[tuple[ExpectedItem, BodyReport]],
) -> tuple[list[str], list[str]]:
    """Sentences on parts of another material than their item, and on those of an unknown one."""
    failures, notes = list[str](), list[str]()
    for item, part in pairs:
        kind = part.material.kind
        if item.material is not None and kind == "not determined":
            notes.append(f"the material of '{item.name}' cannot be determined")
        elif item.material is not None and kind != item.material:
            failures.append(f"'{item.name}' is of {kind}, not of {item.material}")
    return failures, notes


def absence_failures(
    parts: Sequence[BodyReport], missing: Sequence[CadModel], spare: Sequence[int], *, is_list: bool
) -> list[str]:
    """Sentences on models that are missing or swapped, and on surplus parts.

    A missing model and a spare part of a similar size are one fault: a swapped part.

    spare: parts of no model. is_list: whether every part must be one of the models.
    """
    wanted = np.log([np.linalg.norm(model.lengths_m) for model in missing])
    there = np.log([np.linalg.norm([m.value for m in parts[b].dimensions_m]) for b in spare])
    off = np.abs(wanted[:, None] - there)
    pairs = zip(*linear_sum_assignment(np.minimum(off, _LOG_RATIO)), strict=True)
    swaps = {int(k): spare[n] for k, n in pairs if off[k, n] < _LOG_RATIO}
    found = [
        f"'{model.name}' is {swap_text(swaps[k], parts) if k in swaps else 'missing'}"
        for k, model in enumerate(missing)
    ]
    others = [b for b in spare if b not in swaps.values()] if is_list else []
    return [*found, *(f"part {b + 1} is surplus: {_size_text(parts[b])}" for b in others)]


def swap_text(b: int, parts: Sequence[BodyReport]) -> str:
    """Describe the part that is there instead of an item."""
    return f"swapped: part {b + 1} is there instead, {_size_text(parts[b])}"


def _size_text(part: BodyReport) -> str:
    sides = " x ".join(f"{1e3 * length.value:.0f}" for length in part.dimensions_m)
    return f"{sides} mm, {part.material.kind}"
