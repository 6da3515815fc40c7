"""Lines of sight through discs against loops."""

import numpy as np

from geraf2.apps.inspection.crossings import find_crossings


def test_crossings_of_discs_are_those_of_loops():
    rng = np.random.default_rng(0)
    positions = rng.uniform(-0.03, 0.03, (300, 3))
    normals = rng.standard_normal((300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = find_crossings(positions, normals)
    expected = {}
    for i in range(300):
        for j in range(300):
            slope = normals[i] @ normals[j]
            if i == j or abs(slope) <= 0.3:
                continue
            depth = (positions[j] - positions[i]) @ normals[j] / slope
            off = positions[i] + depth * normals[i] - positions[j]
            if depth > 0.004 and np.linalg.norm(off) < 0.005:
                expected[i, j] = depth, slope > 0.0
    rows = zip(found.lines, found.surfaces, found.depth_m, found.is_front, strict=True)
    got = {(i, j): (depth, front) for i, j, depth, front in rows}
    assert len(expected) > 100
    assert set(got) == set(expected)
    for pair, (depth, front) in expected.items():
        assert abs(got[pair][0] - depth) < 1e-6
        assert got[pair][1] == front
