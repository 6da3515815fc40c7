"""What stands on the floor of its box: cylinders and cones whose lower ends are known."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.fields import SdfGrid
from geraf2.scene import Grid, LosPrior, Wall
from geraf2.surfaces.extraction import content_surface
from geraf2.surfaces.fit import Evidence, FitConfig, fit_standing
from geraf2.surfaces.support import floor_of, stand_on
from helpers.glint_sets import glints_at
from helpers.shadows import outlines
from helpers.synthetic import point_capture

WALL = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.004, permittivity=1.6)
BOX = LosPrior.from_box((0.2, 0.2, 0.2), walls=(WALL,))
FLOOR_M = -0.096
TURNED = point_capture(6)
RULES = {"reach_m": 0.02, "clearance_m": 0.005, "lean": (0.2, 0.4)}


def sides(low_m, *, radius_m=0.008, lean_rad=0.0, n=600):
    """Glints of a side from so far above the floor to 5 cm; a lean faces them down."""
    draw = np.random.default_rng(0)
    turn, height = draw.uniform(0.0, 2.0 * np.pi, n), draw.uniform(low_m, 0.05, n)
    radius = radius_m + (height - low_m) * np.tan(lean_rad)
    out = np.cos(lean_rad) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    normals = np.column_stack([out, np.full(n, -np.sin(lean_rad))])
    places = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return glints_at(np.column_stack([places, FLOOR_M + height]), normals)


def fitted(glints, support="auto", prior=BOX, capture=TURNED):
    config = FitConfig(distance_rounds=1, absence_weight=0.0, support=support)
    evidence = Evidence(glints=glints)
    fit = fit_standing(evidence, capture, prior, config, num_threads=1)
    return fit, content_surface(fit.sdf, glints, prior, num_threads=1)[0]


def lowest_m(mesh):
    return mesh.vertices[:, 2].min() - FLOOR_M


def cylinder(low_m, radius_m=0.02, hollow_m=0.0):
    """Field of a standing cylinder of 5 cm whose lower end is so far above the floor."""
    grid = Grid.cube((0.0, 0.0, FLOOR_M + 0.03), 0.045, 46)
    x, y, z = grid.points().T
    end = FLOOR_M + low_m + np.where(np.hypot(x, y) < 0.5 * radius_m, hollow_m, 0.0)
    off_m = np.maximum(np.hypot(x, y) - radius_m, np.maximum(end - z, z - FLOOR_M - 0.05))
    return SdfGrid(grid=grid, values=off_m.reshape(grid.shape).astype(np.float32))


def test_a_foot_that_is_seen_close_above_the_floor_goes_down_to_it():
    glints = sides(0.017)
    (plain, without), (fit, mesh) = fitted(glints, "no"), fitted(glints)
    assert lowest_m(without) > 0.005
    assert lowest_m(mesh) == pytest.approx(0.0, abs=1e-4)
    # A cylinder of the same radius: its whole bottom is on the floor, its sides go straight up.
    disk = 0.006 * np.stack([np.cos(np.arange(0.0, 6.0)), np.sin(np.arange(0.0, 6.0))], axis=1)
    for height, inside in ((-1e-3, False), (1e-3, True), (8e-3, True)):
        level = np.column_stack([disk, np.full(len(disk), FLOOR_M + height)])
        assert ((fit.sdf.sample(level) < 0.0) == inside).all()
    (height,), (area,) = fit.support.heights_m, fit.support.areas_m2
    assert 0.011 < height <= 0.017
    assert area == pytest.approx(np.pi * 0.008**2, rel=0.3)
    assert "1 foot" in fit.numbers()["support"]
    assert plain.numbers() == {}
    above = plain.sdf.grid.points()[:, 2] > FLOOR_M + 0.018
    np.testing.assert_array_equal(fit.sdf.values.ravel()[above], plain.sdf.values.ravel()[above])


@pytest.mark.parametrize("low_m", [0.0, 0.03])
def test_what_is_seen_to_float_stays_as_it_is(low_m):
    glints = sides(0.017)
    glints.positions[:, 2] += 0.0035 + low_m
    (_, without), (fit, mesh) = fitted(glints, "no"), fitted(glints)
    np.testing.assert_array_equal(mesh.vertices, without.vertices)
    np.testing.assert_array_equal(mesh.faces, without.faces)
    assert fit.numbers() == {}


def test_glints_that_face_down_overrule():
    leaning = sides(0.012, radius_m=0.012, lean_rad=0.5)
    (_, without), (fit, mesh) = fitted(leaning, "no"), fitted(leaning)
    np.testing.assert_array_equal(mesh.vertices, without.vertices)
    assert fit.support.heights_m == ()
    assert fit.support.overruled["the sides lean inwards"] == 1
    assert "stand nowhere" in fit.numbers()["support"]


def test_sides_that_should_have_been_seen_and_were_not_overrule():
    seen = sides(0.013, radius_m=0.02)
    one_side = seen.select(seen.positions[:, 0] > 0.016)
    for glints, n_feet in ((seen, 1), (one_side, 0)):
        field, support = stand_on(cylinder(0.01), FLOOR_M, glints, **RULES)
        assert len(support.heights_m) == n_feet
        assert (field.sample(np.array([[0.0, 0.0, FLOOR_M + 0.002]]))[0] < 0.0) == bool(n_feet)


@pytest.mark.parametrize("light", [True, False])
def test_an_outline_that_shows_light_below_overrules(light):
    # About a middle 4 cm below the origin: its lower end is 12 mm above the floor, or far below.
    shadow = outlines([0, 1], [0.04, 0.04, 0.044 if light else 0.08])
    shadow = replace(shadow, origins_m=shadow.origins_m - np.array([0.0, 0.04]))
    field = cylinder(0.012)
    _, support = stand_on(field, FLOOR_M, sides(0.013, radius_m=0.02), **RULES, outlines=shadow)
    assert len(support.heights_m) == (0 if light else 1)
    assert support.overruled == ({"outlines show light below": 1} if light else {})


def test_what_reaches_the_floor_by_itself_stays_as_it_is():
    field, glints = cylinder(-0.002, hollow_m=0.009), sides(0.012, radius_m=0.02)
    same, support = stand_on(field, FLOOR_M, glints, **RULES)
    above = field.grid.points()[:, 2] > FLOOR_M
    np.testing.assert_array_equal(same.values.ravel()[above] < 0, field.values.ravel()[above] < 0)
    assert (same.values.ravel()[~above] >= 0.0).all()
    assert support.numbers() == {}


def test_a_hole_that_nobody_sees_into_is_filled():
    field, glints = cylinder(0.008, hollow_m=0.02), sides(0.012, radius_m=0.02)
    filled, support = stand_on(field, FLOOR_M, glints, **RULES)
    assert filled.sample(np.array([[0.0, 0.0, FLOOR_M + 0.003]]))[0] < 0.0
    assert support.areas_m2 == pytest.approx((np.pi * 0.02**2,), rel=0.1)


def test_another_choice_is_refused():
    with pytest.raises(ValueError, match="support must be one of auto, no"):
        FitConfig(support="off")


def test_feet_are_feet_and_no_slab():
    feet = [sides(0.015).select(np.arange(600) % 4 == k) for k in range(4)]
    corners = 0.025 * np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
    glints = glints_at(
        np.concatenate([f.positions + c for f, c in zip(feet, corners, strict=True)]),
        np.concatenate([f.normals for f in feet]),
    )
    fit, mesh = fitted(glints)
    assert len(fit.support.heights_m) == 4
    low = mesh.vertices[mesh.vertices[:, 2] < FLOOR_M + 1e-3]
    off = np.linalg.norm(low[:, None, :2] - corners[None, :, :2], axis=2).min(axis=1)
    assert off.max() < 0.012


def test_the_floor_is_the_inner_face_of_the_innermost_bottom():
    assert floor_of(TURNED, BOX) == pytest.approx(FLOOR_M)
    inner = Wall(
        size_m=(0.1, 0.1, 0.1), thickness_m=0.003, permittivity=1.6, center_m=(0.0, 0.0, -0.02)
    )
    nested = replace(BOX, walls=(WALL, inner))
    assert floor_of(TURNED, nested) == pytest.approx(-0.067)
    field, _ = stand_on(cylinder(-0.01), FLOOR_M, sides(0.012, radius_m=0.02), **RULES)
    assert field.sample(np.array([[0.0, 0.0, FLOOR_M - 1e-3]]))[0] > 0.0


def test_the_floor_is_unknown_where_nothing_says_what_is_down():
    alike = replace(TURNED, poses=TURNED.poses[:1])
    on_its_side = [replace(p, axes=p.axes[:, [2, 0, 1]]) for p in TURNED.poses]
    bulging = BOX.vertices.copy()
    bulging[np.argmin(bulging.sum(axis=1)), 2] -= 0.01
    assert floor_of(alike, BOX) is None
    assert floor_of(replace(TURNED, poses=tuple(on_its_side)), BOX) is None
    assert floor_of(TURNED, replace(BOX, walls=())) is None
    assert floor_of(TURNED, replace(BOX, vertices=bulging)) is None
    fit, _ = fitted(sides(0.017), capture=alike)
    assert fit.support is None
