"""Evidence of two scans of one content: shifts of its parts, and echoes without a counterpart.

The glints of one scan are compared with the surface and with all peaks of the other one
(docs/inspection.md#two-scans).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.apps.inspection.bodies import Body
from geraf2.echoes import Glints
from geraf2.freespace.specular import specular_visibility
from geraf2.geometry.transforms import apply_rigid
from geraf2.scene.aperture import Aperture

LIKELY = 0.5
"""Least probability of a glint that counts."""
_COMMON_M = 0.0007
"""Standard deviation of an offset along all normals: of the delays of both scans [m]."""
_PLANE_M, _GLINT_M = 0.00055, 0.0013
"""Standard deviation of the mean distance of a part that one plane sees: that of any number of
glints, and that of one glint, divided by the root of their number [m]. Glints of one plane share
drift and merged echoes. Of 162 cells of pairs in which no part moved
(`bench/python/compare_pairs.py`, seeds 0 to 3)."""
_BOTH = 2.0
"""Factor of this variance: both directions of the comparison measure the same distance."""
_MAX_M = 0.006
"""Distances beyond are of other surface [m]."""
_NEAR_M, _COSINE = 0.010, 0.94
"""Largest lateral distance of counterparts [m], and least cosine of their normals."""
_TURN_M = 0.04
"""Distance that counts as much as a turn of the normal by one radian [m]."""
_RANGE_M = 0.004
"""Largest distance of both along the normal [m]."""
_EDGE_M = 0.03
"""Least distance of the mirror point from the edge of a plane's aperture: most of a sub-aperture
lies on the plane [m]."""
_TAIL, _N_WEIGHTS = 4.0, 5
"""Degrees of freedom of the errors, and steps of their weights."""
_SHIFT_M = 0.003
"""Standard deviation of the shift of a part that moved [m]."""
_MIN_GLINTS = 3
"""Fewest glints of a cell."""


class Evidence(NamedTuple):
    """What a scan measured of its content."""

    glints: Glints
    """Likely returns of the content."""
    peaks: tuple[Floats, Floats]
    """Positions [m] and normals of all peaks, whatever their label, (n, 3) each."""
    apertures: Sequence[Aperture]
    """Of its planes."""


class Cells(NamedTuple):
    """Mean distances of the parts, of each plane that sees them."""

    parts: Ints
    """Part of each cell, (n,)."""
    distances_m: Floats
    """Mean distance of the other surface along the normals, (n,) [m]."""
    normals: Floats
    """Mean normal, (n, 3)."""
    levers_m: Floats
    """Mean of position x normal, (n, 3) [m]."""
    variances_m2: Floats
    """Of the distances, but for what all share, (n,) [m^2]."""


class Shift(NamedTuple):
    """Shift of a part by itself."""

    log_odds: float
    """Evidence that it moved, against not at all."""
    shift_m: Floats
    """Estimate, (3,) [m]."""
    covariance: Floats
    """Of the estimate, (3, 3) [m^2]."""


def cells_of(one: Evidence, other: Evidence, pose: Floats, parts: Sequence[Body]) -> Cells:
    """Cells of the glints of one scan against those of another.

    pose: moves the first into the frame of the other, (4, 4). parts: in the frame of the other.
    """
    glints, others = one.glints, other.glints
    if not min(len(glints), len(others)):
        none = np.zeros((0, 3))
        return Cells(np.zeros(0, dtype=np.int64), none[:, 0], none, none, none[:, 0])
    x, n = apply_rigid(pose, glints.positions), glints.normals @ pose[:3, :3].T
    tree = KDTree(np.c_[others.positions, _TURN_M * others.normals])
    nearest = tree.query(np.c_[x, _TURN_M * n])[1]
    chord = others.positions[nearest] - x
    # A chord of a circle is normal to the mean of the normals at its ends.
    middle = n + others.normals[nearest]
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)
    off = np.einsum("ij,ij->i", chord, middle)
    lateral = np.linalg.norm(chord - off[:, None] * middle, axis=1)
    alike = np.einsum("ij,ij->i", n, others.normals[nearest]) > _COSINE
    good = np.flatnonzero(alike & (np.abs(off) < _MAX_M) & (lateral < _NEAR_M))
    owner = owners_of(x[good], parts)
    cell, label = np.unique(
        np.stack([owner, glints.poses[good]], axis=1), axis=0, return_inverse=True
    )
    label = label.reshape(-1)
    count = np.bincount(label, minlength=len(cell))

    def mean(values: Floats) -> Floats:
        sums = np.zeros((len(cell), *values.shape[1:]))
        np.add.at(sums, label, values)
        return sums / count.reshape(-1, *[1] * (values.ndim - 1))

    kept = count >= _MIN_GLINTS
    return Cells(
        parts=cell[kept, 0],
        distances_m=mean(off[good])[kept],
        normals=mean(middle[good])[kept],
        levers_m=mean(np.cross(x[good], middle[good]))[kept],
        variances_m2=_BOTH * (_PLANE_M**2 + _GLINT_M**2 / count[kept]),
    )


def join_cells(there: Cells, back: Cells, pose: Floats) -> Cells:
    """Cells of both directions, in the frame of the second scan.

    back: of the glints of the second scan, in the frame of the first one. pose: moves the first
    into the frame of the second, (4, 4).
    """
    turn, shift = pose[:3, :3], pose[:3, 3]
    normals = back.normals @ turn.T
    levers = back.levers_m @ turn.T + np.cross(shift, normals)
    # A surface that lies outside of the glints has the glints inside of it.
    return Cells(
        parts=np.concatenate([there.parts, back.parts]),
        distances_m=np.concatenate([there.distances_m, -back.distances_m]),
        normals=np.concatenate([there.normals, normals]),
        levers_m=np.concatenate([there.levers_m, levers]),
        variances_m2=np.concatenate([there.variances_m2, back.variances_m2]),
    )


def shifts_of(
    cells: Cells, n_parts: int, middle_m: Floats, play: tuple[float, float], beside: Floats
) -> tuple[Floats, Floats, dict[int, Shift]]:
    """Turn and shift of the content about a point, (3,) each, and parts that moved by themselves.

    Cells are e = n . (t + w x (x - c) + s_part) + b, plus errors; b is an offset of all. Parts are
    added one by one, the likeliest first, as long as their shift is likelier than not.

    middle_m: the point c, (3,) [m]. play: standard deviations of w [rad] and of t [m]. beside: w
    and t at which the cells were measured, (6,).
    """
    about = cells.levers_m - np.cross(middle_m, cells.normals)
    design = np.concatenate([about, cells.normals, np.ones((len(about), 1))], axis=1)
    prior = np.repeat([play[0] ** 2, play[1] ** 2, _COMMON_M**2], [3, 3, 1])
    found: dict[int, Shift] = {}
    e = cells.distances_m + design[:, :6] @ beside
    shared = (design * prior) @ design.T
    own_shifts = _SHIFT_M**2 * (cells.normals @ cells.normals.T)
    own_shifts *= cells.parts[:, None] == cells.parts
    covariance = shared + np.diag(_widen_tails(e, cells.variances_m2, shared + own_shifts))
    while len(found) < n_parts:
        inverse = np.linalg.inv(covariance)
        tried = {
            part: _shift(inverse, e, cells.normals * (cells.parts == part)[:, None])
            for part in range(n_parts)
            if part not in found and (cells.parts == part).any()
        }
        best = max(tried, key=lambda part: tried[part].log_odds, default=-1)
        if best < 0 or tried[best].log_odds <= 0.0:
            break
        found[best] = tried[best]
        own = cells.normals * (cells.parts == best)[:, None]
        covariance = covariance + _SHIFT_M**2 * own @ own.T
    common = prior * (design.T @ np.linalg.solve(covariance, e)) if len(e) else np.zeros(7)
    return common[:3], common[3:6], found


def _widen_tails(e: Floats, variances_m2: Floats, explained: Floats) -> Floats:
    """Variances for errors of Student's t: larger where even shifts of all parts explain little."""
    # explained: covariance of all that is no error, (n, n) [m^2].
    found = variances_m2
    for _ in range(_N_WEIGHTS):
        rest = found * np.linalg.solve(explained + np.diag(found), e)
        found = variances_m2 * np.maximum(1.0, (_TAIL + rest**2 / variances_m2) / (_TAIL + 1.0))
    return np.asarray(found)


