"""What should be in the box: the list that `--expect contents.toml` gives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, Len
from scipy.optimize import linear_sum_assignment

from geraf2.apps.inspection.bodies import BodyReport
from geraf2.errors import UserError
from geraf2.io.toml import read_toml

_SIZE_SIGMA_M = 0.004
"""Standard deviation of a length of a part beside its own: noise moves its ends outwards [m]."""
_OTHER_M = 0.05
"""Standard deviation of the lengths of other things [m]."""
_Length = Annotated[float, Interval(gt=0.0, le=10_000.0)]


@dataclass(frozen=True, kw_only=True)
class ExpectedItem:
    """One kind of thing that should be in the box."""

    name: Annotated[str, Len(min_length=1, max_length=100)]
    """For people."""
    material: Literal["metal", "plastic"] | None = None
    """What it should be made of; not checked when not given."""
    count: Annotated[int, Interval(ge=1, le=1000)] = 1
    """How many of them."""
    size_mm: tuple[_Length, _Length, _Length] | None = None
    """Its lengths [mm], in any order; or give `cad`."""
    cad: str | None = None
    """File of its CAD model, relative to the list."""

    def __post_init__(self) -> None:
        if (self.size_mm is None) == (self.cad is None):
            msg = "size_mm or cad must be given, and not both"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class ExpectedContents:
    """List of what should be in the box."""

    item: Annotated[tuple[ExpectedItem, ...], Len(min_length=1, max_length=1000)]
    """Tables `[[item]]`."""

    @property
    def models(self) -> tuple[ExpectedItem, ...]:
        """Items with a CAD model, each as often as it should be there."""
        return tuple(i for i in self.item if i.cad is not None for _ in range(i.count))

    @property
    def sized(self) -> tuple[ExpectedItem, ...]:
        """Items with a size, each as often as it should be there."""
        return tuple(i for i in self.item if i.size_mm is not None for _ in range(i.count))


def read_expected(path: Path) -> ExpectedContents:
    """Read a list of contents; UserError for unknown keys and materials, or a CAD file twice."""
    found = read_toml(path, ExpectedContents)
    items = tuple(
        item if item.cad is None else replace(item, cad=str(path.parent / item.cad))
        for item in found.item
    )
    for names, what in (
        ([item.name for item in items], "name"),
        ([str(Path(item.cad).resolve()) for item in items if item.cad], "CAD file"),
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


def log_odds(part: BodyReport, item: ExpectedItem) -> float:
    """Log odds that a part is an item of a size, against any other thing.

        sum_k log N(l_k - s_k; sigma_k^2 + (4 mm)^2) - log N(l_k - s_k; sigma_k^2 + (50 mm)^2)
            + log P(material) - log(1/2)

    l_k and s_k are the lengths of both in order.
    """
    assert item.size_mm is not None
    wanted = 1e-3 * np.sort(item.size_mm)
    order = np.argsort([length.value for length in part.dimensions_m])
    lengths = [part.dimensions_m[k] for k in order]
    off = np.array([length.value for length in lengths]) - wanted
    variance = np.array([length.sigma for length in lengths]) ** 2
    alike, other = variance + _SIZE_SIGMA_M**2, variance + _OTHER_M**2
    odds = float(np.sum(0.5 * (off**2 / other - off**2 / alike + np.log(other / alike))))
    if item.material is not None:
        metal = part.material.metal_probability
        share = metal if item.material == "metal" else 1.0 - metal
        odds += float(np.log(2.0 * max(share, 1e-3)))
    return odds


def assigned(parts: Sequence[BodyReport], items: Sequence[ExpectedItem]) -> dict[int, int]:
    """Part of each item by the largest sum of log odds; items without a likely part are absent."""
    if not parts or not items:
        return {}
    odds = np.array([[log_odds(part, item) for part in parts] for item in items])
    pairs = zip(*linear_sum_assignment(-np.maximum(odds, 0.0)), strict=True)
    return {int(i): int(b) for i, b in pairs if odds[i, b] > 0.0}


def list_failures(
    parts: Sequence[BodyReport],
    contents: ExpectedContents,
    of_models: Sequence[int | None],
    any_missing: Sequence[bool],
) -> tuple[list[str], list[str]]:
    """Sentences on what is missing, surplus or of another material, and on what is unknown.

    of_models: part of each of `contents.models`; -1 of all the content. any_missing: whether it is
    reported already.
    """
    failures, notes = list[str](), list[str]()
    taken = {b for b in of_models if b is not None and b >= 0}
    free = [b for b in range(len(parts)) if b not in taken]
    sized = contents.sized
    found = assigned([parts[b] for b in free], sized)
    pairs = [(item, b) for item, b in zip(contents.models, of_models, strict=True)]
    pairs += [(item, free[found[k]] if k in found else None) for k, item in enumerate(sized)]
    reported = [*any_missing, *(False for _ in sized)]
    for (item, b), known in zip(pairs, reported, strict=True):
        if b is None:
            failures += [] if known else [f"'{item.name}' is missing"]
        elif b >= 0 and item.material is not None:
            kind = parts[b].material.kind
            if kind == "not determined":
                notes.append(f"the material of '{item.name}' cannot be determined")
            elif kind != item.material:
                failures.append(f"'{item.name}' is of {kind}, not of {item.material}")
    if not any(b == -1 for b in of_models):
        used = taken | {b for _, b in pairs if b is not None}
        surplus = [k for k in range(len(parts)) if k not in used]
        failures += [f"part {k + 1} is surplus: {_size_text(parts[k])}" for k in surplus]
    return failures, notes


def _size_text(part: BodyReport) -> str:
    sides = " x ".join(f"{1e3 * length.value:.0f}" for length in part.dimensions_m)
    return f"{sides} mm, {part.material.kind}"
