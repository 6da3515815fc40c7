"""Hypotheses of a box against flashes made by mirror images of its walls."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from geraf2 import examples
from geraf2.calibration.box_search import Flashes
from geraf2.calibration.cuboid_search import BoxSearch, rough_faces
from geraf2.echoes.wall_delay import pair_distance_m

HALF_M = np.array([0.08, 0.10, 0.09])
REACH_M = 0.4
UP = np.array([0.0, 0.0, 1.0])
WAVEFORM = examples.small_scene().waveform


@dataclass
class Scan:
    """Sub-apertures on rings around the box, and planes that answer them."""

    degrees: float = 0.0
    delay_m: float = 0.0
    pair_m: float = 0.0

    def __post_init__(self):
        turn = np.deg2rad(self.degrees + np.arange(0, 360, 45))
        ahead = -np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
        steps = [-0.04, 0.0, 0.04]
        centers = [
            -REACH_M * a + side * np.cross(UP, a) + up * UP
            for a in ahead
            for side in steps
            for up in steps
        ]
        self.centers, self.ahead = np.array(centers), np.repeat(ahead, 9, axis=0)
        self.rows = []

    def add(self, normal, offset_m, half_width_m=1.0, level_db=-6.0):
        """Flashes of a plane, from the front and from behind, at the feet on the plane."""
        height = self.centers @ normal - offset_m
        feet = self.centers - np.outer(height, normal)
        sees = np.abs(self.ahead @ normal) > 0.9
        sees &= np.linalg.norm(feet - offset_m * normal, axis=1) < half_width_m
        for k in np.flatnonzero(sees):
            direction = -np.sign(height[k]) * normal
            for beyond in {self.pair_m, -self.pair_m}:
                range_m = abs(height[k]) + self.delay_m + beyond
                self.rows.append((k, direction, range_m, level_db))
        return self

    def box(self, degrees=0.0, **settings):
        """Flashes of the four sides."""
        turn = np.deg2rad(degrees)
        x, y = np.array([np.cos(turn), np.sin(turn), 0]), np.array([-np.sin(turn), np.cos(turn), 0])
        for axis, half in ((x, HALF_M[0]), (y, HALF_M[1])):
            self.add(axis, half, **settings)
            self.add(-axis, half, **settings)
        return self

    def flashes(self):
        """Both interpretations of each echo."""
        index, directions, ranges, levels = (np.array(c) for c in zip(*self.rows, strict=True))
        along = np.einsum("ij,ij->i", self.centers[index], directions)
        return Flashes(
            normals=np.concatenate([-directions, directions]),
            offsets_m=np.concatenate([-along - ranges, along + ranges]),
            far=np.repeat([False, True], len(index)),
            levels_db=np.tile(levels, 2),
            weights=np.ones(2 * len(index)),
            subapertures=np.tile(index, 2),
            centers=self.centers,
            ahead=self.ahead,
            loss_shift_m=0.0,
        )

    def found(self, like=None):
        return next(rough_faces(BoxSearch(self.flashes(), UP, REACH_M, WAVEFORM), like))


def yaw_deg(axes):
    return np.rad2deg(np.arctan2(axes[0, 1], axes[0, 0]))


@pytest.mark.parametrize(
    ("degrees", "delay_m", "pair_share", "level_db"),
    [
        (0.0, 0.0, 0.0, -6.0),
        (-44.0, 0.0, 0.0, -6.0),
        (20.0, 0.0, 0.0, -6.0),
        (0.0, 0.016, 0.0, -6.0),
        (0.0, -0.012, 0.0, -6.0),
        (0.0, 0.0, 0.9, -16.0),  # faces that cancel leave two echoes
    ],
)
def test_all_sides_are_found_at_any_yaw_and_delay(degrees, delay_m, pair_share, level_db):
    pair_m = pair_share * pair_distance_m(WAVEFORM)
    found = Scan(degrees, delay_m, pair_m).box(degrees, level_db=level_db).found()
    assert abs(yaw_deg(found.axes) - degrees) < 0.5
    np.testing.assert_allclose(found.offsets_m[:2], np.repeat(HALF_M[:2, None], 2, 1), atol=4e-3)
    assert np.isnan(found.offsets_m[2]).all()
    assert found.shift_m == pytest.approx(delay_m, abs=3e-3)
    assert found.pair_m == pytest.approx(pair_m, abs=4e-3)


def test_a_brighter_flat_face_of_content_is_no_wall():
    """A metal plate within the box, seen from two sides, 12 dB above the walls."""
    scan = Scan().box(level_db=-12.0)
    turn = np.deg2rad(45.0)
    scan.add(np.array([np.cos(turn), np.sin(turn), 0.0]), 0.03, half_width_m=0.05, level_db=0.0)
    found = scan.found()
    assert abs(yaw_deg(found.axes)) < 0.5
    np.testing.assert_allclose(found.offsets_m[:2], np.repeat(HALF_M[:2, None], 2, 1), atol=3e-3)


def test_a_far_wall_is_not_a_near_one_beyond_the_middle():
    """The antennas see one pair of walls from one side only."""
    scan = Scan()
    x = np.array([1.0, 0.0, 0.0])
    scan.add(-x, HALF_M[0]).add(x, HALF_M[0])
    scan.rows = [row for row in scan.rows if scan.centers[row[0]] @ x < 0.0]
    found = scan.found()
    np.testing.assert_allclose(found.offsets_m[0], HALF_M[[0, 0]], atol=3e-3)
    assert np.isnan(found.offsets_m[1:]).all()


def test_an_expected_orientation_decides_between_equals():
    """Walls at right angles, and others 30 degrees aside: a scan that allows both."""
    scan = Scan().box()
    other = replace(scan).box(30.0)
    scan.rows += other.rows
    for degrees in (0.0, 30.0):
        turn = np.deg2rad(degrees)
        like = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], UP])
        assert abs(yaw_deg(scan.found(like).axes) - degrees) < 0.5
