"""Settings of the fit of reflectivity to heat maps, which follows a finished surface."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, CellM, Count, Few, Positive

ECHO_VERSION = 3
"""Increase when the same surface and planes give another echo or another image of it."""


@dataclass(frozen=True, kw_only=True)
class SurfaceFitConfig(Bounded):
    """Settings of the rendering of a surface and of the fit of its reflectivity."""

    max_edge_m: CellM = 0.002
    """Longest edge of a facet [m]; half a wavelength is 1.9 mm."""
    wall_edge_m: CellM = 0.0025
    """Longest edge of a facet of the box's walls [m]."""
    n_nodes: Few = 96
    """Number of points on the content with a reflectivity, which is interpolated between them."""
    correlation_m: CellM = 0.02
    """Correlation length of the reflectivity over the surface [m]."""
    stiffness: Annotated[tuple[Positive, ...], MinLen(1)] = (3.0, 0.3, 0.1)
    """Weights that hold each reflectivity near the mean of all, so that it cannot compensate
    errors of the surface. The fit with the least error on left-out planes is used."""
    n_planes: Count = 18
    """Number of planes whose heat maps are fitted, spread evenly over the scan."""
    n_targets: Annotated[int, Interval(ge=10, le=10**8)] = 3000
    """Samples of a plane's heat map: half drawn by power, half uniformly."""
