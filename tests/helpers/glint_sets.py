"""Glints where and as a test wants them."""

import numpy as np

from geraf2.echoes.glint_set import Glints


def glints_at(
    positions, normals, strengths=1.0, *, position_sigma_m=4e-4, normal_sigma_rad=0.03, poses=0
):
    """Glints at positions with unit normals, (n, 3) each; what is a number holds for all."""
    n = len(positions)
    return Glints(
        positions=np.array(positions, dtype=float),
        normals=np.array(normals, dtype=float),
        strengths=np.broadcast_to(np.asarray(strengths, dtype=float), n).copy(),
        position_sigma_m=np.full(n, position_sigma_m),
        normal_sigma_rad=np.full(n, normal_sigma_rad),
        probability=np.ones(n),
        poses=np.broadcast_to(np.asarray(poses, dtype=np.int64), n).copy(),
    )


def glints_on_sphere(radius_m, n, *, center=(0.0, 0.0, 0.0), seed=0, **options):
    """Glints scattered evenly over a sphere, for the rest as `glints_at`."""
    normals = np.random.default_rng(seed).standard_normal((n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return glints_at(np.asarray(center) + radius_m * normals, normals, **options)
