"""Glints behind others in their own line of sight: back faces of what waves pass through.

A specular echo returns along the line of sight from which it is seen. Metal stops that line at the
first surface, so whatever seems to lie behind another glint's surface there was reached through it
(docs/math/echoes.md#back-faces).
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.glint_set import Glints

# A glint stands for the surface this far around it; neighbours that agree lie within 8 mm.
_REACH_M = 0.005
# Surfaces met at a flatter angle than this are not judged: at 17 degrees 0.5 mm of error moves the
# crossing by 1.7 mm.
_MIN_COSINE = 0.3
# Crossings nearer to the glint than this may be of its own surface.
_OWN_M = 0.004
# A glint this far behind others is accused: those of metal are up to 5 mm, rounded edges and errors
# of 1 mm both ways.
BEHIND_M = 0.006
# So many that face its antenna are enough, or twice as many that face away: no line of sight comes
# to these from within before it has met a front, which may not be seen squarely by any antenna.
_N_FRONTS = 2
_N_BACKS = 4
# The same to show that waves pass through at all, of so many lines at most.
_FAR_BEHIND_M = 0.015
_N_LINES = 2000
_CHUNK = 256
_MAX_ROUNDS = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Crossings:
    """Where lines of sight of glints cross the surfaces that other glints stand for."""

    lines: Ints
    """Glint whose line of sight it is, (n,)."""
    surfaces: Ints
    """Glint whose surface is crossed, (n,)."""
    depth_m: Floats
    """How far before the line's own glint, (n,) [m]."""
    is_front: Bools
    """Whether the surface faces the antenna, (n,)."""


def find_crossings(glints: Glints, lines: Ints | None = None) -> Crossings:
    """Crossings of lines of sight, from glint to antenna, with discs about other glints.

    glints: all.
    lines: those whose lines are followed, (n_lines,); all when None.
    """
    chosen = np.arange(len(glints)) if lines is None else lines
    points = (glints.positions - glints.positions.mean(axis=0)).astype(np.float32)
    normals = glints.normals.astype(np.float32)
    square = np.einsum("ij,ij->i", points, points)
    parts = []
    for start in range(0, len(chosen), _CHUNK):
        some = chosen[start : start + _CHUNK]
        p, n = points[some], normals[some]
        along = n @ points.T - np.einsum("ij,ij->i", p, n)[:, None]
        beside2 = square[some, None] + square - 2.0 * (p @ points.T) - along * along
        row, other = np.nonzero((along > _OWN_M - _REACH_M) & (beside2 < 1.01 * _REACH_M**2))
        parts.append((some[row], other))
    line, surface = (np.concatenate([part[k] for part in parts]).astype(np.int64) for k in (0, 1))
    facing = np.einsum("ij,ij->i", glints.normals[line], glints.normals[surface])
    steep = np.abs(facing) > _MIN_COSINE
    line, surface, facing = line[steep], surface[steep], facing[steep]
    offset = glints.positions[surface] - glints.positions[line]
    depth = np.einsum("ij,ij->i", offset, glints.normals[surface]) / facing
    offset -= depth[:, None] * glints.normals[line]
    met = (depth > _OWN_M) & (np.linalg.norm(offset, axis=1) < _REACH_M)
    return Crossings(
        lines=line[met], surfaces=surface[met], depth_m=depth[met], is_front=facing[met] > 0.0
    )


def seen_through_share(glints: Glints) -> float:
    """Share of the strength of glints behind a body that others show from both sides.

    Such a glint lies at least 1.5 cm behind two that face its antenna, and behind one that faces
    away. Metal has next to none. What stands in a shell is not meant: its far side is behind it.
    """
    n = len(glints)
    if n == 0:
        return 0.0
    lines = np.arange(0, n, -(-n // _N_LINES))
    found = find_crossings(glints, lines)
    front = found.is_front & (found.depth_m > _FAR_BEHIND_M)
    behind = np.bincount(found.lines[front], minlength=n) >= _N_FRONTS
    behind &= np.bincount(found.lines[~found.is_front], minlength=n) > 0
    strengths = glints.strengths
    return float(strengths[behind].sum() / strengths[lines].sum())


def seen_first(glints: Glints) -> tuple[Bools, Bools]:
    """Glints that are not behind others in their line of sight: surely; perhaps, (n_glints,) each.

    Others count that are themselves seen first: those that nobody accuses are, whom enough of them
    accuse is not, and so on with what is left. Fronts accuse first, then, among what is left,
    backs, too. Who accuse each other stay in doubt: perhaps.
    """
    found = find_crossings(glints)
    accuses = found.depth_m > BEHIND_M
    accused, accuser = found.lines[accuses], found.surfaces[accuses]
    is_front = found.is_front[accuses]
    nobody = np.zeros(len(glints), dtype=bool)
    weight = np.where(is_front, _N_BACKS, 0)  # in whole numbers, a front worth two backs
    behind = ~_sift(accused, accuser, weight, nobody)[1]
    return _sift(accused, accuser, np.where(is_front, _N_BACKS, _N_FRONTS), behind)


def _sift(accused: Ints, accuser: Ints, weight: Ints, known: Bools) -> tuple[Bools, Bools]:
    """Who is seen first for sure, and who perhaps, where some are known to be behind."""
    n, enough = len(known), _N_FRONTS * _N_BACKS
    behind, first = known, ~known
    for _ in range(_MAX_ROUNDS):
        first = ~known & (np.bincount(accused, weight * ~behind[accuser], n) < enough)
        more = known | (np.bincount(accused, weight * first[accuser], n) >= enough)
        if (more == behind).all():
            break
        behind = more
    return first, ~behind
