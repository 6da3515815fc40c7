from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carton import PRIOR, carton_capture, with_bias
from geraf2.calibration.calibration import with_alignment
from geraf2.calibration.wall_alignment import AlignmentConfig, align_to_walls, turntable_axis
from geraf2.calibration.wall_echoes import WALL_MIDDLE_M, WallMiddles, find_wall_peak
from geraf2.errors import UserError
from geraf2.scene import Wall

SHIFT_M = (0.004, -0.003, 0.0)


@pytest.fixture(scope="module")
def capture():
    return carton_capture()


@pytest.mark.parametrize("recorded", [0.0, 0.15, 0.4])
def test_the_delay_puts_the_walls_where_the_prior_has_them(capture, recorded):
    found = align_to_walls(with_bias(capture, recorded), PRIOR)
    assert found.delay_m == pytest.approx(0.15 - recorded, abs=5e-4)
    assert found.rms_after_m < 8e-4


def test_walls_echo_from_their_optical_middle(capture):
    board = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.005, permittivity=1.44)
    assert wall_middle_m((board,))[0] == pytest.approx(0.003)
    assert wall_middle_m(())[0] == WALL_MIDDLE_M
    found = align_to_walls(capture, replace(PRIOR, walls=(board,)))
    assert found.delay_m == pytest.approx(-0.006, abs=5e-4)
    unknown = align_to_walls(replace(capture, walls=()), replace(PRIOR, walls=()))
    assert unknown.delay_sigma_m > 2.5 * found.delay_sigma_m


def test_a_turned_and_moved_prior_is_moved_back(capture):
    turn = Rotation.from_rotvec(np.deg2rad(2.0) * np.array([0.5, 0.5, np.sqrt(0.5)]))
    moved = replace(PRIOR, vertices=turn.apply(PRIOR.vertices) + np.array(SHIFT_M))
    found = align_to_walls(capture, moved)
    back = found.moved_prior(moved)
    assert np.abs(back.vertices - PRIOR.vertices).max() < 0.001
    error = Rotation.from_matrix(found.prior_to_capture[:3, :3]) * turn
    assert np.rad2deg(error.magnitude()) < 0.3


def test_what_vertical_walls_do_not_show_keeps_its_uncertainty(capture):
    found = align_to_walls(capture, PRIOR, AlignmentConfig(translation_sigma_m=0.02))
    assert found.translation_sigma_m[2] == pytest.approx(0.02, rel=1e-3)
    assert (found.translation_sigma_m[:2] < 0.001).all()


def test_a_shifted_turntable_axis(capture):
    del capture
    radial, across = 0.002, 0.003
    wrong = carton_capture(errors=lambda _, axes, n: radial * axes[0] - across * axes[1])
    found = align_to_walls(wrong, PRIOR)
    # Nearer by 2 mm for all poses is a path shorter by 4 mm; only the rest is the axis's.
    assert found.delay_m == pytest.approx(-2.0 * radial, abs=1e-3)
    assert abs(found.axis_shift_m[1] - across) < 2.5 * found.axis_shift_sigma_m[1]
    held = align_to_walls(wrong, PRIOR, AlignmentConfig(keep_delay=True))
    assert held.delay_m == 0.0
    assert held.axis_shift_m[0] == pytest.approx(radial, abs=5e-4)
    corrected = with_alignment(wrong, held)
    true = wrong.poses[3].tx_positions + radial * wrong.poses[3].axes[0]
    assert np.abs((corrected.poses[3].tx_positions - true) @ wrong.poses[3].axes[0]).max() < 0.001


def test_the_axis_goes_through_what_the_poses_look_at(capture):
    point, up = turntable_axis(capture.poses)
    assert point == pytest.approx(np.zeros(3), abs=1e-9)
    assert up == pytest.approx([0.0, 0.0, 1.0])


def test_the_nearest_of_two_strong_walls_is_taken():
    rng = np.random.default_rng(0)
    near, far = 0.1 + 0.001 * rng.normal(size=60), 0.3 + 0.001 * rng.normal(size=90)
    peak = find_wall_peak(np.concatenate([near, far, rng.uniform(0, 0.5, 40)]), (0.0, 0.5))
    assert peak.offset_m == pytest.approx(0.1, abs=1e-3)
    assert 60 <= peak.n_echoes < 70


def test_without_walls_the_error_says_so(capture):
    del capture
    with pytest.raises(UserError, match="walls of the box do not stand out, expected at least 12"):
        align_to_walls(carton_capture(n_poses=3, wall=0.0), PRIOR)


@pytest.mark.parametrize(
    ("name", "value"), [("axis_sigma_m", -1.0), ("delay_search_m", (1.0, 0.0))]
)
def test_impossible_settings_name_themselves(name, value):
    with pytest.raises(ValueError, match=name):
        AlignmentConfig(**{name: value})
