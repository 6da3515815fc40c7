"""The instrument delay at which near and far walls lie on one box."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2 import examples, simulate
from geraf2.calibration.box_finder import find_box
from geraf2.calibration.cuboid_search import DelayUnknownError
from geraf2.io.manifest import DELAY_KEY, DELAY_NOT_KNOWN
from geraf2.scene import LosPrior

SIZE_M = (0.16, 0.20, 0.18)
BOX = LosPrior.from_box(SIZE_M)
TRUE_M = 0.15


def scan_of(*, far_walls):
    spec = examples.small_scene()
    wall = replace(spec.walls[0], size_m=SIZE_M, center_m=(0.0, 0.0, 0.0))
    return simulate(
        replace(
            spec,
            walls=(wall,),
            scan=replace(spec.scan, n_poses=8),
            disturbance=replace(spec.disturbance, far_walls=far_walls),
        ),
        seed=0,
    )[0]


@pytest.fixture(scope="module")
def scan():
    """All four sides are seen from the front and, through the box, from behind."""
    return scan_of(far_walls=True)


@pytest.fixture(scope="module")
def lined():
    """The walls' inner sides do not echo."""
    return scan_of(far_walls=False)


def recorded(capture, path_bias_m):
    return replace(capture, waveform=replace(capture.waveform, path_bias_m=path_bias_m))


def not_recorded(capture):
    provenance = {**capture.provenance, DELAY_KEY: DELAY_NOT_KNOWN}
    return replace(recorded(capture, 0.0), provenance=provenance, walls=())


def test_near_and_far_walls_confirm_a_right_delay(scan):
    box = find_box(scan)
    assert box.delay_change_m == 0.0
    assert box.delay.odds < -10.0
    assert box.numbers()["delay_odds"] == round(box.delay.odds, 2)
    assert abs(box.numbers()["other_delay_m"] - TRUE_M) > 0.04


@pytest.mark.parametrize("error_m", [0.1, -0.1])
def test_a_wrong_delay_is_corrected_by_near_and_far_walls(scan, error_m):
    box = find_box(recorded(scan, TRUE_M + error_m))
    assert box.delay.odds > 10.0
    assert box.delay_change_m == pytest.approx(-error_m, abs=0.01)
    np.testing.assert_allclose(box.size_m[:2], SIZE_M[:2], atol=3e-3)


def test_a_delay_that_was_not_recorded_is_found_with_the_box(scan):
    box = find_box(not_recorded(scan))
    assert box.delay_change_m == pytest.approx(TRUE_M, abs=0.01)
    np.testing.assert_allclose(box.size_m[:2], SIZE_M[:2], atol=3e-3)


def test_near_walls_alone_fit_any_delay(lined):
    assert abs(find_box(lined).delay.odds) < 2.0
    with pytest.raises(DelayUnknownError, match=r"was not recorded, .* path_bias_m .* box X Y Z"):
        find_box(not_recorded(lined))


def test_near_walls_of_a_given_box_fit_one_delay(lined):
    box = find_box(not_recorded(lined), expected=BOX)
    assert box.delay_change_m == pytest.approx(TRUE_M, abs=0.01)
    np.testing.assert_allclose(box.size_m[:2], SIZE_M[:2], atol=5e-3)


def test_near_walls_alone_do_not_decide_between_a_given_box_and_a_recorded_delay(lined):
    wrong = recorded(lined, TRUE_M + 0.1)
    with pytest.raises(DelayUnknownError, match="delay and the box contradict each other"):
        find_box(wrong, expected=BOX)
    assert find_box(wrong, expected=BOX, keep_delay=True).delay_change_m == 0.0


def test_far_walls_contradict_a_wrong_box_and_not_the_delay(scan):
    larger = LosPrior.from_box(tuple(side + 0.1 for side in SIZE_M))
    for capture, change_m in ((scan, 0.0), (not_recorded(scan), TRUE_M)):
        box = find_box(capture, expected=larger)
        assert box.delay_change_m == pytest.approx(change_m, abs=0.01)
        np.testing.assert_allclose(box.size_m[:2], SIZE_M[:2], atol=3e-3)
