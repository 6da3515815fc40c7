"""Densities that points of a surface predict for each other, for every pair; slow."""

import numpy as np


def matrix(points, others, model):
    """Densities (n_points, 2 n_others): by others of other planes, then by those of the own one."""
    (p, n, plane, subaperture), (q, m, other_plane, other) = (
        tuple(map(np.asarray, each)) for each in (points, others)
    )
    step = p[:, None] - q[None]
    distance = np.linalg.norm(step, axis=2)
    cosine = n @ m.T
    mean = n[:, None] + m[None]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = mean / np.linalg.norm(mean, axis=2)[..., None]
    offset = np.abs(np.sum(step * mean, axis=2))
    along2 = np.maximum(distance**2 - offset**2, 0.0)
    turn2 = np.maximum(2.0 - 2.0 * cosine, 0.0)
    s_offset = np.sqrt(model["offset_variance"] + (model["bend"] * distance**3) ** 2)
    s_turn = np.sqrt(model["turn_variance"] + (model["curvature"] * distance) ** 2)
    spread = model["spread"]
    gauss = np.exp(-0.5 * (offset / s_offset) ** 2) / (np.sqrt(2.0 * np.pi) * s_offset)
    gauss = gauss * np.exp(-0.5 * turn2 / s_turn**2) / (2.0 * np.pi * s_turn**2)
    gauss = gauss * np.exp(-0.5 * along2 / spread**2) / (2.0 * np.pi * spread**2)
    near = (distance <= model["reach"]) & (cosine > model["least_cosine"])
    near &= subaperture[:, None] != other[None]
    density = np.where(near & (gauss > model["least_density"]), gauss, 0.0)
    same = plane[:, None] == other_plane[None]
    return np.concatenate([np.where(same, 0.0, density), np.where(same, density, 0.0)], axis=1)
