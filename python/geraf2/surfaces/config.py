"""How a finished surface is fitted to heat maps, in its place and in its reflectivity."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval, MinLen

from geraf2._bounds import (
    Bounded,
    CellM,
    Count,
    Few,
    LengthM,
    MarginM,
    NotNegative,
    Positive,
    Rounds,
    Share,
)

ECHO_VERSION = 3
"""Raised when the same surface and planes give another echo, or another picture of it."""
RESIDUAL_VERSION = 1
"""Raised when the same surface, echo and planes give another field beside it."""
HEATMAP_FIT_VERSION = 3
"""Raised when the same surface and capture are fitted otherwise."""


@dataclass(frozen=True, kw_only=True)
class SurfaceFitConfig(Bounded):
    """How finely a surface is rendered, and what is fitted."""

    max_edge_m: CellM = 0.002
    """Longest edge of a facet [m]; half a wavelength is 1.9 mm."""
    wall_edge_m: CellM = 0.0025
    """The same of the box's walls [m]."""
    n_nodes: Few = 96
    """Places on the content that have a reflectivity; between them it is interpolated."""
    correlation_m: CellM = 0.02
    """Reflectivities of places nearer than that are much alike [m]."""
    stiffness: Annotated[tuple[Positive, ...], MinLen(1)] = (3.0, 0.3, 0.1)
    """Pull of each node's reflectivity to that of all, lest it make up for errors of the surface.
    Of several the one is taken whose fits explain planes best that they were not fitted to."""
    n_planes: Count = 18
    """Planes whose maps are fitted, spread evenly over the scan."""
    n_targets: Annotated[int, Interval(ge=10, le=10**8)] = 3000
    """Places at which a plane's maps are compared: half drawn by power, half anywhere."""


@dataclass(frozen=True, kw_only=True)
class ResidualFieldConfig(Bounded):
    """What may be put beside a surface (`geraf2 render --residual`)."""

    n_points: Few = 1500
    """Voxels that may hold matter: those at which planes leave most unexplained."""
    n_planes: Count = 18
    """Planes whose maps are fitted, spread evenly over the scan."""
    n_targets: Annotated[int, Interval(ge=10, le=10**5)] = 1000
    """Voxels at which a plane's maps are compared: half drawn by what is unexplained."""


@dataclass(frozen=True, kw_only=True)
class HeatmapFitConfig(Bounded):
    """How a surface is moved to where its heat maps are the measured ones (preset best)."""

    n_rounds: Rounds = 2
    """Times that visibility, phase and normals are taken anew; 0 leaves the surface as it is."""
    n_steps: Count = 100
    """Steps of a round."""
    n_windows: Few = 2
    """Windows of planes that a step compares."""
    parts: Few = 2
    """Windows that a plane is cut into: sub-apertures side by side."""
    n_antennas: Count = 200
    """Most antennas of a window; of larger ones so many are drawn once."""
    n_targets: Annotated[int, Interval(ge=20, le=10**8)] = 700
    """Places at which a window's heat map is compared: half drawn by power, half anywhere."""
    target_spacing_m: CellM = 0.005
    """They are drawn from a grid of this spacing [m]."""
    withheld: Annotated[float, Interval(ge=0.05, le=0.5)] = 0.2
    """Share of them that no step sees: they judge whether a round has made the surface better."""
    wall_margin_m: MarginM = 0.02
    """None is nearer to the box's bounds than this [m]: the walls' echoes are not rendered."""
    max_edge_m: CellM = 0.0025
    """Longest edge of a facet [m]."""
    node_spacing_m: CellM = 0.004
    """Nodes of the displacement, which is tricubic between them [m]."""
    rate_m: LengthM = 7e-5
    """Step of a node at the start [m]."""
    final_rate: Share = 0.1
    """Share of it that the cosine ends at."""
    bending: NotNegative = 3e-5
    """Weight of the displacement's second differences, in units of the spacing, squared, summed."""
    anchor: NotNegative = 6e-7
    """Weight of the displacement itself, in the same units, squared, summed."""
