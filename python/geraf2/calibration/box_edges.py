"""Faces of the box that no aperture sees at a right angle: their edges, and bounds for them.

The edge between an unseen face and a seen wall echoes along that wall, in directions perpendicular
to the edge. The flashes of the seen wall lie within it.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import gaussian_filter1d

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.flashes import WallMiddles, find_flashes
from geraf2.echoes.wall_faces import WallFaces
from geraf2.imaging.peaks import PeakSet

SQUARE_COSINE = float(np.cos(0.2))
"""Least cosine between a wall's normal and the looking direction of antennas that see its flash."""
# Tolerances of an edge: distance from its wall's plane, and from a corner [m].
_ON_WALL_M, _CORNER_M = 0.006, 0.01
# Least direction cosine across the edge, and largest along it.
_MIN_SLOPE, _SQUARE_TO_EDGE = 0.08, 0.06
# Least number of flashes at a foot, and of sub-apertures with an edge's echo: four overlap, and
# count as one.
_MIN_SUBAPERTURES = 4
# Distance of an edge's echo inside of the edge, and its standard deviation [m].
_EDGE_INSIDE_M, _EDGE_SIGMA_M = 0.0025, 0.004
# Distance of content from the walls [m], and its share of the energy; the rest are grating lobes.
_CLEARANCE_M, _CONTENT_SHARE = 0.01, 0.9
# Least density of an edge's echoes, relative to the densest; grating lobes have less.
_MIN_SHARE = 0.4
# Width of the profile along which edges are searched [m].
_PROFILE_STEP_M, _PROFILE_SIGMA_M = 0.001, 0.0025

Face = tuple[int, int]
"""Axis and side of a face."""


def flash_reach(
    peaks: PeakSet,
    normals: Floats,
    offsets_m: Floats,
    seen: Bools,
    face: Face,
    middles: WallMiddles,
) -> float:
    """Lower bound of an unseen face's offset: the farthest feet of flashes of the seen walls [m].

    normals, offsets_m, seen: of all faces, (3, 2, 3) and (3, 2).
    """
    k, side = face
    beside = seen & (np.arange(3) != k)[:, None]
    walls = WallFaces.of_planes(normals[beside], offsets_m[beside])
    found = find_flashes(peaks, walls, middles)
    feet = np.sort(peaks.points[np.unique(found.index)] @ normals[k, side])
    return max(float(feet[-_MIN_SUBAPERTURES]), 0.0) if len(feet) >= _MIN_SUBAPERTURES else 0.0


def content_reach(
    peaks: PeakSet, normals: Floats, offsets_m: Floats, seen: Bools, face: Face
) -> float:
    """Offset towards a face that contains nine tenths of the energy within the seen walls [m]."""
    k, side = face
    inside = within(peaks.points, normals, np.where(seen, offsets_m - _CLEARANCE_M, np.inf))
    outward = peaks.points[inside] @ normals[k, side]
    if not len(outward):
        return 0.0
    order = np.argsort(outward)
    energy = np.cumsum(peaks.strengths[inside][order] ** 2)
    return float(outward[order][np.searchsorted(energy, _CONTENT_SHARE * energy[-1])])


def find_edge(
    peaks: PeakSet, normals: Floats, offsets_m: Floats, seen: Bools, face: Face, min_m: float
) -> tuple[float, float] | None:
    """Offset of an unseen face and its standard deviation [m]; None if no edge echoes.

    It is the outermost position of several echoes on seen walls that are not flashes.

    min_m: bound by the flashes and the content [m].
    """
    k, side = face
    points, toward, strength = peaks.points, peaks.directions, peaks.strengths
    outward = points @ normals[k, side]
    on_edge = np.zeros(len(peaks), dtype=bool)
    for j, other in zip(*np.nonzero(seen), strict=True):
        if j == k:
            continue
        normal, third = normals[j, other], 3 - j - k
        on_wall = np.abs(points @ normal - offsets_m[j, other]) < _ON_WALL_M
        on_wall &= peaks.centers @ normal > offsets_m[j, other]
        edge = np.cross(normal, normals[k, side])
        edge /= np.linalg.norm(edge)
        across = np.abs(toward @ np.cross(edge, normal)) > _MIN_SLOPE
        square = np.abs(toward @ edge) < _SQUARE_TO_EDGE
        for end in range(2):
            if seen[third, end]:
                corner = points @ normals[third, end] - offsets_m[third, end]
                square |= np.abs(corner) < _CORNER_M
                on_wall &= corner < _CORNER_M
        on_edge |= on_wall & across & square
    on_edge &= outward > min_m + _ON_WALL_M
    for position, members in _densest_planes(
        outward[on_edge], np.sqrt(strength[on_edge]), _MIN_SHARE
    ):
        own = np.flatnonzero(on_edge)[members]
        if len(np.unique(peaks.subapertures[own])) >= _MIN_SUBAPERTURES:
            spread = float(np.std(outward[own])) / np.sqrt(len(own))
            return position + _EDGE_INSIDE_M, float(np.hypot(_EDGE_SIGMA_M, spread))
    return None


def within(points: Floats, normals: Floats, offsets_m: Floats) -> Bools:
    """Whether points (n, 3) [m] lie within all faces, (n,). normals: (3, 2, 3)."""
    return np.asarray((np.tensordot(points, normals, (1, 2)) <= offsets_m).all(axis=(1, 2)))


def _densest_planes(
    offsets_m: Floats, weights: Floats, min_share: float = 0.0
) -> Iterator[tuple[float, Ints]]:
    """Positions of the density's maxima, the outermost first, and the indices of their members.

    min_share: least density relative to the largest.
    """
    if not len(offsets_m):
        return
    reach = float(np.abs(offsets_m).max(initial=0.0)) + 0.02
    cells = ((offsets_m + reach) / _PROFILE_STEP_M).astype(np.int64)
    counts = np.bincount(cells, weights, int(2.0 * reach / _PROFILE_STEP_M) + 1)
    middles = _PROFILE_STEP_M * (np.arange(len(counts)) + 0.5) - reach
    density = gaussian_filter1d(counts, _PROFILE_SIGMA_M / _PROFILE_STEP_M)
    peaks = 1 + np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:]))
    for peak in peaks[::-1]:
        near = np.flatnonzero(np.abs(offsets_m - middles[peak]) < 2.0 * _PROFILE_SIGMA_M)
        if len(near) and density[peak] >= min_share * density.max():
            yield float(np.average(offsets_m[near], weights=weights[near])), near
