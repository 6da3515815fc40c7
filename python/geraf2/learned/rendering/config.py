"""Forms of the amplitude of lensless rendering; apart, because torch takes a second to load."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval

from geraf2._bounds import Bounded, CountOrZero, Few

TwoWayForm = Literal["squared", "unbiased"]
Spreading = Literal["none", "two-way"]
LobePower = Annotated[float, Interval(gt=0.0, le=100.0)]


@dataclass(frozen=True, kw_only=True)
class RenderConfig(Bounded):
    """What equation 4 of the paper says of an amplitude, and what it leaves open."""

    two_way: TwoWayForm = "squared"
    """"squared": T^2 alpha, equation 4, largest at f = ln 2 / s, in front of the surface.
    "unbiased": T alpha with T that of both ways, largest at f = 0; not the paper's."""
    ulos: bool = True
    """Correct transmittance at the scene's boundary by the frozen vision field (ULoS rendering);
    by the field under training, without a gradient, when off."""
    n_clusters: CountOrZero = 4
    """Groups of antennas that share a transmittance; 0: each has its own, as in the paper."""
    lobe_power: LobePower = 4.0
    """Open. Exponent of w_o . w_r: equation 4 has 1, the appendix speaks of a small spread."""
    spreading: Spreading = "none"
    """"none": equation 4. "two-way": 1 / u^2 of equation 2, relative to the scene's middle."""
    normal_gradient: bool = True
    """Open. Whether the lobe pulls at the field through its normals; else opacity alone does."""
    n_looks: Few = 8
    """Open. Signals that the samples are dealt out to; the powers of their heat maps are added. 1:
    one signal, whose heat map is speckled, as samples lie wavelengths apart."""
