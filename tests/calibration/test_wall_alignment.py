from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.calibration.corrections import with_axis
from geraf2.calibration.wall_alignment import (
    AlignmentConfig,
    WallProblem,
    turntable_axis,
)
from geraf2.calibration.wall_echoes import WALL_MIDDLE_M, WallMiddles, find_wall_peak
from geraf2.errors import UserError
from geraf2.scene import Wall
from helpers.carton import PRIOR, aligned, bulged, carton_capture, with_bias

SHIFT_M = (0.004, -0.003, 0.0)


@pytest.fixture(scope="module")
def capture():
    return carton_capture()


@pytest.mark.parametrize("recorded", [0.0, 0.15, 0.4])
def test_the_delay_puts_the_walls_where_the_prior_has_them(capture, recorded):
    wide = AlignmentConfig(delay_search_m=(-0.3, 1.0))
    found = aligned(with_bias(capture, recorded), PRIOR, wide)
    assert found.delay_m == pytest.approx(0.15 - recorded, abs=1e-3)
    assert abs(found.delay_m - 0.15 + recorded) < 2.0 * found.delay_sigma_m
    assert found.rms_after_m < 8e-4


def test_walls_echo_from_their_optical_middle(capture):
    board = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.005, permittivity=1.44)
    middles = WallMiddles.of((board,))
    assert middles.near_m == pytest.approx(0.003)
    assert middles.far_m == pytest.approx(1.5 * 0.006 - 0.010)  # 3 n t / 2 - 2 t
    assert WallMiddles.of(()).near_m == WALL_MIDDLE_M
    found = aligned(capture, replace(PRIOR, walls=(board,)))
    # Half of the two middles' sum, for the capture's walls have none.
    assert found.delay_m == pytest.approx(-(middles.near_m + middles.far_m), abs=8e-4)
    unknown = aligned(replace(capture, walls=()), replace(PRIOR, walls=()))
    assert unknown.delay_sigma_m > 1.2 * found.delay_sigma_m


def test_a_turned_and_moved_prior_is_moved_back(capture):
    turn = Rotation.from_rotvec(np.deg2rad(2.0) * np.array([0.5, 0.5, np.sqrt(0.5)]))
    moved = replace(PRIOR, vertices=turn.apply(PRIOR.vertices) + np.array(SHIFT_M))
    found = aligned(capture, moved)
    back = moved.moved(found.prior_to_capture)
    assert np.abs(back.vertices - PRIOR.vertices).max() < 0.001
    error = Rotation.from_matrix(found.prior_to_capture[:3, :3]) * turn
    assert np.rad2deg(error.magnitude()) < 0.5


def test_what_vertical_walls_do_not_show_keeps_its_uncertainty(capture):
    found = aligned(capture, PRIOR, AlignmentConfig(translation_sigma_m=0.02))
    assert found.translation_sigma_m[2] == pytest.approx(0.02, rel=1e-3)
    assert (found.translation_sigma_m[:2] < 0.002).all()


def test_a_shifted_turntable_axis(capture):
    del capture
    radial, across = 0.002, 0.003
    wrong = carton_capture(errors=lambda _, axes, n: radial * axes[0] - across * axes[1])
    found = aligned(wrong, PRIOR)
    # Nearer by 2 mm for all poses is a path shorter by 4 mm; only the rest is the axis's.
    assert found.delay_m == pytest.approx(-2.0 * radial, abs=1e-3)
    assert abs(found.axis_shift_m[1] - across) < 2.5 * found.axis_shift_sigma_m[1]
    held = aligned(wrong, PRIOR, AlignmentConfig(keep_delay=True))
    assert held.delay_m == 0.0
    assert held.axis_shift_m[0] == pytest.approx(radial, abs=5e-4)
    corrected = with_axis(wrong, held.axis_shift_m, held.angles_rad)
    true = wrong.poses[3].tx_positions + radial * wrong.poses[3].axes[0]
    assert np.abs((corrected.poses[3].tx_positions - true) @ wrong.poses[3].axes[0]).max() < 0.001


