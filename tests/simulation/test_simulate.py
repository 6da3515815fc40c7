"""Whole captures, kept tiny: two planes of a few dozen antennas."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.errors import UserError
from geraf2.io.scan_file import ScanFile, ScanLine, SweptArray, SweptPlane
from geraf2.scene import Wall
from geraf2.simulation import DisturbanceSpec, FigureSpec, ScanSpec, SceneSpec, WorldSpec, simulate
from geraf2.simulation.elements import rough_displacement
from geraf2.simulation.placement import position_error
from geraf2.simulation.scan import scan_planes
from geraf2.simulation.spec import RingSpec

C = 299792458.0
FREE = SceneSpec(
    figure=FigureSpec(name="hammer", height_m=0.05),
    scan=ScanSpec(n_poses=2, arc_deg=90, aperture_m=(0.03, 0.03), spacing_m=0.006),
    disturbance=DisturbanceSpec(snr_db=np.inf),
)
CARTON = Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6)


def signals(spec, seed=0, **options):
    capture, _ = simulate(spec, seed=seed, **options)
    return np.concatenate([pose.signal for pose in capture.poses])


def power(signal):
    return np.mean(np.abs(signal) ** 2, dtype=np.float64)


def test_capture_describes_the_scan():
    capture, truth = simulate(replace(FREE, walls=(CARTON,)), seed=3)
    assert [pose.angle_deg for pose in capture.poses] == [0.0, 90.0]
    first, second = capture.poses
    assert first.n_antennas == 36
    assert first.phase_centers.mean(axis=0) == pytest.approx([0.4, 0.0, 0.0])
    assert second.phase_centers.mean(axis=0) == pytest.approx([0.0, 0.4, 0.0])
    assert first.axes == pytest.approx(np.array([[-1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    assert second.axes @ second.axes.T == pytest.approx(np.eye(3))
    assert np.linalg.norm(first.tx_positions - first.rx_positions, axis=1) == pytest.approx(0.005)
    assert capture.walls == (CARTON,)
    assert capture.provenance["seed"] == "3"
    assert np.ptp(truth.vertices[:, 2]) == pytest.approx(0.05)
    assert first.signal.dtype == np.complex64


def test_seeds_reproduce_and_differ():
    spec = replace(
        FREE,
        disturbance=DisturbanceSpec(snr_db=10.0, scatterer_energy_fraction=0.1, n_scatterers=20),
        scan=replace(FREE.scan, position_jitter_rms_m=2e-4),
    )
    one = signals(spec, seed=1)
    assert np.array_equal(one, signals(spec, seed=1, num_threads=1))
    assert np.abs(one - signals(spec, seed=2)).max() > 0.1


def test_noise_free_signal_has_unit_mean_power_and_snr_is_met():
    clean = signals(FREE)
    assert power(clean) == pytest.approx(1.0, rel=1e-4)
    noisy = signals(replace(FREE, disturbance=DisturbanceSpec(snr_db=7.0)))
    # 2304 complex samples: the noise power is known to 2 %.
    assert 10 * np.log10(power(clean) / power(noisy - clean)) == pytest.approx(7.0, abs=0.3)


def test_scatterers_have_the_asked_fraction_of_the_objects_energy():
    clean = signals(FREE)
    options = {"snr_db": np.inf, "scatterer_energy_fraction": 0.2, "n_scatterers": 50}
    mixed = signals(replace(FREE, disturbance=DisturbanceSpec(**options)))
    # Both are scaled to unit power: take the object's part out of the mixture.
    part = np.vdot(clean, mixed) / np.vdot(clean, clean)
    fraction = power(mixed - part * clean) / power(part * clean)
    assert fraction == pytest.approx(0.2, rel=0.15)  # less what correlates by chance, 1 / 50


def range_profile(signal, waveform, ranges):
    """Mean power over antennas against one-way range, instrument delay subtracted."""
    window = np.hanning(waveform.n_samples + 2)[1:-1]
    paths = 2 * ranges + waveform.path_bias_m
    bank = np.exp(2j * np.pi * np.outer(paths, waveform.frequencies_hz) / C) * window
    return np.mean(np.abs(signal @ bank.T) ** 2, axis=0)


def test_near_and_far_wall_arrive_when_they_should():
    # A small object off the axis, so that the far wall is free; antennas near the axis.
    figure = FigureSpec(name="hammer", height_m=0.02, center_m=(0.0, 0.08, 0.08))
    scan = ScanSpec(n_poses=1, aperture_m=(0.012, 0.012), spacing_m=0.006)
    wall = replace(CARTON, size_m=(0.3, 0.3, 0.3))
    spec = SceneSpec(
        figure=figure, walls=(wall,), scan=scan, disturbance=DisturbanceSpec(snr_db=np.inf)
    )
    capture, _ = simulate(spec, seed=0)
    ranges = np.arange(0.15, 0.7, 0.0005)
    profile = range_profile(capture.poses[0].signal, capture.waveform, ranges)
    near, far = ranges < 0.4, ranges > 0.4
    # Two faces r, -r (1 - r^2) 5.06 mm of one-way path apart are one peak between them.
    slab = 0.5 * np.sqrt(1.6) * 0.004
    assert ranges[near][profile[near].argmax()] == pytest.approx(0.25 + slab, abs=0.004)
    excess = (np.sqrt(1.6) - 1) * 0.004
    expected_far = 0.4 + 0.15 - 0.004 + excess + slab
    assert ranges[far][profile[far].argmax()] == pytest.approx(expected_far, abs=0.004)
    # Spreading to the image 2 R away, and four crossed faces on the path to the far wall.
    r2 = ((1 - np.sqrt(1.6)) / (1 + np.sqrt(1.6))) ** 2
    drop_db = 20 * np.log10(0.25 / 0.546 * (1 - r2) ** 2)
    got_db = 10 * np.log10(profile[far].max() / profile[near].max())
    assert got_db == pytest.approx(drop_db, abs=1.5)  # edges of the plates ripple by 1 dB


def test_without_far_walls_nothing_echoes_over_them():
    noisy = DisturbanceSpec(snr_db=np.inf, far_walls=False)
    spec = replace(FREE, walls=(CARTON,), disturbance=noisy)
    waves = replace(spec, world=WorldSpec(preset="plausible", effects=("waves",)))
    assert np.array_equal(signals(spec), signals(waves))


def recorded_and_true(**errors):
    scan = replace(FREE.scan, **errors)
    plane = scan_planes(scan)[0]
    return plane, position_error(plane, scan, 0, 0)


def test_drift_is_slow_and_of_the_asked_size():
    plane, error = recorded_and_true(position_drift_rms_m=5e-4)
    assert np.abs(np.diff(error, axis=0)).max() < 3e-4
    scan = replace(FREE.scan, position_drift_rms_m=5e-4)
    many = [position_error(plane, scan, 0, number) for number in range(200)]
    assert np.sqrt(np.mean(np.square(many))) == pytest.approx(5e-4, rel=0.1)


def test_a_radar_stands_nearer_when_the_axis_does():
    plane, error = recorded_and_true(axis_offset_m=(0.002, 0.003))
    assert error @ plane.axes.T == pytest.approx(np.tile([0.002, -0.003, 0.0], (36, 1)))


def test_roughness_displaces_by_its_rms_and_keeps_neighbours_joined():
    displace = rough_displacement(3e-4, 0.003, np.random.default_rng(0))
    positions = np.random.default_rng(1).uniform(-0.05, 0.05, (20000, 3))
    moved = displace(positions)
    assert np.sqrt(np.mean(moved**2, axis=0)) == pytest.approx([3e-4] * 3, rel=0.1)
    near = displace(positions + np.array([1e-5, 0.0, 0.0]))
    assert np.abs(near - moved).max() < 2e-5
    correlation = np.mean(displace(positions + np.array([0.003, 0.0, 0.0])) * moved) / 9e-8
    assert correlation == pytest.approx(np.exp(-0.5), abs=0.15)


def test_a_raised_plane_is_a_turned_one_and_a_tilt_turns_where_it_stands():
    flat = ScanSpec(n_poses=1, start_angle_deg=20.0, aperture_m=(0.03, 0.03), spacing_m=0.006)
    ring = RingSpec(start_angle_deg=20.0, elevation_deg=40.0)
    plane, raised = scan_planes(replace(flat, rings=(ring,)))
    turn = Rotation.from_rotvec(-np.deg2rad(40.0) * plane.axes[1]).as_matrix()  # upwards
    turn = turn if (turn @ plane.tx[0])[2] > 0 else turn.T
    assert raised.tx == pytest.approx(plane.tx @ turn.T, abs=1e-12)
    assert raised.axes == pytest.approx(plane.axes @ turn.T, abs=1e-12)
    (tilted,) = scan_planes(replace(flat, n_poses=0, rings=(replace(ring, tilt_deg=40.0),)))
    assert tilted.tx.mean(axis=0) == pytest.approx(raised.tx.mean(axis=0))
    assert tilted.axes == pytest.approx(plane.axes, abs=1e-12)  # looks horizontally again
    (above,) = scan_planes(replace(flat, n_poses=0, rings=(RingSpec(elevation_deg=90.0),)))
    assert above.axes[0] == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)
    assert above.tx[:, 2] == pytest.approx(0.4)


def test_lines_of_a_scan_file_over_a_raster_give_what_the_raster_gives():
    spec = replace(FREE, scan=replace(FREE.scan, n_poses=1))
    (plane,) = scan_planes(spec.scan)
    centers = (0.5 * (plane.tx + plane.rx)).reshape(6, 6, 3)
    lines, columns = [], range(6)
    for row in range(6):
        first, last = centers[columns[0], row], centers[columns[-1], row]
        lines.append(
            ScanLine(
                start_m=tuple(first),
                end_m=tuple(last),
                n_positions=6,
                start_s=row,
                speed_m_per_s=0.1,
            )
        )
        columns = columns[::-1]
    axes = plane.axes * [[1], [-1], [1]]  # a file's axes are a rotation
    swept = SweptPlane(name="a", axes=tuple(map(tuple, axes)), lines=tuple(lines))
    array = SweptArray(tx_offsets_m=((0, -0.0025, 0),), rx_offsets_m=((0, 0.0025, 0),))
    file = ScanFile(planes=(swept,), array=array, spacing_m=0.006)
    there = signals(replace(spec, scan=replace(spec.scan, sweeps=file))).reshape(6, 6, -1)
    there[1::2] = there[1::2, ::-1]  # back and forth
    here = signals(spec).reshape(6, 6, -1).transpose(1, 0, 2)
    assert there == pytest.approx(here, abs=2e-5)


def test_an_object_that_is_placed_outside_fits_once_the_hint_is_obeyed():
    figure = replace(FREE.figure, center_m=(0.3, 0.0, 0.0))
    spec = replace(FREE, figure=figure, walls=(replace(CARTON, center_m=(0.02, 0.0, 0.01)),))
    with pytest.raises(UserError, match="does not fit into its box") as refused:
        simulate(spec, seed=0)
    stated = str(refused.value).split("figure.center_m to ")[1]
    simulate(replace(spec, figure=replace(figure, center_m=tuple(json.loads(stated)))), seed=0)
