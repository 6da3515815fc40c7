"""What should be in the box: the list that `--expect contents.toml` gives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

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
_LOG_RATIO = float(np.log(1.5))
"""Largest ratio of the diagonals of a swapped part and of the right one, its logarithm."""
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


class Missing(NamedTuple):
    """Something that no part is."""

    name: str
    """For people."""
    diagonal_m: float
    """Diagonal of the smallest box around it [m]."""


def log_odds(part: BodyReport, item: ExpectedItem) -> float:
    """Log odds that a part has the lengths of an item, against any other thing.

        sum_k log N(l_k - s_k; sigma_k^2 + (4 mm)^2) - log N(l_k - s_k; sigma_k^2 + (50 mm)^2)

    l_k and s_k are the lengths of both in order.
    """
    assert item.size_mm is not None
    wanted = 1e-3 * np.sort(item.size_mm)
    order = np.argsort([length.value for length in part.dimensions_m])
    lengths = [part.dimensions_m[k] for k in order]
    off = np.array([length.value for length in lengths]) - wanted
    variance = np.array([length.sigma for length in lengths]) ** 2
    alike, other = variance + _SIZE_SIGMA_M**2, variance + _OTHER_M**2
    return float(np.sum(0.5 * (off**2 / other - off**2 / alike + np.log(other / alike))))


def assigned(parts: Sequence[BodyReport], items: Sequence[ExpectedItem]) -> dict[int, int]:
    """Part of each item; items without a part of a likely size are absent.

    The sum of the log odds of sizes, and of log P(material) - log(1/2), is the largest possible. A
    part of the right size and of another material is still the part: its material is wrong.
    """
    if not parts or not items:
        return {}
    odds = np.array([[log_odds(part, item) for part in parts] for item in items])
    metal = np.array([part.material.metal_probability for part in parts])
    share = {"metal": metal, "plastic": 1.0 - metal, None: np.full(len(parts), 0.5)}
    of_material = np.log(2.0 * np.maximum([share[item.material] for item in items], 1e-3))
    # The bonus of a pair of a likely size exceeds the materials of all pairs.
    gain = np.where(odds > 0.0, odds + of_material + 10.0 * len(items), 0.0)
    pairs = zip(*linear_sum_assignment(-gain), strict=True)
    return {int(i): int(b) for i, b in pairs if odds[i, b] > 0.0}


class Findings(NamedTuple):
    """A list of contents against the parts."""

    failures: list[str]
    """Sentences on parts of another material."""
    notes: list[str]
    """Sentences on what is unknown."""
    missing: list[Missing]
    """Items of a size without a part."""
    spare: list[int]
    """Parts of no item; empty where one model covers all the content."""


def list_findings(
    parts: Sequence[BodyReport],
    contents: ExpectedContents,
    of_models: Sequence[int | None],
    any_wrong: Sequence[bool],
) -> Findings:
    """Compare a list of contents with the parts.

    of_models: part of each of `contents.models`; -1 of all the content. any_wrong: whether a fault
    of it is reported already.
    """
    failures, notes = list[str](), list[str]()
    taken = {b for b in of_models if b is not None and b >= 0}
    free = [b for b in range(len(parts)) if b not in taken]
    sized = contents.sized
    found = {k: free[b] for k, b in assigned([parts[b] for b in free], sized).items()}
    pairs = [
        (item, b)
        for item, b, wrong in zip(contents.models, of_models, any_wrong, strict=True)
        if b is not None and b >= 0 and not wrong
    ]
    for item, b in [*pairs, *((sized[k], b) for k, b in sorted(found.items()))]:
        kind = parts[b].material.kind
        if item.material is not None and kind == "not determined":
            notes.append(f"the material of '{item.name}' cannot be determined")
        elif item.material is not None and kind != item.material:
            failures.append(f"'{item.name}' is of {kind}, not of {item.material}")
    missing = [
        Missing(item.name, 1e-3 * float(np.linalg.norm(item.size_mm or ())))
        for k, item in enumerate(sized)
        if k not in found
    ]
    spare = [b for b in free if b not in found.values() and -1 not in of_models]
    return Findings(failures, notes, missing, spare)


def absence_failures(
    parts: Sequence[BodyReport], missing: Sequence[Missing], spare: Sequence[int], *, is_list: bool
) -> list[str]:
    """Sentences on what is missing, swapped or surplus.

    A missing item and a spare part of a similar size are one fault: a swapped part.

    spare: parts of no item. is_list: whether every part must be an item.
    """
    wanted = np.log([item.diagonal_m for item in missing])
    there = np.log([np.linalg.norm([m.value for m in parts[b].dimensions_m]) for b in spare])
    off = np.abs(wanted[:, None] - there)
    pairs = zip(*linear_sum_assignment(np.minimum(off, _LOG_RATIO)), strict=True)
    swaps = {int(k): spare[n] for k, n in pairs if off[k, n] < _LOG_RATIO}
    found = [
        f"'{item.name}' is {swap_text(swaps[k], parts) if k in swaps else 'missing'}"
        for k, item in enumerate(missing)
    ]
    others = [b for b in spare if b not in swaps.values()] if is_list else []
    return [*found, *(f"part {b + 1} is surplus: {_size_text(parts[b])}" for b in others)]


def swap_text(b: int, parts: Sequence[BodyReport]) -> str:
    """Describe the part that is there instead of an item."""
    return f"swapped: part {b + 1} is there instead, {_size_text(parts[b])}"


def _size_text(part: BodyReport) -> str:
    sides = " x ".join(f"{1e3 * length.value:.0f}" for length in part.dimensions_m)
    return f"{sides} mm, {part.material.kind}"
