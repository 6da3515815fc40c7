"""Plans in minutes: times against sums by hand, speed against blur, the best of what fits."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geraf2.apps.planning.expected import expect_accuracy
from geraf2.apps.planning.planning import PlanOptions, make_plan
from geraf2.apps.planning.scan_time import Scanner, find_best_plan, require_speed, swept_planes
from geraf2.errors import UserError
from geraf2.freespace.specular import seen_share
from geraf2.scene import Pose
from geraf2.scene.aperture import Aperture
from geraf2.scene.plan import plane_at

BOX, STANDOFF_M, APERTURE_M, WAVELENGTH_M = (0.22, 0.22, 0.22), 0.4, (0.14, 0.25), 0.0038
HALF = 0.5 * np.array(APERTURE_M)
EIGHT = Scanner(channels=8)


@cache
def best(minutes, scanner=EIGHT, **more):
    base = make_plan(PlanOptions(box=BOX, standoff=STANDOFF_M, aperture=APERTURE_M))
    return find_best_plan(base, scanner, 60 * minutes, **more)


def test_lines_of_a_plane_and_their_time():
    planes = [plane_at(0.0, 0.0, STANDOFF_M, HALF), plane_at(1.0, 0.7, STANDOFF_M, HALF)]
    scan, seconds = swept_planes(planes, 0.004, EIGHT)
    lines = scan.planes[0].lines
    # 8 rows of 4 mm a line: 63 rows take 8 lines of 0.14 m, each 32 mm above the one before.
    assert (len(lines), lines[0].n_positions) == (8, 36)
    assert [line.start_m[2] for line in lines] == pytest.approx(0.032 * (np.arange(8) - 3.5))
    assert seconds == pytest.approx(2 * (8 * (0.14 + 0.032) / 0.1 + 3.0))
    assert lines[1].start_s - lines[0].end_s == pytest.approx(0.32)
    assert scan.n_antennas == 2 * 8 * 36 * 8
    tx, rx = scan.antennas(scan.planes[1])
    local = (0.5 * (tx + rx) - planes[1].middle_m) @ planes[1].axes.T
    assert np.abs(local).max(axis=0) == pytest.approx([0.0, 0.07, 0.126], abs=1e-6)
    rows = np.unique(np.round(local[:, 2], 6))
    assert np.diff(rows) == pytest.approx(0.004, abs=2e-6)
    still, longer = swept_planes(planes, 0.004, replace(EIGHT, settle_s=0.2))
    assert longer - seconds == pytest.approx(2 * 8 * 36 * (0.2 + 0.001))
    assert still.motion == "stop-and-go"


def test_a_board_takes_fewer_lines_the_higher_it_stands():
    planes = [plane_at(0.0, 0.0, STANDOFF_M, HALF)]
    scanners = (Scanner(), Scanner(array="iwr1843"), Scanner(array="awr2243-cascade"))
    counts = [len(swept_planes(planes, 0.004, s)[0].planes[0].lines) for s in scanners]
    assert counts == [63, 24, 3]


def test_what_is_chosen_fits_and_more_time_is_no_worse():
    plans = [best(minutes) for minutes in (0.8, 1, 2, 5)]
    for minutes, plan in zip((0.8, 1, 2, 5), plans, strict=True):
        assert plan.scan.seconds <= plan.seconds <= 60 * minutes
        rectangles = plan.design.planes(STANDOFF_M)
        exact = seen_share(rectangles, np.zeros(3), np.array(BOX))
        assert plan.seen_share == pytest.approx(exact, abs=0.01)
        assert len(plan.scan.planes) == plan.design.n_planes == len(rectangles)
    reached = [plan.expected.f1_5mm for plan in plans]
    assert reached == sorted(reached)


def test_planes_are_raised_where_they_see_a_tenth_more_than_one_ring():
    few, many = best(2), best(10)
    assert few.design.n_raised == few.design.above == 0
    assert many.seen_share > 1.1 * many.ring_share
    assert best(10, max_elevation_deg=0.0).expected.f1_5mm < many.expected.f1_5mm


def test_more_seen_is_better_and_sides_that_none_sees_are_worse():
    def reached(angles_deg, elevations=(0.0,)):
        turns = [(np.deg2rad(a), np.deg2rad(e)) for a in angles_deg for e in elevations]
        planes = [plane_at(a, e, STANDOFF_M, HALF) for a, e in turns]
        return expect_accuracy(
            planes, np.zeros(3), seen_share(planes, np.zeros(3), np.full(3, 0.22))
        )

    around = [reached(np.arange(0, 360, 360 / n)) for n in (1, 2, 3, 4, 6, 12, 36)]
    around.append(reached(np.arange(0, 360, 30), (-60.0, -30.0, 0.0, 30.0, 60.0)))
    for name, sign in (("f1_5mm", 1), ("f1_15mm", 1), ("error_m", -1), ("min_5mm", 1)):
        assert (sign * np.diff([getattr(one, name) for one in around]) >= 0).all()
    for one in around:
        assert 0.0 <= one.min_5mm <= one.f1_5mm <= one.f1_15mm <= 1.0
    assert around[-1].f1_5mm > 0.98
    sides = reached([-60, -30, 0, 30, 60])
    assert sides.f1_5mm < reached([0, 72, 144, 216, 288]).f1_5mm - 0.1
    assert sides.f1_15mm < 0.99


def test_a_spacing_with_ghosts_is_not_chosen_and_has_nothing_to_expect():
    too_wide_m = 0.008
    assert best(5).design.spacing_m < too_wide_m
    assert best(5, spacing_m=too_wide_m).expected is None


@pytest.mark.parametrize(
    ("scanner", "message"),
    [
        (
            Scanner(channels=8, speed_m_per_s=2.0),
            "moves 2 mm while the chirps of one position are recorded, more than 0.25 "
            "wavelengths of blur, expected at most 0.95 m/s, got 2 m/s",
        ),
        (Scanner(chirps_per_position=20), "0.25 wavelengths of blur"),
        (Scanner(array="awr2243-cascade", order="ddm"), "0.25 wavelengths of blur"),
        (
            Scanner(array="awr2243-cascade", speed_m_per_s=0.5),
            "moves 6 mm while the chirps of one position are recorded, more than the spacing of "
            "4 mm",
        ),
    ],
)
def test_an_arm_that_is_too_fast_is_refused(scanner, message):
    with pytest.raises(UserError, match=message):
        require_speed(scanner, 0.004, WAVELENGTH_M)
    require_speed(replace(scanner, array=None, settle_s=0.2), 0.004, WAVELENGTH_M)


def test_a_plane_is_a_line_lower_where_that_lets_another_one_in():
    less, plan = best(0.8), best(1)
    assert plan.design.n_planes > less.design.n_planes
    assert len(plan.scan.planes[0].lines) == len(less.scan.planes[0].lines) - 1
    assert plan.seen_share > 1.1 * less.seen_share
    assert best(5).design.aperture_m == APERTURE_M


def test_the_plane_of_a_pose_covers_its_phase_centres():
    rng = np.random.default_rng(0)
    beside = plane_at(0.0, 0.0, 0.4, HALF)
    local = rng.uniform(-1, 1, (50, 2)) * HALF + [0.01, 0.02]
    centers = beside.middle_m + local @ beside.axes[1:]
    apart = np.array([0.0, 0.001, 0.0])
    pose = Pose(
        signal=np.zeros((50, 1), np.complex64),
        tx_positions=centers + apart,
        rx_positions=centers - apart,
        axes=beside.axes,
    )
    plane = Aperture.from_pose(pose).turn_right_handed()
    assert plane.half_m == pytest.approx(0.5 * np.ptp(local, axis=0))
    assert plane.axes == pytest.approx(beside.axes)
    inside = np.abs((centers - plane.middle_m) @ plane.axes[1:].T) <= plane.half_m + 1e-12
    assert inside.all()
