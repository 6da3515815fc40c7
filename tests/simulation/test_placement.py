"""True positions of antennas against the recorded ones."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.simulation import FigureSpec, ScanSpec, SceneSpec, WorldSpec
from geraf2.simulation.placement import position_error, true_plane
from geraf2.simulation.scan import scan_planes

SPEC = SceneSpec(
    figure=FigureSpec(name="hammer", height_m=0.05),
    scan=ScanSpec(n_poses=60, aperture_m=(0.012, 0.012), spacing_m=0.006, height_m=0.02),
)


def pairs(seed=0, **world):
    spec = replace(SPEC, world=WorldSpec(**world))
    planes = scan_planes(spec.scan)
    return [(p, true_plane(p, spec, seed, n)) for n, p in enumerate(planes)]


def test_switched_off_positions_are_the_recorded_ones_but_for_the_scans_own_errors():
    scan = replace(SPEC.scan, position_jitter_rms_m=1e-4)
    plane = scan_planes(scan)[3]
    true = true_plane(plane, replace(SPEC, scan=scan), 5, 3)
    assert np.array_equal(true.tx, plane.tx + position_error(plane, scan, 5, 3))
    assert np.array_equal(true.axes, plane.axes)


def test_angles_turn_planes_about_the_axis_each_by_its_own():
    off = []
    for seed in range(5):
        for recorded, true in pairs(seed, plane_angle_rms_deg=0.3):
            angle = np.arctan2(*true.axes[0, 1::-1]) - np.arctan2(*recorded.axes[0, 1::-1])
            off.append((angle + np.pi) % (2 * np.pi) - np.pi)
            assert true.tx[:, 2] == pytest.approx(recorded.tx[:, 2])
            radii = [np.hypot(*positions[:, :2].T) for positions in (recorded.tx, true.tx)]
            assert radii[0] == pytest.approx(radii[1])
            assert np.linalg.norm(true.tx - true.rx, axis=1) == pytest.approx(0.005)
    assert np.rad2deg(np.std(off)) == pytest.approx(0.3, rel=0.1)


def test_a_tilt_turns_every_plane_alike_in_its_own_axes():
    tilt = np.deg2rad(0.3) / np.sqrt(2.0)
    for recorded, true in pairs(axis_tilt_deg=0.3)[::11]:
        moved = (true.tx - recorded.tx) @ recorded.axes.T
        forward, _, up = (recorded.tx @ recorded.axes.T).T
        across = (recorded.tx @ recorded.axes.T)[:, 1]
        # To first order w x r, w = tilt (looking direction + horizontal). Looking direction,
        # horizontal and vertical are a left-handed set: the product has the other sign in it.
        expected = -tilt * np.stack([up, -up, across - forward], axis=1)
        assert moved == pytest.approx(expected, abs=2.0 * tilt**2)
