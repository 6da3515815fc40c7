"""What planes can receive: heights, tilts, azimuths, and the share of a mesh."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.freespace.coverage import scan_coverage, summary_coverage
from geraf2.freespace.specular import specular_visibility
from geraf2.scene import Wall
from geraf2.scene.aperture import Aperture
from geraf2.scene.summary import summarize_capture
from helpers.synthetic import point_capture

STANDOFF_M = 0.4


def plane(azimuth_deg, elevation_deg=0.0, half_m=(0.07, 0.12), up_m=0.0):
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    outward = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    axes = np.stack([-outward, across, np.cross(-outward, across)])
    middle = STANDOFF_M * outward + [0.0, 0.0, up_m]
    return Aperture.from_rectangle(middle, axes, np.array(half_m))


def ring(n=24, **options):
    return [plane(360.0 * k / n, **options) for k in range(n)]


def test_heights_out_of_sight_are_those_whose_vertical_faces_no_plane_receives():
    """Against the specular condition itself, height by height."""
    found = scan_coverage(ring(up_m=0.05), (0.0, 0.0, 0.0), (0.2, 0.2, 0.44))
    angle = np.linspace(0.0, 2.0 * np.pi, 720)
    sideways = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    for z in np.linspace(-0.215, 0.215, 44):
        points = np.broadcast_to([0.0, 0.0, z], sideways.shape)
        seen = (specular_visibility(points, sideways, ring(up_m=0.05)) >= 0.0).any()
        assert seen == (not any(one.low_m < z < one.high_m for one in found.blind))
    below, above = found.blind
    assert below.where == "below all antennas"
    assert (below.low_m, below.high_m) == pytest.approx((-0.22, -0.07))
    assert above.high_m == pytest.approx(0.22)


def test_what_is_out_of_sight_is_told_with_numbers_and_what_to_do():
    low = scan_coverage(ring(up_m=0.08), (0.0, 0.0, 0.0), (0.2, 0.2, 0.3)).findings()
    (text,) = map(str, low)
    for part in (
        "content between z = -150 and -40 mm lies below all antennas",
        "surfaces there that face sideways send no echo back",
        "whose normals point up by",
        "lower the radar by 110 mm, or add planes at an elevation of -13 degrees",
    ):
        assert part in text
    both = scan_coverage(ring(), (0.0, 0.0, 0.0), (0.2, 0.2, 0.44)).findings()
    assert ["at the foot" in str(one) for one in both] == [True, False]
    assert "at the top" in str(both[1])
    between = [*ring(), *ring(elevation_deg=45.0)]
    (gap,) = scan_coverage(between, (0.0, 0.0, 0.05), (0.2, 0.2, 0.3)).findings()
    assert "lies between the antennas" in str(gap)


def test_a_scan_that_sees_its_box_says_nothing():
    found = scan_coverage(ring(), (0.0, 0.0, 0.0), (0.2, 0.2, 0.22))
    assert found.findings() == ()
    assert found.gaps_deg == ()
    assert 0.2 < found.seen_share < 0.4


def test_a_side_without_planes_is_named():
    found = scan_coverage(ring()[:12], (0.0, 0.0, 0.0))
    assert found.gaps_deg[0] == pytest.approx((175.0, 350.0), abs=1.0)
    (text,) = map(str, found.findings())
    assert "no antenna looks at the content from azimuths of 175 to 350 degrees" in text
    sparse = ring(8, half_m=(0.005, 0.12))
    assert "the 8 planes receive 0.9 % of all normals" in str(
        scan_coverage(sparse, np.zeros(3)).findings()[0]
    )


def test_planes_of_one_direction_have_no_heights():
    found = scan_coverage([plane(0.0), plane(0.0, up_m=0.3)], np.zeros(3), (0.2, 0.2, 0.9))
    assert found.blind == ()
    assert found.gaps_deg == ()


def test_the_region_is_the_inside_of_the_innermost_wall_else_the_prior():
    capture = point_capture(4)
    wall = Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6)
    walled = summary_coverage(summarize_capture(replace(capture, walls=(wall,))))
    assert walled.size_m == pytest.approx((0.212, 0.212, 0.212))
    assert walled.blind  # planes of 30 mm
    bare = summarize_capture(capture)
    assert summary_coverage(bare).blind == ()
    assert summary_coverage(bare, np.array([[-0.1] * 3, [0.1] * 3])).size_m == pytest.approx(
        (0.2, 0.2, 0.2)
    )
    assert summary_coverage(summarize_capture(replace(capture, poses=()))) is None
