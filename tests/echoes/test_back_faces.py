"""Lines of sight through discs against loops; a dielectric ball, metal, a shell, wall images."""

import numpy as np

from geraf2.echoes.back_faces import seen_first, seen_through_share
from geraf2.echoes.glints import find_glints
from geraf2.scene import LosPrior
from helpers.glint_sets import glints_at, glints_on_sphere
from helpers.specular import BOX_M, capture_of, fibonacci_sphere, raster, sphere_paths

INDEX = 1.6
RADIUS_M = 0.02


def ball(radius_m=RADIUS_M, index=INDEX, n=600):
    """Front faces of a ball seen from all sides, then its back faces: 2 n radii behind these."""
    legs = fibonacci_sphere(n)
    positions = np.concatenate([radius_m * legs, (1.0 - 2.0 * index) * radius_m * legs])
    return glints_at(positions, np.concatenate([legs, legs]))


def test_metal_has_nothing_behind():
    # Two balls, one before the other from some planes: what these do not see has no glint there.
    far = np.array([0.06, 0.0, 0.0])
    glints = glints_on_sphere(0.025, 1500).join(glints_on_sphere(0.02, 1000, center=far, seed=1))
    offset = glints.positions - np.where(np.arange(2500)[:, None] < 1500, far, 0.0)
    along = -np.einsum("ij,ij->i", offset, glints.normals)
    beside = np.linalg.norm(offset + along[:, None] * glints.normals, axis=1)
    other_m = np.where(np.arange(2500) < 1500, 0.02, 0.025)
    seen = glints.select((along < 0.0) | (beside > other_m))
    assert len(seen) < 2450
    assert seen_through_share(seen) < 0.01
    assert seen_first(seen)[0].mean() > 0.98


def test_content_of_a_shell_is_not_a_back_face():
    shell, inside = glints_on_sphere(0.07, 6000), glints_on_sphere(0.02, 600, seed=1)
    assert seen_through_share(shell.join(inside)) < 0.01


def test_no_glints_are_no_back_faces():
    nothing = glints_on_sphere(0.02, 5).select(np.zeros(5, dtype=bool))
    assert seen_through_share(nothing) == 0.0


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
