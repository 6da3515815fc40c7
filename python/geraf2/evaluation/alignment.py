"""Rigid motion that brings a surface onto the truth, for scores that frame errors do not enter."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from geraf2._types import Floats

_ROUNDS = 12
_TRIM = 3.0
"""Points farther from the truth than this times the median do not count: wrong parts, no motion."""


class RigidMotion(NamedTuple):
    """Rotation about a centre, then a translation."""

    rotation: Floats
    """Rotation vector, (3,) [rad]."""
    translation_m: Floats
    """(3,) [m]."""
    center_m: Floats
    """(3,) [m]."""

    def apply(self, points: Floats) -> Floats:
        """Move points, (n, 3) [m]."""
        turned = Rotation.from_rotvec(self.rotation).apply(points - self.center_m)
        return np.asarray(turned + self.center_m + self.translation_m)


def rigid_alignment(points: Floats, true_points: Floats, true_normals: Floats) -> RigidMotion:
    """Rigid motion of points onto a surface: point-to-plane distances, least trimmed squares.

    points: of the surface, (n, 3) [m].
    true_points, true_normals: samples of the truth and their unit normals, (m, 3) each.

    Chen and Medioni 1992, "Object modelling by registration of multiple range images".
    """
    center = points.mean(axis=0)
    motion = RigidMotion(np.zeros(3), np.zeros(3), center)
    tree = KDTree(true_points)
    for _ in range(_ROUNDS):
        moved = motion.apply(points)
        distance, nearest = tree.query(moved)
        good = distance <= _TRIM * np.median(distance)
        normals, arms = true_normals[nearest[good]], moved[good] - center
        rows = np.concatenate([np.cross(arms, normals), normals], axis=1)
        off = np.einsum("nk,nk->n", true_points[nearest[good]] - moved[good], normals)
        step = np.linalg.lstsq(rows, off, rcond=None)[0]
        turn = Rotation.from_rotvec(step[:3])
        motion = RigidMotion(
            (turn * Rotation.from_rotvec(motion.rotation)).as_rotvec(),
            np.asarray(turn.apply(motion.translation_m) + step[3:]),
            center,
        )
    return motion
