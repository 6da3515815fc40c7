"""How reflectivity and a residual field are fitted to heat maps beside a finished surface."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval, MinLen

from geraf2._bounds import (
    Bounded,
    CellM,
    Count,
    Few,
    Positive,
)

ECHO_VERSION = 3
"""Raised when the same surface and planes give another echo, or another picture of it."""
RESIDUAL_VERSION = 1
"""Raised when the same surface, echo and planes give another field beside it."""


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
