"""Numbers of stages in run.json that the report and later stages read, and their types."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from geraf2.errors import UserError
from geraf2.io.toml import from_table
from geraf2.io.verdict import Cause, Trust

_Interval = tuple[float, float]
_Axis = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class _Face:
    """A face of the box that the scan shows."""

    seen: str
    offset_m: float | None
    sigma_m: float | None
    interval_m: tuple[float | None, float | None]


@dataclass(frozen=True, kw_only=True)
class _Ghost:
    """A piece that likely does not exist."""

    probability: float
    volume_cm3: float
    extents_mm: tuple[float, float, float]
    center_mm: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class _Region:
    """A part of the box, and what would have been found in it."""

    name: str
    metal_mm: float | None
    plastic_mm: float | None
    unseen_share: float


@dataclass(frozen=True, kw_only=True)
class _Known:
    """Numbers by name, whatever their stage; each may be missing."""

    n_glints: int = 0
    labels: dict[str, int] | None = None
    n_back_faces: int = 0
    back_face_share: float = 0.0
    is_hollow: bool = False
    permittivity: float = 1.0
    permittivity_sigma: float = 0.0
    thickness_m: _Interval = (0.0, 0.0)
    n_face_pairs: int = 0
    metal_strength_m: float = 0.0
    metal_strength_sigma_db: float = 0.0
    n_wall_flashes: int = 0
    support_over_clutter: float = 0.0
    strong_magnitude: float = 0.0
    outlines: int | None = None
    applied: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    volume_cm3: float = 0.0
    volume_95_percent_cm3: _Interval = (0.0, 0.0)
    extents_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    extents_95_percent_mm: tuple[_Interval, _Interval, _Interval] | None = None
    common_offset_sigma_mm: float = 0.0
    axes: tuple[_Axis, _Axis, _Axis] | None = None
    faces: dict[str, _Face] | None = None
    likely_ghosts: tuple[_Ghost, ...] = ()
    ruled_out: tuple[_Region, ...] = ()
    expected_error_median_mm: float = 0.0
    evidence_shares: dict[str, float] | None = None
    verdict: Trust | None = None
    probability_of_failure: float = 0.0
    causes: tuple[Cause, ...] = ()
    tests: dict[str, Any] | None = None


# Where the first is there, the others are.
_TOGETHER = (
    ("n_back_faces", "back_face_share", "is_hollow"),
    ("permittivity", "permittivity_sigma", "thickness_m", "n_face_pairs"),
    ("volume_95_percent_cm3", "volume_cm3", "extents_mm", "extents_95_percent_mm"),
    ("volume_95_percent_cm3", "common_offset_sigma_mm"),
    ("faces", "axes"),
    ("verdict", "probability_of_failure", "causes", "tests"),
)


def check_numbers(numbers: Any, where: object) -> dict[str, Any]:
    """Numbers of one stage; UserError where one that others read has another type or is missing."""
    if not isinstance(numbers, Mapping):
        raise UserError(what="must be a table of numbers", where=where, got=repr(numbers)[:40])
    known = {name: v for name, v in numbers.items() if name in _Known.__dataclass_fields__}
    from_table(known, _Known, where)
    for first, *others in _TOGETHER:
        missing = [name for name in others if first in known and name not in known]
        if missing:
            raise UserError(what=f"key {missing[0]!r} is missing", where=where)
    return dict(numbers)
