"""How a finished surface is fitted to heat maps, in its place and in its reflectivity."""

from dataclasses import dataclass

from geraf2._validation import (
    require_each,
    require_fraction,
    require_least,
    require_not_negative,
    require_positive,
)

ECHO_VERSION = 1
"""Raised when the same surface and planes give another echo, or another picture of it."""
HEATMAP_FIT_VERSION = 2
"""Raised when the same surface and capture are fitted otherwise."""


@dataclass(frozen=True, kw_only=True)
class SurfaceFitConfig:
    """How finely a surface is rendered, and what is fitted."""

    max_edge_m: float = 0.002
    """Longest edge of a facet [m]; half a wavelength is 1.9 mm."""
    wall_edge_m: float = 0.0025
    """The same of the box's walls [m]."""
    n_nodes: int = 16
    """Places on the content that have a reflectivity; between them it is interpolated."""
    stiffness: float = 0.3
    """Pull of each node's reflectivity to that of all, lest it make up for errors of the
    surface."""
    n_planes: int = 12
    """Planes whose maps are fitted, spread evenly over the scan."""
    n_targets: int = 3000
    """Places at which a plane's maps are compared: half drawn by power, half anywhere."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, "max_edge_m", "wall_edge_m", "stiffness")
        require_least(self, n_nodes=1, n_planes=1, n_targets=10)


@dataclass(frozen=True, kw_only=True)
class HeatmapFitConfig:
    """How a surface is moved to where its heat maps are the measured ones (preset hybrid)."""

    n_rounds: int = 2
    """Times that visibility, phase and normals are taken anew; 0 leaves the surface as it is."""
    n_steps: int = 100
    """Steps of a round."""
    n_windows: int = 2
    """Windows of planes that a step compares."""
    parts: int = 2
    """Windows that a plane is cut into: sub-apertures side by side."""
    n_antennas: int = 200
    """Most antennas of a window; of larger ones so many are drawn once."""
    n_targets: int = 700
    """Places at which a window's heat map is compared: half drawn by power, half anywhere."""
    target_spacing_m: float = 0.005
    """They are drawn from a grid of this spacing [m]."""
    withheld: float = 0.2
    """Share of them that no step sees: they judge whether a round has made the surface better."""
    wall_margin_m: float = 0.02
    """None is nearer to the box's bounds than this [m]: the walls' echoes are not rendered."""
    max_edge_m: float = 0.0025
    """Longest edge of a facet [m]."""
    node_spacing_m: float = 0.004
    """Nodes of the displacement, which is tricubic between them [m]."""
    rate_m: float = 7e-5
    """Step of a node at the start [m]."""
    final_rate: float = 0.1
    """Share of it that the cosine ends at."""
    bending: float = 3e-5
    """Weight of the displacement's second differences, in units of the spacing, squared, summed."""
    anchor: float = 6e-7
    """Weight of the displacement itself, in the same units, squared, summed."""

    def __post_init__(self) -> None:
        lengths = ("target_spacing_m", "max_edge_m", "node_spacing_m", "rate_m")
        require_each(require_positive, self, *lengths)
        require_least(self, n_rounds=0, n_steps=1, n_windows=1, parts=1, n_antennas=1, n_targets=20)
        require_each(require_not_negative, self, "wall_margin_m", "bending", "anchor")
        require_fraction("final_rate", self.final_rate)
        if not 0.05 <= self.withheld <= 0.5:
            msg = f"withheld must be from 0.05 to 0.5, got {self.withheld}"
            raise ValueError(msg)
