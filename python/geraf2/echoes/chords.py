"""Front faces of plastic whose glints are back faces (docs/math/echoes.md#chords).

A chord of length t that is entered at f has its back face at f + n t. A plane on the other side
sees the same chord, so that both back faces lie (2 n - 1) t apart, a front and a back face
(n - 1) t, and both front faces t.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.glint_set import Glints, relative_strengths

_INDEX = 1.67
"""Refractive index of plastics. Opposite back faces show the front to 0.02 of their distance for
1.58 to 1.82."""
_STEP_M, _REACH_M = 0.0005, 0.2
"""Step along a line and largest distance on it [m]."""
_LENGTHS_M = np.arange(0.003, 0.12, 2.0 * _STEP_M)
_ALONG_M, _BESIDE_M, _TURN_RAD = 0.0025, 0.003, 0.2
"""Standard deviations of echoes of one chord along and beside it [m], and of their normals."""
_MIN_COSINE = 0.7
_WEAK = 0.2
"""Least strength over the strongest echo of the line. A weaker one lies on the skirt of the strong
one, which displaces it."""
_FEW = 0.02
"""Least share of faces that are seen, of lines with clutter at a place, and the rest of one."""
_N_LINES, _N_OTHERS, _AT_ONCE, _ROUNDS = 400, 2000, 256, 12
_MAX_SIGMA_M = 0.005
"""Largest standard deviation of a front face that is known [m]."""
_PLACED = 0.5
"""Least share of the strength of back faces whose front is known: 0 of nine bodies
whose fronts are seen, too, 0.52 and more of balls, pill and beads."""


class _Lines(NamedTuple):
    """Echoes on lines of sight, over the strongest of each line, by the distance ahead."""

    same: Floats  # of antennas on this side, (n_lines, n_steps)
    opposite: Floats  # of antennas on the other side
    weights: Floats

    @classmethod
    def of(cls, glints: Glints, rows: Ints, weights: Floats) -> "_Lines":
        columns = _spread(len(glints), _N_OTHERS)
        others, strengths = glints.select(columns), weights[columns]
        n_steps = 2 * round(_REACH_M / _STEP_M) + 1
        found = np.zeros((2, len(rows), n_steps))
        for side, sign in enumerate((1.0, -1.0)):
            for first in range(0, len(rows), _AT_ONCE):
                own = glints.select(rows[first : first + _AT_ONCE])
                cosine = sign * own.normals @ others.normals.T
                i, j = np.nonzero(cosine > _MIN_COSINE)
                offset, cosine = others.positions[j] - own.positions[i], cosine[i, j]
                along = np.einsum("ij,ij->i", offset, own.normals[i] + sign * others.normals[j])
                along /= np.sqrt(2.0 + 2.0 * cosine)
                beside2 = np.einsum("ij,ij->i", offset, offset) - along**2
                share = np.exp(-0.5 * beside2 / _BESIDE_M**2 - (1.0 - cosine) / _TURN_RAD**2)
                near = np.abs(along) < _REACH_M
                cell = i[near] * n_steps + _step(along[near])
                size = len(own) * n_steps
                flat = np.bincount(cell, share[near] * strengths[j[near]], size)
                found[side, first : first + _AT_ONCE] = flat.reshape(len(own), n_steps)
        found = gaussian_filter1d(found, _ALONG_M / _STEP_M, axis=2)
        top = found.max(axis=2, keepdims=True)
        found /= np.maximum(top, 0.1 * np.quantile(top, 0.9))
        return cls(found[0], found[1], weights[rows])

    def across(self) -> tuple[Floats, Floats, Floats]:
        """Echoes on the other side, for each length of a chord, (n_lines, n_lengths) each.

        The front face seen from a front face, one face from the other, the back from a back face.
        """
        steps = (-1.0, _INDEX - 1.0, 2.0 * _INDEX - 1.0)
        away, near, across = (self.opposite[:, _step(d * _LENGTHS_M)] for d in steps)
        return away, near, across


class _Faces(NamedTuple):
    """What is seen of a body."""

    front: float  # share of its front faces
    back: float  # of its back faces
    lengths: Floats  # distribution of its chords


def place_fronts(glints: Glints) -> tuple[Glints, Bools] | None:
    """Glints moved to the fronts of their chords, and which are known; None where most are not.

    Shares of faces and lengths of chords are those that are most likely, by expectation
    maximisation.
    """
    weights = glints.probability * relative_strengths(glints.strengths)
    faces = _Faces(_FEW, 1.0 - _FEW, np.full(len(_LENGTHS_M), 1.0 / len(_LENGTHS_M)))
    lines = _Lines.of(glints, _spread(len(glints), _N_LINES), weights)
    for _ in range(_ROUNDS):
        faces = _update(lines, faces)
    lines = _Lines.of(glints, np.arange(len(glints)), weights)
    front, back = _chances(lines, faces)
    grown = back.cumsum(axis=1)
    is_back = grown[:, -1] > front.sum(axis=1)
    # Middle and half of the central 68 %: tails of the lengths are long.
    low, length, high = (
        _LENGTHS_M[(grown < q * grown[:, -1:]).sum(axis=1)] for q in (0.16, 0.5, 0.84)
    )
    sigma = 0.5 * _INDEX * (high - low)
    strong = lines.same[:, lines.same.shape[1] // 2] > _WEAK
    known = is_back & strong & (sigma < _MAX_SIGMA_M)
    if weights[known].sum() < _PLACED * weights.sum():
        return None
    moved = replace(
        glints,
        positions=glints.positions + (_INDEX * length)[:, None] * glints.normals,
        position_sigma_m=np.hypot(glints.position_sigma_m, sigma),
    )
    return moved, known


def _update(lines: _Lines, faces: _Faces) -> _Faces:
    """Shares of the faces that are seen, where those before predict them."""
    t, n = _LENGTHS_M, _INDEX
    front, back = _chances(lines, faces)
    total = (front + back).sum(axis=1, keepdims=True)
    front, back = lines.weights[:, None] * front / total, lines.weights[:, None] * back / total
    away, near, across = lines.across()
    n_front = (back * (lines.same[:, _step(n * t)] + near) + front * away).sum()
    n_back = (front * (lines.same[:, _step(-n * t)] + near) + back * across).sum()
    chords, lengths = front.sum() + back.sum(), gaussian_filter1d((front + back).sum(axis=0), 3.0)
    return _Faces(
        float(np.clip(n_front / (back.sum() + chords), _FEW, 1.0 - _FEW)),
        float(np.clip(n_back / (front.sum() + chords), _FEW, 1.0 - _FEW)),
        0.9 * lengths / lengths.sum() + 0.1 / len(t),
    )


def _chances(lines: _Lines, faces: _Faces) -> tuple[Floats, Floats]:
    """Joint probability of a front or back face and of the chord's length, (n_lines, n_lengths)."""
    t, n = _LENGTHS_M, _INDEX
    away, near, across = lines.across()
    front = _seen(lines.same[:, _step(-n * t)], faces.back)
    front *= _seen(away, faces.front) * _seen(near, faces.back)
    back = _seen(lines.same[:, _step(n * t)], faces.front)
    back *= _seen(near, faces.front) * _seen(across, faces.back)
    first = faces.front / (faces.front + faces.back)
    return first * faces.lengths * front, (1.0 - first) * faces.lengths * back


def _seen(support: Floats, share: float) -> Floats:
    """Likelihood of what is seen at the place of a face, over that of clutter."""
    clutter = (1.0 - _FEW) * (1.0 - support) + _FEW * support
    return np.asarray(((1.0 - share) * (1.0 - support) + share * support) / clutter)


def _step(distance_m: Floats) -> Ints:
    """Index of distances on a line."""
    inside = np.clip(distance_m, -_REACH_M, _REACH_M)
    return np.rint((inside + _REACH_M) / _STEP_M).astype(np.int64)


def _spread(n: int, n_most: int) -> Ints:
    """At most so many indices, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, n_most)).astype(np.int64))
