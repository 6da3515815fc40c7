"""Faces of the box that no aperture sees at a right angle: their edges, and bounds for them.

The edge between an unseen face and a seen wall echoes along that wall, in directions perpendicular
to the edge. The flashes of the seen wall lie within it.
"""

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.echoes.flashes import (
    MAX_ANGLE_RAD,
    MAX_OFFSET_M,
    OFFSET_SIGMA_M,
    OVERLAP,
    WallMiddles,
    find_flashes,
)
from geraf2.echoes.wall_faces import WallFaces
from geraf2.imaging.peaks import PeakSet

# Largest distance of an edge's echo from its wall, and its distance inside of the edge [m].
_ON_WALL_M, _EDGE_INSIDE_M = 0.5 * MAX_OFFSET_M, 0.0025
# Share of the content's energy between the walls; the rest are grating lobes.
_CONTENT_SHARE = 0.9
# Least density of an edge's echoes, relative to the densest; grating lobes have less.
_MIN_SHARE = 0.4

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
    return max(float(feet[-int(OVERLAP)]), 0.0) if len(feet) >= OVERLAP else 0.0


def content_reach(
    peaks: PeakSet, normals: Floats, offsets_m: Floats, seen: Bools, face: Face
) -> float:
    """Offset towards a face that contains nine tenths of the energy within the seen walls [m]."""
    k, side = face
    inside = within(peaks.points, normals, np.where(seen, offsets_m - MAX_OFFSET_M, np.inf))
    outward = peaks.points[inside] @ normals[k, side]
    if not len(outward):
        return 0.0
    order = np.argsort(outward)
    energy = np.cumsum(peaks.strengths[inside][order] ** 2)
    return float(outward[order][np.searchsorted(energy, _CONTENT_SHARE * energy[-1])])


def find_edge(
    peaks: PeakSet, normals: Floats, offsets_m: Floats, seen: Bools, face: Face, min_m: float
) -> float | None:
    """Offset of an unseen face [m]; None if no edge echoes.

    It is the outermost position of several echoes on seen walls that are not flashes.

    min_m: bound by the flashes and the content [m].
    """
    k, side = face
    points, toward = peaks.points, peaks.directions
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
        across = np.abs(toward @ np.cross(edge, normal)) > MAX_ANGLE_RAD
        square = np.abs(toward @ edge) < MAX_ANGLE_RAD
        for end in range(2):
            if seen[third, end]:
                corner = points @ normals[third, end] - offsets_m[third, end]
                square |= np.abs(corner) < _ON_WALL_M
                on_wall &= corner < _ON_WALL_M
        on_edge |= on_wall & across & square
    own = np.flatnonzero(on_edge & (outward > min_m + _ON_WALL_M))
    at, weights = outward[own], np.sqrt(peaks.strengths[own])
    near = np.abs(at[:, None] - at) < OFFSET_SIGMA_M
    density = near @ weights
    for first in np.argsort(-at):
        members = near[first]
        if len(np.unique(peaks.subapertures[own[members]])) < OVERLAP:
            continue
        if density[first] >= _MIN_SHARE * density.max():
            members = near[np.flatnonzero(members)[density[members].argmax()]]
            return float(np.average(at[members], weights=weights[members])) + _EDGE_INSIDE_M
    return None


def within(points: Floats, normals: Floats, offsets_m: Floats) -> Bools:
    """Whether points (n, 3) [m] lie within all faces, (n,). normals: (3, 2, 3)."""
    return np.asarray((np.tensordot(points, normals, (1, 2)) <= offsets_m).all(axis=(1, 2)))
