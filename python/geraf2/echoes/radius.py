"""Most frequent radius of curvature of the content, which an error of the delay shifts.

A wrong instrument delay moves every echo along its line of sight, so that the content becomes an
offset surface: its normals stay, its planes agree, and all radii of curvature change by the error
of the range. Echoes in many directions come from edges, tips and thin parts. The most frequent
radius of a scan with the right delay is therefore small, whatever the content is, and never
negative (docs/math/verdict.md#delay-by-the-most-frequent-radius).
"""

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2.echoes.glint_set import Glints

_MIN_TURN_RAD, _MAX_TURN_RAD = 0.15, 0.5
"""Angles between the normals of a pair [rad]: below, the radius is uncertain by a centimetre."""
_OFFSET_M = 3e-3
"""Largest offset of a pair along its mean normal [m], twice the error of a glint."""
_ASIDE_M = 0.01
"""Largest distance of a pair across the direction in which the normal turns [m]."""
_MAX_GLINTS = 2000
_SPREAD_M = 0.003
"""Standard deviation of a pair's radius [m]."""
_CELL_M, _REACH_M = 1e-3, 0.2
_MIN_PAIRS = 100
"""Least number of pairs that show a radius; pairs of one plane where planes have fewer."""


def pair_radii(glints: Glints, *, same_plane: bool = False) -> Floats:
    """Radii of curvature from pairs of glints of different planes, (n_pairs,) [m].

    same_plane: pairs of one plane instead, which err together but need no neighbouring plane.

    For neighbours on a surface the normal changes by dn over the distance dp. The radius in that
    direction is dp . dn / |dn|^2, positive where the surface is convex.
    """
    step = max(1, -(-len(glints) // _MAX_GLINTS))
    positions, normals, poses = (
        values[::step] for values in (glints.positions, glints.normals, glints.poses)
    )
    i, j = KDTree(normals).query_pairs(_MAX_TURN_RAD, output_type="ndarray").T
    asked = (poses[i] == poses[j]) == same_plane
    i, j = i[asked], j[asked]
    turn = normals.take(j, axis=0) - normals.take(i, axis=0)
    angle = np.linalg.norm(turn, axis=1)
    far = angle > _MIN_TURN_RAD
    i, j, turn, angle = i[far], j[far], turn[far], angle[far]
    between = positions.take(j, axis=0) - positions.take(i, axis=0)
    middle = normals.take(i, axis=0) + normals.take(j, axis=0)
    middle /= np.linalg.norm(middle, axis=1)[:, None]
    along, offset = (
        np.einsum("ij,ij->i", between, unit) for unit in (turn / angle[:, None], middle)
    )
    aside2 = np.einsum("ij,ij->i", between, between) - along**2 - offset**2
    near = (np.abs(offset) < _OFFSET_M) & (aside2 < _ASIDE_M**2)
    return np.asarray(along[near] / angle[near])


def modal_radius_m(glints: Glints) -> float | None:
    """Most frequent radius of curvature [m]; None where too few pairs show one."""
    radii = pair_radii(glints)
    if len(radii) < _MIN_PAIRS:
        radii = pair_radii(glints, same_plane=True)
    edges = np.arange(-_REACH_M, _REACH_M + _CELL_M, _CELL_M)
    counts = np.histogram(radii, edges)[0].astype(np.float64)
    if len(radii) < _MIN_PAIRS:
        return None
    offsets = np.arange(-4.0 * _SPREAD_M, 4.1 * _SPREAD_M, _CELL_M)
    smooth = np.convolve(counts, np.exp(-0.5 * (offsets / _SPREAD_M) ** 2), "same")
    return float(edges[int(smooth.argmax())] + 0.5 * _CELL_M)
