from dataclasses import replace

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.scene import Grid
from geraf2.scene.aperture import Aperture
from geraf2.surfaces.fit import FitConfig, fit_sdf, zero_level
from geraf2.surfaces.isosurface import extract_surface, surface_report
from helpers.glint_sets import glints_at
from helpers.specular import fibonacci_sphere

RADIUS_M = 0.04
CENTER = np.array([0.01, -0.005, 0.02])
COARSE = FitConfig(spacing_m=0.006)


def glints_on(directions, strengths=1.0):
    return glints_at(CENTER + RADIUS_M * directions, directions, strengths)


def errors_near(sdf, directions, reach_m=0.004):
    """Signed-distance error at points within reach of the sphere, along the directions."""
    offset = np.random.default_rng(0).uniform(-reach_m, reach_m, len(directions))
    points = CENTER + (RADIUS_M + offset)[:, None] * directions
    return sdf.sample(points) - offset


def test_a_fully_seen_sphere_gives_its_surface():
    sdf = fit_sdf(glints_on(fibonacci_sphere(1500)), COARSE)
    error = errors_near(sdf, fibonacci_sphere(997))
    assert np.abs(error).max() < 8e-4
    assert sdf.sample(CENTER[None])[0] < -0.02


def test_glints_weigh_by_their_probability():
    """Points off the surface that are hardly likely to be returns of the content change nothing."""
    true, n_false = glints_on(fibonacci_sphere(1500)), 40
    false = replace(
        true.select(np.arange(n_false)),
        positions=true.positions[:n_false] + 0.004 * true.normals[:n_false],
    )
    sdf = {
        p: fit_sdf(true.join(replace(false, probability=np.full(n_false, p))), COARSE)
        for p in (1e-9, 1.0)
    }
    without, at = fit_sdf(true, COARSE), true.positions[:n_false]
    assert np.abs(sdf[1e-9].sample(at) - without.sample(at)).max() < 1e-4
    assert np.abs(sdf[1.0].sample(at) - without.sample(at)).max() > 5e-4


def seen_from_the_side():
    directions = fibonacci_sphere(1500)
    return directions[np.abs(directions[:, 2]) < 0.5]


def test_unseen_top_and_bottom_are_closed():
    sdf = fit_sdf(glints_on(seen_from_the_side()), COARSE)
    surface = extract_surface(sdf)
    assert surface_report(surface).is_watertight
    assert surface_report(surface).n_components == 1
    error = errors_near(sdf, seen_from_the_side())
    assert np.abs(error).max() < 1e-3
    reach = np.abs(surface.vertices - CENTER).max(axis=0)
    np.testing.assert_allclose(reach[:2], RADIUS_M, atol=1e-3)
    # A cap lies between the flat one through its rim and the sphere that it completes.
    assert 0.5 * RADIUS_M + 5e-3 < reach[2] < RADIUS_M + 5e-3


def test_two_runs_are_bit_identical():
    glints = glints_on(seen_from_the_side())
    first, second = (fit_sdf(glints, COARSE, num_threads=n) for n in (1, 2))
    np.testing.assert_array_equal(first.values, second.values)


def test_the_grid_stays_below_its_cap():
    config = FitConfig(spacing_m=0.002, max_voxels=8000)
    sdf = fit_sdf(glints_on(fibonacci_sphere(300)), config)
    # the cap counts cells; one more voxel than cells a side
    assert sdf.grid.n_voxels <= 21**3
    assert sdf.grid.n_voxels > 5000
    low = np.asarray(sdf.grid.origin_m)
    high = low + sdf.grid.spacing_m * (np.asarray(sdf.grid.shape) - 1)
    assert (low < CENTER - RADIUS_M - 0.9 * config.margin_m).all()
    assert (high > CENTER + RADIUS_M + 0.9 * config.margin_m).all()


def test_a_field_without_a_zero_level_is_a_user_error():
    grid = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=0.01, shape=(4, 4, 4))
    values = np.full((4, 4, 4), 0.02, dtype=np.float32)
    with pytest.raises(UserError, match="do not enclose anything") as caught:
        zero_level(SdfGrid(grid=grid, values=values))
    assert "values from 0.0200 to 0.0200 m" in str(caught.value)


def test_a_completion_that_loses_the_glints_is_not_made(monkeypatch):
    glints, plane = (
        glints_on(fibonacci_sphere(300)),
        Aperture.from_rectangle(np.array([0.4, 0.0, 0.0]), np.eye(3), np.array([0.1, 0.1])),
    )
    smooth = fit_sdf(glints, COARSE)
    for change_m, remains in ((0.05, smooth.values), (0.002, smooth.values + np.float32(0.002))):

        def moved(sdf, *_, by=change_m):
            return replace(sdf, values=sdf.values + np.float32(by))

        monkeypatch.setattr("geraf2.surfaces.fit.complete", moved)
        completed = fit_sdf(glints, COARSE, apertures=[plane])
        np.testing.assert_array_equal(completed.values, remains)