def test_the_axis_goes_through_what_the_poses_look_at(capture):
    point, up = turntable_axis(capture.poses)
    assert point == pytest.approx(np.zeros(3), abs=1e-9)
    assert up == pytest.approx([0.0, 0.0, 1.0])


def test_a_far_wall_alone_is_never_taken_for_a_near_one():
    rng = np.random.default_rng(0)

    def around(offset_m, n, magnitude):
        return offset_m + 0.001 * rng.normal(size=n), np.full(n, magnitude)

    def joined(*kinds):
        return tuple(np.concatenate(parts) for parts in zip(*kinds, strict=True))

    # Four times as many echoes, six times as strong, a box behind the near wall.
    clutter = rng.uniform(-0.3, 0.6, 40), np.full(40, 0.5)
    near = joined(around(0.1, 60, 1.0), around(0.3, 240, 6.0), clutter)
    far = joined(around(0.1, 240, 6.0), around(-0.1, 60, 1.0), clutter)
    peak = find_wall_peak(near, far, (-0.3, 0.5))
    assert peak.offset_m == pytest.approx(0.1, abs=1e-3)
    assert 60 <= peak.n_near < 70
    assert 240 <= peak.n_far < 250


def test_strong_echoes_weigh_more_than_weak_ones():
    offsets = np.repeat([0.010, -0.010], [60, 30])
    magnitudes = np.concatenate([0.04 * np.ones(60), np.ones(30)])
    peak = find_wall_peak((offsets, magnitudes), (offsets, magnitudes), (-0.015, 0.015))
    assert peak.offset_m == pytest.approx(-0.010, abs=1e-3)


@pytest.mark.parametrize("height_m", [0.003, -0.003])
def test_bulges_part_from_the_delay(height_m):
    found = aligned(carton_capture(bulge=bulged(height_m)), PRIOR)
    assert abs(found.delay_m) < 2.0 * found.delay_sigma_m
    assert found.delay_m == pytest.approx(0.0, abs=1e-3)
    assert found.bulge_m == pytest.approx(height_m, abs=1e-3)
    assert np.rad2deg(np.abs(found.rotation_rad).max()) < 0.2


def test_derivatives_are_those_of_the_misfit(capture):
    problem = WallProblem.of(capture, PRIOR, AlignmentConfig())
    rng = np.random.default_rng(0)
    start = np.zeros(len(problem.sigmas))
    walls = problem.walls_of(start, (0.2, 0.01))
    before, design = problem.linearised(start, walls)
    for step in 1e-5 * rng.normal(size=(3, len(start))):
        after, _ = problem.linearised(step, walls)
        # Second order: (1e-5)^2, up to three sigmas of each, times half a metre.
        assert after - before == pytest.approx(design @ step, abs=1e-8)


def test_without_walls_the_error_says_so(capture):
    del capture
    with pytest.raises(UserError, match="walls of the box do not stand out, expected at least 12"):
        aligned(carton_capture(n_poses=3, wall=0.0), PRIOR)


@pytest.mark.parametrize(
    ("name", "value"), [("axis_sigma_m", -1.0), ("delay_search_m", (1.0, 0.0))]
)
def test_impossible_settings_name_themselves(name, value):
    with pytest.raises(ValueError, match=name):
        AlignmentConfig(**{name: value})


def test_echoes_that_a_rim_cuts_are_left_out():
    """Planes turned by 15 degrees see walls past their rims, 3.5 mm too far off."""
    capture = carton_capture(n_poses=24)
    some = tuple(capture.poses[number] for number in (0, 1, 6, 7, 12, 13, 18, 19, 23))
    problem = WallProblem.of(replace(capture, poses=some), PRIOR, AlignmentConfig())
    values = np.zeros(len(problem.sigmas))
    walls = problem.walls_of(values, (0.2, 0.02))
    off, _ = problem.linearised(values, walls)
    assert len(off) > 60
    assert np.mean(np.abs(off) > 0.002) < 0.1  # 0.27 of all that lie as near to a wall
