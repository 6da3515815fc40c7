"""Which glints hang together as a smooth surface does.

Two points of a smooth surface with their normals fit to each other: the chord between them is
perpendicular to the mean of both normals. Scatterers, side lobes and echoes that blurred together
do not line up with their neighbours in this way (docs/math/echoes.md#connected-glints).
"""

from dataclasses import dataclass

import numpy as np

from geraf2._bounds import AngleRad, Bounded, Decibels, LengthM
from geraf2._types import Bools, Ints
from geraf2.echoes.agreement import Pairs, near_pairs, tangent_offset
from geraf2.echoes.glint_set import Glints, strong_level
from geraf2.geometry.components import connected_labels

FEW_PLANES = 12
"""With fewer planes each sees other places, and chains of glints do not reach to the next."""

CLUTTER = 0.15
"""Share of glints that hang on to no strong one, above which there are scatterers: 0.05 if
clean."""


@dataclass(frozen=True, kw_only=True)
class LinkConfig(Bounded):
    """Which glints are believed because a chain of links leads to a strong one."""

    strong_db: Decibels = 16.0
    """A glint is strong if it is weaker than the 98 % quantile by less than this [dB]."""
    few_planes_strong_db: Decibels = 24.0
    """The same with fewer than 12 planes [dB]."""
    reach_m: LengthM = 0.008
    """Length of a link at most [m]."""
    chord_m: LengthM = 0.001
    """Half of the chord's product with the sum of both normals at most [m]."""
    angle_rad: AngleRad = 0.5
    """Angle between both normals at most [rad]."""


def linked_to_strong(glints: Glints, n_poses: int, config: LinkConfig | None = None) -> Bools:
    """Strong glints and those that a chain of links joins to one, (n_glints,).

    n_poses: planes of the scan.
    config: what is strong, and what a link.
    """
    config = config or LinkConfig()
    n = len(glints)
    if n == 0:
        return np.zeros(0, dtype=bool)
    strong_db = config.strong_db if n_poses >= FEW_PLANES else config.few_planes_strong_db
    floor = strong_level(glints.strengths) * 10.0 ** (-strong_db / 20.0)
    i, j = smooth_pairs(glints, reach_m=config.reach_m, chord_m=config.chord_m)
    alike = np.einsum("ij,ij->i", glints.normals[i], glints.normals[j]) > np.cos(config.angle_rad)
    i, j = i[alike], j[alike]
    chain = connected_labels(i, j, n)
    has_strong = np.zeros(int(chain.max()) + 1, dtype=bool)
    has_strong[chain[glints.strengths > floor]] = True
    return np.asarray(has_strong[chain])


def smooth_pairs(
    glints: Glints,
    *,
    reach_m: float,
    chord_m: float,
    within: Ints | None = None,
) -> Pairs:
    """Pairs that fit onto one surface of second order; each pair once.

    reach_m: their distance at most [m].
    chord_m: |(p_i - p_j) . (n_i + n_j)| / 2 at most [m].
    within: only pairs of equal number, (n_glints,); all when None.
    """
    i, j = near_pairs(glints.positions, reach_m, within)
    mean = 0.5 * (glints.normals[i] + glints.normals[j])
    fits = np.abs(tangent_offset(glints.positions[i], glints.positions[j], mean)) < chord_m
    return i[fits], j[fits]


def spread(known: Bools, pairs: Pairs, n_rounds: int) -> Bools:
    """Go a number of steps along pairs from what is known, (n_glints,)."""
    i, j = pairs
    reached = known.copy()
    for _ in range(n_rounds):
        grown = reached.copy()
        grown[i[reached[j]]] = True
        grown[j[reached[i]]] = True
        reached = grown
    return reached
