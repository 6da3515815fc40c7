import numpy as np

from geraf2.apps.photos.grid_smoothing import close_body
from geraf2.apps.photos.visual_hull import Region, VisualHull, find_region
from helpers import photo_sphere

CUBE = Region(low_m=(-1.0, -1.0, -1.0), high_m=(1.0, 1.0, 1.0))


def ball(region, n, radius):
    grid = region.grid(n)
    offset = grid.points() - np.asarray(region.center_m)
    return grid, (np.linalg.norm(offset, axis=1) - radius).reshape(grid.shape).astype(np.float32)


def test_the_hull_of_a_ball_is_the_ball_and_its_region_holds_it():
    photos = photo_sphere.photo_set(12)
    hull = VisualHull(photos)
    unit = np.random.default_rng(0).normal(size=(400, 3))
    unit[:, 2] *= 0.2  # the cameras stand in a ring: the poles bulge
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    for distance in (-0.02, 0.0, 0.02):
        found = hull.distance(photo_sphere.CENTER + (photo_sphere.RADIUS_M + distance) * unit)
        # a pixel is 6 mm wide there
        assert np.median(np.abs(found - distance)) < 3e-3
    region = find_region(photos, hull)
    assert (np.asarray(region.low_m) < photo_sphere.CENTER - photo_sphere.RADIUS_M).all()
    assert (np.asarray(region.high_m) > photo_sphere.CENTER + photo_sphere.RADIUS_M).all()
    assert max(region.sides_m) < 4 * photo_sphere.RADIUS_M


def test_a_body_is_closed_at_the_rim_without_crumbs_and_hollows():
    grid, values = ball(CUBE, 33, 1.2)  # reaches beyond the grid
    points = grid.points()
    hollow = np.linalg.norm(points, axis=1).reshape(grid.shape) < 0.2
    values = np.where(hollow, 0.1, values)
    corner = (points > 0.85).all(axis=1).reshape(grid.shape)
    values[corner] = -0.1
    closed = close_body(values.astype(np.float32), grid.spacing_m)
    assert (closed[0] > 0).all()
    assert (closed[:, :, -1] > 0).all()
    assert (closed[hollow] < 0).all()
    assert (closed[corner] > 0).all()
