"""Tangent points of outlines against a ball and an ellipsoid, whose outlines are known."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.fields import SdfGrid
from geraf2.freespace.tangents import tangent_points
from geraf2.scene import Grid
from geraf2.surfaces.fit import Evidence, FitConfig, fit_sdf
from helpers.glint_sets import glints_on_sphere
from helpers.shadows import CELL_M, outlines

RADIUS_M = 0.04
NOBODY = np.array([[1.0, 0.0, 0.0]])


def ball(radius_m, spacing_m=0.003):
    grid = Grid.cube((0.0, 0.0, 0.0), 0.075, int(0.15 / spacing_m) + 1)
    distance = np.linalg.norm(grid.points(), axis=1) - radius_m
    return SdfGrid(grid=grid, values=distance.reshape(grid.shape).astype(np.float32))


@pytest.mark.parametrize("found_m", [0.030, 0.037])
def test_a_ball_fitted_too_small_has_tangent_points_on_great_circles(found_m):
    circle = tangent_points(ball(found_m), outlines([0, 1], [RADIUS_M] * 3), NOBODY, 0.005)
    assert len(circle) > 2 * 0.9 * 2.0 * np.pi * RADIUS_M / CELL_M
    np.testing.assert_allclose(np.linalg.norm(circle.positions, axis=1), RADIUS_M, atol=1.5e-3)
    radial = circle.positions / np.linalg.norm(circle.positions, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", radial, circle.normals).min() > np.cos(0.2)
    np.testing.assert_allclose(np.linalg.norm(circle.normals, axis=1), 1.0)
    # Each in the plane across its lines of sight, through the middle; near the poles a line is as
    # far from the ball to within half a millimetre, the outline's finest cell, for a while.
    flat_m = np.sqrt(2.0 * RADIUS_M * 0.5e-3)
    assert np.minimum(*np.abs(circle.positions[:, :2]).T).max() < flat_m


def test_a_ball_fitted_too_large_has_no_tangent_points():
    assert len(tangent_points(ball(0.043), outlines([0, 1], [RADIUS_M] * 3), NOBODY, 0.005)) == 0


def test_tangent_points_near_glints_or_in_free_space_are_left_out():
    seen = np.array([[0.0, 0.0, RADIUS_M]])
    every = tangent_points(ball(0.037), outlines([0, 1], [RADIUS_M] * 3), NOBODY, 0.005)
    clear = tangent_points(ball(0.037), outlines([0, 1], [RADIUS_M] * 3), seen, 0.005)
    gone = np.linalg.norm(every.positions - seen, axis=1) < 0.005
    assert gone.any()
    np.testing.assert_array_equal(clear.positions, every.positions[~gone])
    # A field that falls along x: another outline shows where lines along x touch, or nothing does.
    grid = ball(0.037).grid
    off_m = np.hypot(*grid.points()[:, 1:].T) - 0.030 - 0.1 * grid.points()[:, 0]
    falling = SdfGrid(grid=grid, values=off_m.reshape(grid.shape))
    both = outlines([0, 1], [0.02, RADIUS_M, RADIUS_M])
    # There the field, 10 mm - 0.1 x at the edge, equals the distance to what the other stops.
    touch = tangent_points(falling, both, NOBODY, 0.005)
    assert touch.positions[:, 0].max() == pytest.approx(0.03 / 1.1, abs=0.003)
    alone = tangent_points(falling, both.select(np.array([0])), NOBODY, 0.005)
    assert len(alone) == 0


def test_an_outline_has_no_edge_at_the_border_of_known_cells():
    cells = CELL_M * np.arange(-40, 41)
    known = np.tile(cells < 0.02, (len(cells), 1))
    positions, _ = outlines([0], [RADIUS_M] * 3, known).edge(0)
    assert len(positions) > 20
    assert positions[:, 1].max() < 0.02
    nothing = replace(outlines([0], [RADIUS_M] * 3), transmission=np.ones((1, 81, 81)))
    assert nothing.edge(0)[0].shape == nothing.edge(0)[1].shape == (0, 2)
    found = tangent_points(ball(RADIUS_M), nothing, NOBODY, 0.005)
    assert found.positions.shape == found.normals.shape == (0, 3)


def test_a_larger_shadow_moves_the_fit_outwards():
    belt = glints_on_sphere(RADIUS_M, 1500)
    belt = belt.select(np.abs(belt.positions[:, 2]) < 0.5 * RADIUS_M)
    config = FitConfig(spacing_m=0.004)
    shadow = outlines([0, 1], [RADIUS_M, RADIUS_M, 1.3 * RADIUS_M])
    ends = np.array([[0.0, 0.0, 1.3 * RADIUS_M], [0.0, 0.0, -1.3 * RADIUS_M]])
    off_m = []
    for known in (None, shadow):
        evidence = Evidence(
            glints=belt, outlines=known, outline_weight=0.05, outline_clearance_m=0.005
        )
        sdf = fit_sdf(evidence, config)
        off_m.append(np.abs(sdf.sample(ends)).max())
    assert off_m[0] > 0.005
    assert off_m[1] < 0.002
