"""What a part may be made of, and values with an uncertainty."""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from geraf2.io.text import NOT_DETERMINED, interval_text

CERTAIN = 0.95
"""Least probability of a material that is named."""
Kind = Literal["metal", "plastic", "not determined"]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A value with its standard uncertainty."""

    value: float
    """In the unit of its name."""
    sigma: float | None
    """Standard uncertainty, in the same unit; 95 % of errors are below 1.96 of it. None of a scan
    that is not to be trusted."""

    def text(self, factor: float = 1.0, **form: Any) -> str:
        """Value times a factor, with its interval; form: as of `geraf2.io.text.interval_text`."""
        half = None if self.sigma is None else 1.96 * factor * self.sigma
        return interval_text(factor * self.value, half, **form)


@dataclass(frozen=True, kw_only=True)
class Material:
    """What a part is made of."""

    kind: Kind
    """`metal`, `plastic`, or `not determined`."""
    metal_probability: float
    """That it is metal and not plastic, 0 to 1; 0.5 where nothing shows it."""
    reflectivity_db: Measured | None
    """Amplitude of its strong returns against metal [dB]; None without a scale or returns."""
    permittivity: Measured | None
    """Relative, of plastic whose back face shows it; else None."""
    thickness_m: tuple[float, float] | None
    """Thickness where both faces of that plastic were seen, 10 % and 90 % quantile [m]."""
    n_returns: int
    """Returns with a level."""
    is_hollow: bool = False
    """Whether it is a shell of plastic that is filled with air."""

    def weighed(self, share: float) -> "Material":
        """Weigh what is known by the probability that the scan is right; at 0 nothing is."""
        metal = 0.5 + share * (self.metal_probability - 0.5)
        if max(metal, 1.0 - metal) >= CERTAIN or self.kind == UNKNOWN.kind:
            known = self if share > 0.0 else UNKNOWN
            return replace(known, metal_probability=metal)
        return replace(UNKNOWN, metal_probability=metal)


UNKNOWN = Material(
    kind="not determined",
    metal_probability=0.5,
    reflectivity_db=None,
    permittivity=None,
    thickness_m=None,
    n_returns=0,
)


def material_text(material: Material) -> str:
    """Material with the odds and the numbers that it rests on."""
    p = material.metal_probability
    texts = [f"{material.kind} ({100 * max(p, 1.0 - p):.0f} %)"]
    if material.kind == NOT_DETERMINED:
        texts = [NOT_DETERMINED]
    level, permittivity = material.reflectivity_db, material.permittivity
    if level is not None:
        texts.append(f"{level.text(scale=math.inf)} dB against metal")  # a level has no size
    if material.is_hollow:
        texts.append("a shell filled with air")
    elif permittivity is not None:
        texts.append(f"permittivity {permittivity.text(digits=2)}")
    elif material.kind == "plastic":
        texts.append("permittivity cannot be determined")
    if material.thickness_m is not None:
        low, high = material.thickness_m
        texts.append(f"{1e3 * low:.0f} to {1e3 * high:.0f} mm thick where both faces were seen")
    return ", ".join(texts)
