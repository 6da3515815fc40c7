"""Multipath via a wall, predicted by glints (docs/math/echoes.md#multipath-via-a-wall).

What antenna, figure, wall, antenna adds to an image lies at the mean of two ranges, in the mean of
two directions: at the wall. Where several receivers share a transmitter it is repeated beside, and
so lies centimetres before the wall, where surface may be. Figure, normal and wall tell it.
"""

from collections.abc import Sequence

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.agreement import near_pairs
from geraf2.geometry.components import connected_labels
from geraf2.scene import Pose, Wall

_RANGE_M = 0.010
_ACROSS, _ALONG = 0.03, 0.08
"""Cosines along the horizontal and the vertical of a plane: receivers of a column that is h high
share a transmitter, and repeat the echo every wavelength / 2h, 0.059 with 8 rows of 4 mm."""
_BISECTOR_COSINE = float(np.cos(np.deg2rad(14.0)))
_FARTHEST_M = 0.06
"""From the wall, where such echoes lie: 0.08 of 0.47 m."""
_LINK_M, _LINK_COSINE = 0.012, float(np.cos(0.5))
_EXPLAINED = 1.0 / 3.0
"""Of a group of echoes of one plane, with which all of it goes. Of 18 planes' ghosts of a deer,
the only figure that these were set on, 0.75 go, 0.60 without groups, and of 3136 true glints none;
of 16000 of the ideal bunny, elephant, deer and chicken none."""
_PAIRS = 400_000


def over_walls(
    centers: Floats,
    directions: Floats,
    ranges_m: Floats,
    positions: Floats,
    poses: Ints,
    axes: Sequence[Floats | None],
    walls: Sequence[Wall],
) -> Bools:
    """Which echoes others explain as paths over them and a wall, (n,).

    centers: of the sub-apertures, (n, 3) [m]. directions: from there to the echoes, unit, (n, 3).
    ranges_m: (n,). positions: of the echoes, (n, 3) [m]. poses: plane of each, (n,).
    axes: of each plane: looking direction, horizontal, vertical, (3, 3); None where each receiver
    has a transmitter of its own, so that such echoes lie at the wall. walls: of the boxes.
    """
    found = np.zeros(len(positions), dtype=bool)
    for wall in walls:
        inner = 0.5 * np.asarray(wall.size_m) - wall.thickness_m
        for axis in range(3):
            for side in (-1.0, 1.0):
                place_m = wall.center_m[axis] + side * inner[axis]
                within = side * (place_m - centers[:, axis]) > 0.0
                depth_m = side * (place_m - positions[:, axis])
                near = within & (depth_m < _FARTHEST_M)
                for pose in np.unique(poses[near]):
                    across = axes[pose]
                    if across is None:
                        continue
                    own = np.flatnonzero(near & (poses == pose))
                    seen = (centers[own], directions[own], ranges_m[own])
                    found[own] |= _explained(seen, positions, -directions, across, axis, place_m)
    return _whole_groups(found, positions, directions, poses)


def shares_transmitters(pose: Pose) -> bool:
    """Whether several receivers of a plane share a transmitter's place."""
    return len(np.unique(np.round(pose.tx_positions, 5), axis=0)) < pose.n_antennas


def _explained(
    seen: tuple[Floats, Floats, Floats],
    points: Floats,
    normals: Floats,
    axes: Floats,
    axis: int,
    place_m: float,
) -> Bools:
    """Which of the echoes seen come over one of the points and the wall at a place on an axis."""
    centers, directions, ranges_m = seen
    middle = centers.mean(axis=0)
    roughly = _bisector_cosine(points, normals, middle[None], axis, place_m) > np.cos(0.5)
    points, normals = points[roughly], normals[roughly]
    found = np.zeros(len(centers), dtype=bool)
    if not len(points):
        return found
    images = _mirrored(points, axis, place_m)
    cosines = directions @ axes[1:].T
    step = max(1, _PAIRS // len(points))
    for first in range(0, len(centers), step):
        some = slice(first, first + step)
        way, far = points - centers[some, None], images - centers[some, None]
        way_m, far_m = np.linalg.norm(way, axis=2), np.linalg.norm(far, axis=2)
        mean = 0.5 * (way / way_m[..., None] + far / far_m[..., None]) @ axes[1:].T
        off = np.abs(mean - cosines[some, None])
        fits = np.abs(0.5 * (way_m + far_m) - ranges_m[some, None]) < _RANGE_M
        fits &= (off[..., 0] < _ACROSS) & (off[..., 1] < _ALONG)
        i, j = np.nonzero(fits)
        turned = _bisector_cosine(points[j], normals[j], centers[some][i], axis, place_m)
        found[first + i[turned > _BISECTOR_COSINE]] = True
    return found


def _bisector_cosine(
    points: Floats, normals: Floats, centers: Floats, axis: int, place_m: float
) -> Floats:
    """Cosine of a normal to the middle between the ways to an antenna and to its image, (n,)."""
    both = np.zeros_like(points)
    for ends in (centers, _mirrored(centers, axis, place_m)):
        way = ends - points
        both += way / np.linalg.norm(way, axis=1, keepdims=True)
    return np.asarray(np.einsum("ij,ij->i", normals, both) / np.linalg.norm(both, axis=1))


def _mirrored(places: Floats, axis: int, place_m: float) -> Floats:
    images = places.copy()
    images[:, axis] = 2.0 * place_m - images[:, axis]
    return images


def _whole_groups(found: Bools, positions: Floats, directions: Floats, poses: Ints) -> Bools:
    """Add groups of one plane, of which enough is explained."""
    if not found.any():
        return found
    i, j = near_pairs(positions, _LINK_M, poses)
    alike = np.einsum("ij,ij->i", directions[i], directions[j]) > _LINK_COSINE
    label = connected_labels(i[alike], j[alike], len(found))
    share = np.bincount(label, weights=found) / np.bincount(label)
    return np.asarray(found | (share >= _EXPLAINED)[label])
