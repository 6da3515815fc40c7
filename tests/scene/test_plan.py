from dataclasses import replace

import numpy as np
import pytest

from geraf2.freespace.specular import received_normals, seen_share
from geraf2.scene.plan import (
    ScanPlan,
    depth_of_focus_m,
    suggested_planes,
)
from helpers.synthetic import WAVEFORM

BOX = (0.22, 0.22, 0.22)
PLAN = ScanPlan(
    box_m=BOX,
    waveform=WAVEFORM,
    standoff_m=0.4,
    aperture_m=(0.14, 0.25),
    spacing_m=0.005,
    n_planes=36,
    elevations_deg=(0.0,),
)


def degrees(azimuth, elevation):
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    return np.array([[np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]])


def share(plan):
    return seen_share(plan.apertures, np.zeros(3), np.array(BOX))


def seen(plan, azimuth, elevation, point=(0.0, 0.0, 0.0)):
    return int(received_normals(plan.apertures, degrees(azimuth, elevation), np.array(point)).sum())


def test_a_plane_sees_the_normals_that_meet_it():
    one = replace(PLAN, n_planes=1)
    assert seen(one, 0, 0) == 1
    assert seen(one, 9.9, 0) == 1  # 0.4 tan 9.9 degrees = 70 mm, half the width
    assert seen(one, 10.1, 0) == 0
    assert seen(one, 0, 17.3) == 1
    assert seen(one, 0, 17.5) == 0
    assert seen(one, 180, 0) == 0
    assert seen(one, 0, 0, (0.0, 0.071, 0.0)) == 0
    assert seen(one, -10.1, 0, (0.0, 0.03, 0.0)) == 1


def test_a_ring_at_an_elevation_looks_down():
    raised = replace(PLAN, elevations_deg=(40.0,))
    assert seen(raised, 0, 40) > 0
    assert seen(raised, 0, 0) == 0
    assert seen(raised, 5, 40) == 2 * seen(replace(raised, n_planes=18), 0, 40)


def test_axes_of_a_plane_look_inward_run_against_the_azimuth_and_rise():
    """The sphere's derivatives by azimuth and elevation, in small steps, are the raster's axes."""
    for number, plane in enumerate(replace(PLAN, elevations_deg=(40.0,)).apertures):
        axes, middle = plane.axes, 0.5 * (plane.low_m + plane.high_m) @ plane.axes
        azimuth = 10.0 * number
        outward = degrees(azimuth, 40.0)[0]
        along = degrees(azimuth + 0.01, 40.0)[0] - degrees(azimuth - 0.01, 40.0)[0]
        rise = degrees(azimuth, 40.01)[0] - degrees(azimuth, 39.99)[0]
        assert middle == pytest.approx(0.4 * outward)
        wanted = [-outward, -along / np.linalg.norm(along), rise / np.linalg.norm(rise)]
        assert axes == pytest.approx(np.array(wanted))


def test_one_ring_sees_the_sine_of_its_tilt():
    tilt = np.arctan(0.125 / 0.4)
    assert share(PLAN) == pytest.approx(np.sin(tilt), abs=0.02)
    both = replace(PLAN, elevations_deg=(0.0, 35.0))
    assert share(both) > 1.7 * share(PLAN)


def test_suggested_planes_see_every_horizontal_normal_twice():
    n = suggested_planes((0.14, 0.25), 0.4)
    normals = np.concatenate([degrees(a, 0.0) for a in np.linspace(0.0, 360.0, 721)])
    count = received_normals(replace(PLAN, n_planes=n).apertures, normals, np.zeros(3)).sum(axis=1)
    assert count.min() >= 2
    fewer = received_normals(replace(PLAN, n_planes=n // 2 - 2).apertures, normals, np.zeros(3))
    assert not fewer.any(axis=1).all()


def test_a_plane_is_in_focus_until_its_edge_is_half_a_wave_off():
    depth, width, wavelength = 1.0, 0.1, WAVEFORM.center_wavelength_m
    off = depth_of_focus_m(depth, width, wavelength)

    def sag(z):  # two-way path of the edge beyond that of the middle
        return 2 * (np.hypot(z, 0.5 * width) - z)

    assert sag(depth) - sag(depth + off) == pytest.approx(0.5 * wavelength, rel=1.0)
    assert sag(depth) - sag(depth + 1e-3 * off) == pytest.approx(0.5e-3 * wavelength, rel=0.02)
    assert depth_of_focus_m(0.01, 1.0, wavelength) == 2 * wavelength
