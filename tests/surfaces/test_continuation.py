"""Surfaces continued over caps that no antenna sees: round ones are, all others are left alone."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from geraf2.echoes.glint_set import Glints
from geraf2.echoes.patches import fit_patches
from geraf2.freespace.absence import Apertures, mirror_points
from geraf2.surfaces.continuation import continue_surface
from glint_sets import glints_at
from specular import antennas, fibonacci_sphere, raster

MARGIN_M = 0.035
RADIUS_M = 0.04
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def apertures():
    """12 planes of 25 cm around a turntable."""
    axes, low, high = [], [], []
    for number in range(12):
        places, _, frame = antennas(30.0 * number, raster(2, 0.25))
        local = places @ frame.T
        axes.append(frame)
        low.append(local.min(axis=0))
        high.append(local.max(axis=0))
    return Apertures(axes=np.stack(axes), low=np.stack(low), high=np.stack(high))


def seen(positions, normals, apertures, noise=1.0):
    """Glints of those points of a surface that face an antenna, with the noise of strong ones."""
    hit, places, _ = mirror_points(positions, normals, apertures, MARGIN_M)
    hit, first = np.unique(hit, return_index=True)
    looks = places[first] - positions[hit]
    pose = np.argmin(np.einsum("pj,nj->np", apertures.axes[:, 0], looks), axis=1)
    rng = np.random.default_rng(0)
    turned = normals[hit] + noise * 0.03 / np.sqrt(2.0) * rng.standard_normal((len(hit), 3))
    return glints_at(
        positions[hit] + noise * 3e-4 * rng.standard_normal((len(hit), 3)),
        turned / np.linalg.norm(turned, axis=1, keepdims=True),
        poses=pose,
    )


def ball(radius_m=RADIUS_M, n=6000):
    directions = fibonacci_sphere(n)
    return radius_m * directions, directions


def turned_profile(heights, radii, n_around=150):
    """Surface of revolution, (n, 3) points and normals."""
    angle = np.linspace(0.0, 2.0 * np.pi, n_around, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros(n_around)], axis=1)
    slope = np.gradient(radii, heights)
    points = radii[:, None, None] * around + heights[:, None, None] * UP
    normals = around - slope[:, None, None] * UP
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return points.reshape(-1, 3), normals.reshape(-1, 3)


def test_a_ball_of_which_a_belt_was_seen_is_continued_to_its_poles(apertures):
    glints = seen(*ball(), apertures)
    assert np.abs(glints.positions[:, 2]).max() < 0.45 * RADIUS_M
    found = continue_surface(glints, apertures, MARGIN_M)
    radius = np.linalg.norm(found.positions, axis=1)
    assert np.abs(radius - RADIUS_M).max() < 2.5e-3
    assert abs(np.median(radius) - RADIUS_M) < 5e-4
    height = found.positions[:, 2]
    assert height.max() > 0.99 * RADIUS_M
    assert height.min() < -0.99 * RADIUS_M
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-12)
    cosine = np.einsum("ij,ij->i", found.normals, found.positions) / radius
    assert cosine.min() > np.cos(0.1)


def test_a_pear_is_continued_below_and_left_alone_where_something_stands_on_it(apertures):
    points, normals = ball()
    knob = np.array([0.0, 0.0, 1.05 * RADIUS_M])
    on_top, knob_normals = ball(0.012, 1500)
    glints = seen(
        np.concatenate([points, on_top + knob]), np.concatenate([normals, knob_normals]), apertures
    )
    found = continue_surface(glints, apertures, MARGIN_M)
    assert found.positions[:, 2].min() < -0.99 * RADIUS_M
    assert found.positions[:, 2].max() < 0.012


def ellipsoid(semi_axes_m, n=12000):
    directions = fibonacci_sphere(n)
    normals = directions / semi_axes_m
    return directions * semi_axes_m, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_a_body_that_is_round_across_is_continued(apertures):
    semi_axes_m = np.array([0.05, 0.03, 0.03])
    found = continue_surface(seen(*ellipsoid(semi_axes_m), apertures), apertures, MARGIN_M)
    assert len(found) > 200
    surface = KDTree(ellipsoid(semi_axes_m, 200_000)[0])
    distance = surface.query(found.positions)[0]
    assert np.median(distance) < 5e-4
    assert distance.max() < 2.5e-3


@pytest.mark.parametrize("semi_axes_m", [(0.04, 0.04, 0.03), (0.04, 0.04, 0.05)])
def test_curvature_that_changes_beyond_the_limit_is_not_guessed(semi_axes_m, apertures):
    glints = seen(*ellipsoid(np.array(semi_axes_m)), apertures)
    assert len(glints) > 500
    assert len(continue_surface(glints, apertures, MARGIN_M)) == 0


HEIGHTS = np.linspace(-0.03, 0.03, 61)


@pytest.mark.parametrize(
    "radii",
    [
        np.full(61, 0.04),  # a drum
        0.04 + 0.15 * HEIGHTS,  # a cone
        0.04 - 0.005 * (np.abs(HEIGHTS) > 0.02),  # a step
        0.04 + 4.0 * HEIGHTS**2,  # a waist
        np.minimum(0.04, 0.037 + np.sqrt(np.maximum(0.003**2 - (np.abs(HEIGHTS) - 0.027) ** 2, 0))),
    ],
    ids=["drum", "cone", "step", "waist", "rounded edge"],
)
def test_what_does_not_round_off_is_left_alone(radii, apertures):
    glints = seen(*turned_profile(HEIGHTS, radii), apertures)
    assert len(glints) > 500
    assert len(continue_surface(glints, apertures, MARGIN_M)) == 0


def test_a_belt_that_ends_before_the_limit_of_what_can_be_seen_is_left_alone(apertures):
    points, normals = ball(2.0 * RADIUS_M, 12000)
    cut = np.abs(points[:, 2]) < 0.2 * RADIUS_M  # lids at +-8 mm
    glints = seen(points[cut], normals[cut], apertures)
    assert len(continue_surface(glints, apertures, MARGIN_M)) == 0
    whole = seen(points, normals, apertures)
    assert len(continue_surface(whole, apertures, MARGIN_M)) > 100


def test_one_side_alone_meets_nothing(apertures):
    points, normals = ball()
    front = normals[:, 0] > 0.9
    glints = seen(points[front], normals[front], apertures)
    assert len(glints) > 100
    assert len(continue_surface(glints, apertures, MARGIN_M)) == 0


def test_noise_five_times_as_large_is_no_curvature(apertures):
    glints = seen(*ball(), apertures, noise=5.0)
    assert len(continue_surface(glints, apertures, MARGIN_M)) == 0


@pytest.mark.parametrize("n", [0, 1, 3, 40])
def test_few_glints(n, apertures):
    glints = seen(*ball(), apertures).select(np.arange(n))
    assert len(continue_surface(glints, apertures, MARGIN_M)) == 0


def torus(n=20000, ring_m=0.04, tube_m=0.02):
    rng = np.random.default_rng(1)
    u, v = rng.uniform(0.0, 2.0 * np.pi, (2, n))
    around = np.stack([np.cos(u), np.sin(u), np.zeros(n)], axis=1)
    normals = np.cos(v)[:, None] * around + np.sin(v)[:, None] * UP
    return ring_m * around + tube_m * normals, normals


def test_curvatures_of_a_torus():
    positions, normals = torus()
    rng = np.random.default_rng(2)
    glints = glints_at(positions + 3e-4 * rng.standard_normal(positions.shape), normals)
    outer = np.nonzero((normals[:, 2] ** 2 < 0.01) & (np.hypot(*positions[:, :2].T) > 0.055))[0]
    index = outer[:60]
    up = UP - normals[index, 2:] * normals[index]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    for along, expected in ((up, 50.0), (np.cross(normals[index], up), 1.0 / 0.06)):
        patches, whose = fit_patches(glints, index, along)
        assert len(whose) == len(index)
        np.testing.assert_allclose(np.median(patches.curvatures_per_m), expected, rtol=0.05)
        offset = np.linalg.norm(patches.points - positions[index[whose]], axis=1)
        assert np.median(offset) < 5e-4


def test_patches_do_not_depend_on_outliers_or_order():
    positions, normals = torus()
    rng = np.random.default_rng(3)
    wrong = rng.permutation(len(positions))[:2000]
    index = np.setdiff1d(np.nonzero(np.abs(normals[:, 2]) < 0.1)[0], wrong)[:40]
    along = np.cross(normals[index], np.cross(UP, normals[index]))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    clean, _ = fit_patches(glints_at(positions, normals), index, along)
    strewn = positions.copy()
    strewn[wrong] += 0.006 * normals[wrong]
    dirty, whose = fit_patches(glints_at(strewn, normals), index, along)
    np.testing.assert_allclose(
        dirty.curvatures_per_m, clean.curvatures_per_m[whose], rtol=0.1, atol=1.0
    )
    order = rng.permutation(len(positions))
    place = np.argsort(order)
    again, _ = fit_patches(glints_at(positions[order], normals[order]), place[index], along)
    np.testing.assert_allclose(again.curvatures_per_m, clean.curvatures_per_m, rtol=1e-6)


def test_two_runs_are_bit_identical(apertures):
    glints = seen(*ball(), apertures)
    first, second = (continue_surface(glints, apertures, MARGIN_M) for _ in range(2))
    np.testing.assert_array_equal(first.positions, second.positions)
    assert isinstance(glints, Glints)
