"""Crossings of lines of sight with the surface that other glints show.

A specular return comes back along its line of sight. Metal blocks that line at the first surface,
so a return from behind a surface that faces away, which another plane sees from outside, passed
through the body (docs/math/echoes.md#back-faces).
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Bools, Floats, Ints

_REACH_M = 0.005
"""Radius of the disc of surface that a glint represents [m]."""
_MIN_COSINE = 0.3
"""Least cosine between a line of sight and the normal of a disc that it crosses; at flatter angles
0.5 mm of error moves the crossing by 1.7 mm."""
_OWN_M = 0.004
"""Nearer crossings may be of the glint's own surface [m]."""
BEHIND_M = 0.006
"""Least depth behind a surface [m]; errors and rounded edges of metal reach 5 mm."""
_METAL_SHARE = 0.015
"""Mean share of the returns of metal that seem to have passed through it, of those with a surface
on the other side; it is exponentially distributed, that of plastic uniform: means .014 of 26 parts,
.77 of 19 (`bench/python/materials.py`, seeds 0 to 9 and 10000 to 10007)."""
_OUTLIERS = 0.01
"""Share of parts that are not as their population."""
_CHUNK = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class Crossings:
    """Where lines of sight of glints cross the discs of other glints."""

    lines: Ints
    """Glint at the end of the line of sight, (n,)."""
    surfaces: Ints
    """Glint whose disc is crossed, (n,)."""
    depth_m: Floats
    """Distance in front of the line's own glint, (n,) [m]."""
    is_front: Bools
    """Whether the disc faces the antenna, (n,)."""


def find_crossings(positions: Floats, normals: Floats) -> Crossings:
    """Crossings of lines of sight, from glint to antenna, with the discs of other glints.

    positions: of glints or other returns, (n, 3) [m]. normals: (n, 3).
    """
    points = (positions - positions.mean(axis=0)).astype(np.float32)
    single = normals.astype(np.float32)
    square = np.einsum("ij,ij->i", points, points)
    parts = []
    for start in range(0, len(points), _CHUNK):
        some = np.arange(start, min(start + _CHUNK, len(points)))
        p, n = points[some], single[some]
        along = n @ points.T - np.einsum("ij,ij->i", p, n)[:, None]
        beside2 = square[some, None] + square - 2.0 * (p @ points.T) - along * along
        row, other = np.nonzero((along > _OWN_M - _REACH_M) & (beside2 < 1.01 * _REACH_M**2))
        parts.append((some[row], other))
    line, surface = (np.concatenate([part[k] for part in parts]).astype(np.int64) for k in (0, 1))
    facing = np.einsum("ij,ij->i", normals[line], normals[surface])
    steep = np.abs(facing) > _MIN_COSINE
    line, surface, facing = line[steep], surface[steep], facing[steep]
    offset = positions[surface] - positions[line]
    depth = np.einsum("ij,ij->i", offset, normals[surface]) / facing
    offset -= depth[:, None] * normals[line]
    met = (depth > _OWN_M) & (np.linalg.norm(offset, axis=1) < _REACH_M)
    return Crossings(
        lines=line[met], surfaces=surface[met], depth_m=depth[met], is_front=facing[met] > 0.0
    )


def odds_of_metal(passed_share: float) -> float:
    """Log odds of metal against plastic, given the share of returns that passed through a surface.

    0 at a share of 0.063: what passed through more is plastic.
    """
    metal = np.exp(-passed_share / _METAL_SHARE) / _METAL_SHARE
    return float(np.log((1.0 - _OUTLIERS) * metal + _OUTLIERS))
