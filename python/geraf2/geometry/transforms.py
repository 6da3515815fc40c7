"""Rigid transforms, (4, 4) on columns (x, y, z, 1)."""

from collections.abc import Iterable

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError

# Largest deviation of a scale from 1: poses in files may have only four digits.
_ROTATION_TOLERANCE = 1e-2

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Converts camera axes x right, y up, z backward to x right, y down, z forward, and back."""


def rigid(rotation: Floats, translation: Floats) -> Floats:
    """Transform x -> R x + t, (4, 4)."""
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation
    return transform


def inverse_rigid(rotation: Floats, translation: Floats) -> Floats:
    """Inverse of the transform x -> R x + t, (4, 4).

    A matrix that is no rotation is not refused: the caller checks it.
    """
    return rigid(rotation.T, -rotation.T @ translation)


def apply_rigid(transform: Floats, points: Floats) -> Floats:
    """Transform points (..., 3) [m]."""
    return np.asarray(points @ transform[:3, :3].T + transform[:3, 3])


def rotation_of_quaternion(quaternion: Floats) -> Floats:
    """Rotation matrix of a quaternion (w, x, y, z) of any length; NaN for zero."""
    norm = float(np.linalg.norm(quaternion))
    w, x, y, z = quaternion / norm if norm > 0.0 else np.full(4, np.nan)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def require_rigid(matrix: Floats, where: object) -> Floats:
    """Nearest 4 x 4 rigid transform; UserError if the matrix is none, or a reflection."""
    if matrix.shape not in ((4, 4), (3, 4)):
        raise UserError(what="the pose must be a 4 x 4 matrix", where=where, got=matrix.shape)
    if matrix.shape == (4, 4) and not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], atol=1e-6):
        raise UserError(
            what="the last row of the pose must be 0 0 0 1", where=where, got=matrix[3].tolist()
        )
    if not np.isfinite(matrix[:3]).all():
        raise UserError(what="the pose holds values that are not finite", where=where)
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    if np.abs(scales - 1.0).max() > _ROTATION_TOLERANCE:
        raise UserError(
            what="the pose is no rigid transform",
            where=where,
            expected="a rotation, all scales 1",
            got="scales " + " ".join(f"{scale:.4g}" for scale in scales),
        )
    if np.linalg.det(left @ right) < 0.0:
        raise UserError(
            what="the pose has another handedness: its axes are a left-handed set",
            where=where,
            expected="a rotation, determinant 1",
            got="determinant -1",
            hint="one axis of the camera or of the world has the wrong sign",
        )
    return rigid(left @ right, matrix[:3, 3])


def triple(values: Iterable[float]) -> tuple[float, float, float]:
    """Three numbers as a tuple of Python floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
