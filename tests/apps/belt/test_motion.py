"""Motion of a small simulated parcel against the one that it was simulated with."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.belt.monostatic import move_to_midpoints, stretch_matrices
from geraf2.apps.belt.motion import Motion, find_most_coherent
from geraf2.apps.belt.parcel import parcel_scan, remove_offset
from geraf2.apps.belt.vibration import remove_vibration
from geraf2.io.container import join_parts
from geraf2.scene import LosPrior
from geraf2.simulation.belt import belt_planes
from geraf2.simulation.belt_spec import BeltArraySpec, BeltSpec
from helpers.belt_stream import small_parcel

MOVED = {"speed_error": 0.01, "yaw_drift_deg": 1.0, "encoder": False}


def spec_of(changes):
    """Belt of the left array alone, in one plane."""
    array = BeltArraySpec(side="left", row_m=0.006, standoff_m=0.2)
    return BeltSpec(arrays=(array,), travel_m=0.4, frame_m=0.004, segment_m=0.4, **changes)


def found(**changes):
    return parcel_scan(*small_parcel(**changes), num_threads=1)


def test_speed_and_yaw_are_found_without_an_encoder_and_move_the_antennas():
    scan, motion = found(**MOVED)
    assert 1.0 + motion.scale == pytest.approx(1.0 / 1.01, abs=5e-4)
    assert motion.scale_sigma < 5e-4
    assert motion.n_pairs > 50
    assert np.rad2deg(motion.turn_rad_per_m) == pytest.approx(1.0 / 0.4, abs=0.3)
    _, true = next(belt_planes(spec_of(MOVED), 0))
    left = np.concatenate([p.phase_centers for p in scan.poses if p.name.startswith("left")])
    assert np.abs(left - 0.5 * (true.tx + true.rx)).max() < 0.0015
    # The second array of a line gives no planes.
    assert {pose.name.rpartition("/")[0] for pose in scan.poses} == {"left", "above"}
    for pose in scan.poses:
        assert np.array_equal(pose.tx_positions, pose.rx_positions)


def test_the_constant_of_a_channel_is_subtracted_and_echoes_are_kept():
    capture, record = small_parcel()
    array, pose = record.arrays[0], capture.poses[0]
    offset = np.tile(np.arange(1, array.n_channels + 1), pose.n_antennas // array.n_channels)
    shifted = replace(pose, signal=pose.signal + (1j * offset[:, None]).astype(np.complex64))
    rest, echoes = (remove_offset(p, array.n_channels).signal for p in (shifted, pose))
    np.testing.assert_allclose(rest, echoes, atol=1e-4)
    changed = np.linalg.norm(echoes - pose.signal) / np.linalg.norm(pose.signal)
    assert changed**2 < 1e-3  # of the power


def test_without_a_second_array_the_motion_is_as_recorded():
    capture, record = small_parcel()
    kept = tuple(a for a in record.arrays if a.name != "speed")
    poses = tuple(p for p in capture.poses if not p.name.startswith("speed"))
    alone = replace(capture, poses=poses), replace(record, arrays=kept)
    _, motion = parcel_scan(*alone, num_threads=1)
    assert motion == Motion()
    assert "as recorded" in str(motion)


def test_phases_give_the_motion_several_periods_from_that_of_the_ranges():
    wavelength_m, rng = 0.0038, np.random.default_rng(0)
    # Derivatives of 0.2 m between stations and directions up to 0.5, by scale and by turn.
    design = np.column_stack([rng.uniform(-0.1, 0.1, 200), np.zeros(200), np.zeros(200)])
    design[:, 2] = rng.uniform(-0.05, 0.05, 200)
    first = Motion(scale=-0.0134, turn_rad_per_m=0.125, scale_sigma=0.0015, n_pairs=200)
    first = replace(first, turn_sigma_rad_per_m=0.024)
    true = np.array([-0.0099 - first.scale, 0.0, 0.07 - first.turn_rad_per_m])
    misfit = design @ true + 3e-5 * rng.normal(size=200) + 1e-4
    misfit -= 0.5 * wavelength_m * np.rint(misfit / (0.5 * wavelength_m))
    found_motion = find_most_coherent(first, [(misfit, design)], wavelength_m)
    assert found_motion.scale == pytest.approx(-0.0099, abs=1e-4)
    assert found_motion.turn_rad_per_m == pytest.approx(0.07, abs=2e-3)


def test_a_vibration_is_found_frame_by_frame():
    shaken = {"vibration_rms_m": 0.0002}
    capture, record = small_parcel(**shaken)
    array = record.arrays[0]
    matrices = stretch_matrices(array, capture.waveform)
    pose = join_parts(
        [move_to_midpoints(p, matrices) for p in capture.poses if p.name.startswith("left")]
    )
    region = LosPrior.from_box((0.28, 0.28, 0.28))
    steady = remove_vibration({"left": pose}, [array.n_channels], capture.waveform, region, 1)[
        "left"
    ]
    recorded, true = next(belt_planes(spec_of(shaken), 0))
    vibration = (true.tx - recorded.tx)[:, 1].reshape(101, -1).mean(axis=1)
    found_m = (steady.phase_centers - pose.phase_centers)[:, 1].reshape(101, -1).mean(axis=1)
    smooth = np.ones(15) / 15.0
    rest, whole = (v - np.convolve(v, smooth, "same") for v in (found_m - vibration, vibration))
    inner = slice(15, -15)
    moved_m = (steady.phase_centers - pose.phase_centers)[:, 1].reshape(101, -1)
    assert np.ptp(moved_m, axis=1).max() < 1e-9  # a frame is recorded at one time
    # Two knots for the shortest period leave 0.58.
    assert rest[inner].std() < 0.4 * whole[inner].std()
