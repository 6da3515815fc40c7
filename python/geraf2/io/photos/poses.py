"""Camera poses of foreign conventions, brought to one and checked."""

import numpy as np
from numpy.typing import NDArray

from geraf2.errors import UserError

# Poses come with as few as four digits; a scale or a mirror image is far beyond.
_ROTATION_TOLERANCE = 1e-2

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns camera axes x right, y up, z backward into x right, y down, z forward, and back."""


def camera_to_world_of(
    rotation: NDArray[np.float64], translation: NDArray[np.float64], where: object
) -> NDArray[np.float64]:
    """Inverse of the world-to-camera transform x_camera = R x_world + t, (4, 4)."""
    rotation = require_rotation(rotation, where)
    transform = np.eye(4)
    transform[:3, :3] = rotation.T
    transform[:3, 3] = -rotation.T @ translation
    return transform


def require_rotation(matrix: NDArray[np.float64], where: object) -> NDArray[np.float64]:
    """Nearest rotation of a 3 x 3 matrix; UserError if it is none, or mirrors."""
    if not np.isfinite(matrix).all():
        raise UserError(what="the pose holds values that are not finite", where=where)
    left, scales, right = np.linalg.svd(matrix)
    if np.abs(scales - 1.0).max() > _ROTATION_TOLERANCE:
        raise UserError(
            what="the pose is no rigid transform",
            where=where,
            expected="a rotation, all scales 1",
            got="scales " + " ".join(f"{scale:.4g}" for scale in scales),
        )
    rotation = left @ right
    if np.linalg.det(rotation) < 0.0:
        raise UserError(
            what="the pose mirrors: its axes are left-handed",
            where=where,
            expected="a rotation with determinant 1",
            got="determinant -1",
            hint="one axis of the camera or of the world has the wrong sign",
        )
    return np.asarray(rotation)


def require_rigid(matrix: NDArray[np.float64], where: object) -> NDArray[np.float64]:
    """4 x 4 rigid transform with an exact rotation; UserError if it is none."""
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise UserError(
            what="the pose must be a finite 4 x 4 matrix", where=where, got=f"shape {matrix.shape}"
        )
    if matrix.shape == (4, 4) and np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise UserError(
            what="the last row of the pose must be 0 0 0 1", where=where, got=matrix[3].tolist()
        )
    transform = np.eye(4)
    transform[:3, :3] = require_rotation(matrix[:3, :3], where)
    transform[:3, 3] = matrix[:3, 3]
    return transform