def _shift(inverse: Floats, distances_m: Floats, normals: Floats) -> Shift:
    """Shift of a part with normals (n, 3), zero at other parts, and its Bayes factor."""
    information, slope = normals.T @ inverse @ normals, normals.T @ inverse @ distances_m
    covariance = np.linalg.inv(information + np.eye(3) / _SHIFT_M**2)
    shift = covariance @ slope
    size = np.linalg.slogdet(np.eye(3) + _SHIFT_M**2 * information)[1]
    return Shift(float(0.5 * (slope @ shift - size)), shift, np.asarray(covariance, np.float64))


def find_missed(one: Evidence, other: Evidence, pose: Floats) -> tuple[Bools, Bools]:
    """Glints of one scan that the planes of another should see, and those that it did not see.

    pose: moves the first into the frame of the other, (4, 4). Returns (n_glints,) each.
    """
    x, n = apply_rigid(pose, one.glints.positions), one.glints.normals @ pose[:3, :3].T
    margins = specular_visibility(x, n, other.apertures, min_m=_EDGE_M)
    visible = np.asarray((margins > -np.inf).any(axis=1))
    seen = _have_counterparts(x, n, other.peaks, _RANGE_M)
    return visible, visible & ~seen


def _have_counterparts(
    positions: Floats, normals: Floats, others: tuple[Floats, Floats], range_m: float
) -> Bools:
    """Whether a point with a similar normal lies near each point, (n,)."""
    pairs = KDTree(positions).sparse_distance_matrix(
        KDTree(others[0]), float(np.hypot(range_m, _NEAR_M)), output_type="ndarray"
    )
    i, j = pairs["i"], pairs["j"]
    off = np.einsum("ij,ij->i", others[0][j] - positions[i], normals[i])
    lateral = np.sqrt(np.maximum(pairs["v"] ** 2 - off**2, 0.0))
    alike = np.einsum("ij,ij->i", others[1][j], normals[i]) > _COSINE
    good = alike & (np.abs(off) < range_m) & (lateral < _NEAR_M)
    return np.asarray(np.bincount(i[good], minlength=len(positions)) > 0)


def owners_of(points: Floats, parts: Sequence[Body]) -> Ints:
    """Index of the nearest part of each point, (n,)."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    gaps = [KDTree(part.mesh.vertices).query(points)[0] for part in parts]
    return np.asarray(np.argmin(gaps, axis=0), dtype=np.int64)
