"""Faces of the box that no aperture sees squarely: where their edges echo, and what they enclose.

The edge between an unseen face and one that is seen echoes along the seen wall, in directions
square to the edge; the flashes of the seen wall lie within it.
"""

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.calibration.box_search import densest_planes
from geraf2.imaging.peaks import PeakSet

SQUARE_COSINE = float(np.cos(0.2))
"""Viewing directions within this of a wall's normal can show its flash."""
# Edges lie in their wall's plane, are seen across it, and square to themselves.
_ON_WALL_M, _CORNER_M = 0.006, 0.01
_LEAST_SLOPE, _SQUARE_TO_EDGE = 0.08, 0.06
_FEWEST = 3
# The middle of an edge's echo lies so much inside of the edge (median of 10), and scatters.
_EDGE_INSIDE_M, _EDGE_SIGMA_M = 0.0025, 0.004
# A flash is this square to its wall; content lies this far within, the rest are grating lobes.
_FLASH_COSINE = float(np.cos(0.05))
_CLEARANCE_M, _CONTENT_SHARE = 0.01, 0.9
# Of the densest echoes beyond the flashes; less are grating lobes.
_LEAST_SHARE = 0.4

Face = tuple[int, int]
"""Axis and side of a face."""


def flash_reach(peaks: PeakSet, axes: Floats, offsets_m: Floats, seen: Bools, face: Face) -> float:
    """How far out the seen walls reach at least towards a face, by the feet of flashes [m].

    offsets_m, seen: of all faces, (3, 2).
    """
    k, side = face
    along, toward, _ = _projected(peaks, axes)
    outward = along[:, k] * (1.0 if side else -1.0)
    least = 0.0
    for j, other in zip(*np.nonzero(seen), strict=True):
        if j != k:
            flash = (
                np.abs(along[:, j] * (1.0 if other else -1.0) - offsets_m[j, other]) < _ON_WALL_M
            )
            flash &= np.abs(toward[:, j]) > _FLASH_COSINE
            least = max(least, float(outward[flash].max(initial=0.0)))
    return least


def content_reach(
    peaks: PeakSet, axes: Floats, offsets_m: Floats, seen: Bools, face: Face
) -> float:
    """How far out nine tenths of the energy from within the seen walls reach towards a face [m]."""
    k, side = face
    along, _, strength = _projected(peaks, axes)
    clearance = np.where(seen, offsets_m - _CLEARANCE_M, np.inf)
    inside = ((along < clearance[:, 1]) & (along > -clearance[:, 0])).all(axis=1)
    outward = along[inside, k] * (1.0 if side else -1.0)
    if not len(outward):
        return 0.0
    order = np.argsort(outward)
    energy = np.cumsum(strength[inside][order] ** 2)
    return float(outward[order][np.searchsorted(energy, _CONTENT_SHARE * energy[-1])])


def find_edge(
    peaks: PeakSet, axes: Floats, offsets_m: Floats, seen: Bools, face: Face, least_m: float
) -> tuple[float, float] | None:
    """Offset of an unseen face and its standard deviation [m]; None where no edge echoes.

    The outermost position at which several echoes of seen walls lie that are no flashes.

    least_m: reach of the flashes.
    """
    k, side = face
    along, toward, strength = _projected(peaks, axes)
    outward = along[:, k] * (1.0 if side else -1.0)
    centers = peaks.centers @ axes.T
    on_edge = np.zeros(len(peaks), dtype=bool)
    for j, other in zip(*np.nonzero(seen), strict=True):
        if j == k:
            continue
        sign, third = (1.0 if other else -1.0), 3 - j - k
        on_wall = np.abs(sign * along[:, j] - offsets_m[j, other]) < _ON_WALL_M
        on_wall &= sign * centers[:, j] > offsets_m[j, other]
        across = np.abs(toward[:, k]) > _LEAST_SLOPE
        square = np.abs(toward[:, third]) < _SQUARE_TO_EDGE
        for end in range(2):
            if seen[third, end]:
                corner = along[:, third] * (1.0 if end else -1.0) - offsets_m[third, end]
                square |= np.abs(corner) < _CORNER_M
                on_wall &= corner < _CORNER_M
        on_edge |= on_wall & across & square
    on_edge &= outward > least_m + _ON_WALL_M
    for position, members in densest_planes(
        outward[on_edge], np.sqrt(strength[on_edge]), _LEAST_SHARE
    ):
        own = np.flatnonzero(on_edge)[members]
        if len(np.unique(peaks.subapertures[own])) >= _FEWEST:
            spread = float(np.std(outward[own])) / np.sqrt(len(own))
            return position + _EDGE_INSIDE_M, float(np.hypot(_EDGE_SIGMA_M, spread))
    return None


def _projected(peaks: PeakSet, axes: Floats) -> tuple[Floats, Floats, Floats]:
    """Points and directions along the axes, (n, 3) each, and strengths, (n,)."""
    return peaks.points @ axes.T, peaks.directions @ axes.T, peaks.strengths
