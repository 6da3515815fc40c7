from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes.prior_check import locate_echoes, require_echoes_inside
from geraf2.echoes.wall_delay import pair_distance_m
from geraf2.errors import UserError
from geraf2.imaging.peaks import KeptPeaks, join_peaks
from geraf2.scene import Capture, LosPrior
from helpers.synthetic import WAVEFORM, point_capture, point_pose

# One target straight ahead of every plane, one at the side.
TARGETS = np.array([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, -0.05, 0.0]])


@pytest.fixture(scope="module")
def capture():
    return point_capture(4, n_side=40, spacing_m=0.003, targets=TARGETS)


def found_in(capture, prior):
    return locate_echoes(capture, prior, KeptPeaks(prior).of(capture))


def require(capture, prior, where):
    return require_echoes_inside(capture, prior, KeptPeaks(prior).of(capture), where)


def box(side_m, center_m=(0.0, 0.0, 0.0)):
    return LosPrior.from_box((side_m,) * 3, center_m)


def test_all_echoes_are_inside_a_box_around_everything(capture):
    positions = found_in(capture, box(0.12))
    assert positions.n_echoes > 0
    assert positions.inside > 0.95
    assert positions.bounds_m[0, 0] == pytest.approx(-0.05, abs=0.01)
    assert positions.bounds_m[1, 1] == pytest.approx(0.05, abs=0.01)
    assert positions.inside + positions.in_front + positions.beside == pytest.approx(1.0)


def test_leakage_beside_the_antennas_is_not_in_front_of_the_box(capture):
    prior = box(0.12)
    peaks = KeptPeaks(prior).of(capture)
    strongest = peaks.select(peaks.magnitudes == peaks.magnitudes.max())
    for cells, is_in_front in ((1.0, False), (3.0, True)):
        ranges = np.full(len(strongest), cells * WAVEFORM.range_cell_m)
        both = join_peaks([peaks, replace(strongest, ranges_m=ranges)])
        assert (locate_echoes(capture, prior, both).in_front > 0.0) == is_in_front


def test_a_small_box_has_echoes_in_front(capture):
    positions = found_in(capture, box(0.04))
    assert positions.in_front > 0.2
    with pytest.raises(UserError, match="smaller than its content or lies elsewhere") as caught:
        require(capture, box(0.04), "the box of a file")
    assert str(caught.value).startswith("the box of a file: ")


def test_a_box_elsewhere_does_not_contain_the_scene(capture):
    with pytest.raises(UserError, match="does not contain the scene"):
        require(capture, box(0.06, (0.0, 0.0, 0.12)), "los.ply")


@pytest.mark.parametrize(("partner", "is_wall"), [(True, True), (False, False)])
def test_the_nearer_of_two_echoes_of_a_wall_is_not_in_front(partner, is_wall):
    half_m = 0.9 * pair_distance_m(WAVEFORM)
    outer = TARGETS * (0.05 + half_m) / 0.05
    inner = TARGETS * (0.05 - half_m) / 0.05
    targets = np.concatenate([outer, inner]) if partner else outer
    scan = point_capture(4, n_side=40, spacing_m=0.003, targets=targets)
    in_front = found_in(scan, box(0.1)).in_front
    assert (in_front < 0.15) == is_wall


def test_no_echo_is_reported_by_the_search_for_glints(capture):
    far = point_capture(4, n_side=40, spacing_m=0.003, targets=np.array([[0.0, 0.0, 50.0]]))
    quiet = type(far)(
        waveform=far.waveform,
        poses=tuple(type(p)(**{**vars(p), "signal": np.zeros_like(p.signal)}) for p in far.poses),
    )
    assert require(quiet, box(0.1), "x").n_echoes == 0


def test_grating_lobes_of_a_wall_in_front_are_not_counted():
    # Where the wall is seen squarely, 0.5 beside the axis of the plane; antennas 4 mm apart see it
    # 0.47 off, 3 cm before the same wall.
    targets = np.array([[0.31, 0.3, 0.0]])
    pose = point_pose(30.0, n_side=20, spacing_m=0.004, targets=targets, standoff_m=0.6)
    capture = Capture(waveform=WAVEFORM, poses=(pose,), provenance={"importer": "test"})
    positions = found_in(capture, box(0.62))
    assert positions.bounds_m[1, 0] > 0.325  # shown before the wall
    assert positions.in_front < 0.15
    assert positions.inside > 0.85
    assert found_in(capture, box(0.56)).in_front > 0.5
