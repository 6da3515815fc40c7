"""Positions of a belt's chirps against the motion written out."""

import numpy as np
import pytest

import geraf2
from geraf2.io.belt_file import read_belt
from geraf2.pipeline.commands.simulate import simulate_scene
from geraf2.simulation.belt import belt_planes, belt_record
from geraf2.simulation.belt_spec import BeltArraySpec, BeltSpec
from geraf2.simulation.spec import parse_spec

SMALL = {
    "figure": {"name": "ball", "height_m": 0.06},
    "walls": [{"size_m": (0.16, 0.16, 0.16)}],
    "numerics": {"max_facet_edge_m": 0.0012, "wall_patch_m": 0.02},
    "disturbance": {"far_walls": False},
}


def belt(**changes):
    arrays = (BeltArraySpec(side="left", row_m=0.02), BeltArraySpec(side="above", row_m=0.02))
    return BeltSpec(arrays=arrays, **{"travel_m": 0.2, "frame_m": 0.02, **changes})


def of(planes, index):
    """Recorded or true midpoints, of all planes."""
    return np.concatenate([0.5 * (pair[index].tx + pair[index].rx) for pair in planes])


def test_without_errors_the_record_is_true_and_centred():
    spec = belt()
    planes = list(belt_planes(spec, 0))
    assert [recorded.name for recorded, _ in planes] == ["left/0", "above/0"]
    assert of(planes, 0) == pytest.approx(of(planes, 1), abs=1e-12)
    left, above = (of([plane], 0) for plane in planes)
    assert left[:, 0].min() == pytest.approx(-0.1, abs=0.002)
    assert left[:, 0].max() == pytest.approx(0.1, abs=0.002)
    assert np.unique(left[:, 1].round(9)) == pytest.approx([0.35])
    assert np.unique(above[:, 2].round(9)) == pytest.approx([0.35])
    assert spec.n_antennas == len(left) + len(above)


def test_transmitters_that_take_turns_stand_where_each_sends():
    at_once, in_turns = (of(belt_planes(belt(chirp_s=t), 0), 0) for t in (0.0, 60e-6))
    late = np.array(belt_record(belt()).arrays[0].delays_s)
    n = len(late)
    assert np.ptp(late) > 5 * 60e-6
    assert (at_once - in_turns)[:n, 0] == pytest.approx(0.5 * late, abs=1e-12)


@pytest.mark.parametrize("encoder", [True, False])
def test_the_record_is_longer_by_the_error_of_the_speed(encoder):
    planes = list(belt_planes(belt(speed_error=0.01, encoder=encoder), 0))
    assert of(planes[:1], 0)[:, 0] == pytest.approx(1.01 * of(planes[:1], 1)[:, 0], abs=2e-5)


def test_a_parcel_that_turns_sees_the_arrays_turn_back():
    planes = list(belt_planes(belt(yaw_drift_deg=3.0, chirp_s=0.0), 0))
    recorded, true = of(planes, 0), of(planes, 1)
    nominal = np.concatenate(
        [np.tile(a.phase_centers_m, (11, 1)) for a in belt_record(belt()).arrays]
    )
    travel = (nominal - recorded)[:, 0]
    angle = -np.deg2rad(3.0) * travel / 0.2
    x, y = recorded[:, 0], recorded[:, 1]
    assert true[:, 0] == pytest.approx(np.cos(angle) * x - np.sin(angle) * y, abs=1e-12)
    assert true[:, 1] == pytest.approx(np.sin(angle) * x + np.cos(angle) * y, abs=1e-12)


def test_vibration_has_its_size_and_moves_no_antenna_along_the_belt():
    spec = belt(vibration_rms_m=0.0002, travel_m=10.0, frame_m=0.01, chirp_s=0.0)
    planes = list(belt_planes(spec, 3))
    moved = of(planes, 1) - of(planes, 0)
    assert moved[:, 0] == pytest.approx(0.0, abs=1e-12)
    assert moved[:, 1:].std(axis=0) == pytest.approx(0.0002, rel=0.1)


def test_a_changing_speed_is_recorded_by_the_encoder_alone():
    true, nominal = (
        of(belt_planes(belt(speed_change=0.1, encoder=encoder), 0), 0) for encoder in (True, False)
    )
    assert np.abs(true - nominal)[:, 0].max() == pytest.approx(0.5 * 0.1 * 0.1**2 / 0.2, rel=0.03)


def test_a_simulated_belt_is_a_scene_with_its_arrays(tmp_path):
    table = {"arrays": [{"side": "left", "row_m": 0.02}], "travel_m": 0.1, "frame_m": 0.02}
    spec = parse_spec(SMALL | {"belt": table})
    simulate_scene(spec, tmp_path / "scene", num_threads=1)
    capture, record = geraf2.load_capture(tmp_path / "scene"), read_belt(tmp_path / "scene")
    assert [pose.name for pose in capture.poses] == ["left/0"]
    assert record.of_plane("left/0").n_channels * 5 == capture.n_antennas
    assert record == belt_record(spec.belt)
