"""Agreement of oriented points, against plain loops."""

import numpy as np

from geraf2.echoes.agreement import agreeing_pairs, near_pairs, tangent_offset
from geraf2.echoes.glint_set import strong_level

LIMITS = {"radius_m": 0.008, "offset_m": 0.0025, "angle_rad": 0.5}


def cloud(n=150, seed=0):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3)) * 0.3 + [0.0, 0.0, 1.0]
    return rng.uniform(-0.01, 0.01, (n, 3)), normals / np.linalg.norm(normals, axis=1)[:, None]


def test_pairs_are_those_of_plain_loops():
    positions, normals = cloud()
    expected = set()
    for i, (p, n) in enumerate(zip(positions, normals, strict=True)):
        for j, (q, m) in enumerate(zip(positions, normals, strict=True)):
            near = i != j and np.sqrt(((p - q) ** 2).sum()) <= LIMITS["radius_m"]
            on_plane = abs(sum((q - p) * n)) < LIMITS["offset_m"]
            if near and on_plane and np.arccos(min(sum(n * m), 1.0)) < LIMITS["angle_rad"]:
                expected.add((i, j))
    found = agreeing_pairs(positions, normals, **LIMITS)
    assert set(zip(*map(list, found), strict=True)) == expected
    assert len(found[0]) == len(expected) > 100


def test_the_offset_of_a_sphere_is_of_second_and_of_third_order():
    """Along the normal of one end h^2 / 2 R, along the mean of both nothing."""
    radius, angle = 0.03, 0.1
    normals = np.array([[0.0, 0.0, 1.0], [np.sin(angle), 0.0, np.cos(angle)]])
    first, second = radius * normals[:1], radius * normals[1:]
    height = tangent_offset(first, second, normals[:1])[0]
    assert np.isclose(height, -radius * (1.0 - np.cos(angle)))
    assert abs(tangent_offset(first, second, normals.mean(axis=0)[None])[0]) < 1e-15


def test_near_pairs_stay_within_their_group():
    positions, _ = cloud(40)
    group = np.arange(40) % 3
    expected = {
        (i, j)
        for i in range(40)
        for j in range(i + 1, 40)
        if group[i] == group[j] and np.linalg.norm(positions[i] - positions[j]) <= 0.008
    }
    i, j = near_pairs(positions, 0.008, group)
    assert {(min(pair), max(pair)) for pair in zip(i, j, strict=True)} == expected


def test_two_of_a_hundred_are_stronger_than_a_strong_glint():
    strengths = np.arange(1.0, 102.0)
    assert (strengths > strong_level(strengths)).sum() == 2
