"""What a part may be made of, and values with an uncertainty."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["metal", "plastic", "not determined"]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A value with its standard uncertainty."""

    value: float
    """In the unit of its name."""
    sigma: float
    """Standard uncertainty, in the same unit; 95 % of errors are below 1.96 of it."""


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
    if material.kind == "not determined":
        texts = [str(material.kind)]
    level, permittivity = material.reflectivity_db, material.permittivity
    if level is not None:
        texts.append(f"{level.value:.1f} ± {1.96 * level.sigma:.1f} dB against metal")
    if permittivity is not None:
        texts.append(f"permittivity {permittivity.value:.2f} ± {1.96 * permittivity.sigma:.2f}")
    elif material.kind == "plastic":
        texts.append("permittivity cannot be determined")
    if material.thickness_m is not None:
        low, high = material.thickness_m
        texts.append(f"{1e3 * low:.0f} to {1e3 * high:.0f} mm thick where both faces were seen")
    return ", ".join(texts)
