"""Lines of sight through discs against loops, and images in a wall, which are no glints."""

import numpy as np

from geraf2.echoes.back_faces import find_crossings
from geraf2.echoes.glints import find_glints
from geraf2.scene import LosPrior
from helpers.specular import BOX_M, capture_of, raster, sphere_paths


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


def path_via_wall(positions, image, radius_m):
    """Point, ball at the origin, image of the point: shortest path over the ball, (n,) [m]."""
    one, two = (p / np.linalg.norm(p, axis=1, keepdims=True) for p in (positions, image))
    shares = np.linspace(0.0, 1.0, 201)[:, None, None]
    points = (1.0 - shares) * one + shares * two  # in the plane of both legs
    points *= radius_m / np.linalg.norm(points, axis=2, keepdims=True)
    leg = np.linalg.norm(points - positions, axis=2) + np.linalg.norm(points - image, axis=2)
    return leg.min(axis=0)


def test_images_in_a_wall_are_no_glints():
    # What goes over ball and wall seems to come from the wall, midway between ball and image; what
    # goes over the wall twice from the image, outside.
    wall_m, radius_m = -0.5 * BOX_M, 0.03

    def paths(positions, _):
        image = positions * [1.0, -1.0, 1.0] + [0.0, 2.0 * wall_m, 0.0]
        own, twice = (sphere_paths(p, [[0.0, 0.0, 0.0]], [radius_m]) for p in (positions, image))
        return np.column_stack([own, path_via_wall(positions, image, radius_m), twice])

    # On a raster of 3 mm the image's direction, a cosine of 0.45, wraps around to one inside.
    capture = capture_of(paths, n_poses=1, positions=raster(51, 0.002))
    found = find_glints(capture, LosPrior.from_box((BOX_M,) * 3))
    assert len(found) == 9  # one for each sub-aperture
    assert np.abs(np.linalg.norm(found.positions, axis=1) - radius_m).max() < 2e-3
