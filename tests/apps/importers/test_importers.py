"""Formats of other programs; each fault of a capture is one line that names the file."""

import json
import shutil

import numpy as np
import pytest

from geraf2.apps.importers import load_importer
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from geraf2.records import Wall
from helpers.synthetic import CAPTURE_JSON, point_capture, point_pose, write_frame, write_geraf_sens


def open_scan(source, **radar):
    return load_importer("geraf-sens").open(source, RadarManifest(**radar))


@pytest.fixture
def capture():
    return point_capture()


@pytest.fixture
def source(tmp_path, capture):
    return write_geraf_sens(tmp_path / "capture", capture)


def test_frames_come_in_the_order_of_their_index(tmp_path):
    capture = point_capture(12, n_side=2)
    scan = open_scan(write_geraf_sens(tmp_path / "c", capture))
    assert [pose.angle_deg for pose in scan.poses()] == [30.0 * i for i in range(12)]


def test_everything_of_a_frame_is_kept(source, capture):
    scan = open_scan(source)
    assert scan.n_antennas == (36, 36, 36)
    assert scan.notes == ()
    for got, want in zip(scan.poses(), capture.poses, strict=True):
        assert np.array_equal(got.signal, want.signal)
        assert got.signal.dtype == np.complex64
        assert np.allclose(got.tx_positions, want.tx_positions, atol=1e-7)
        assert np.allclose(got.rx_positions, want.rx_positions, atol=1e-7)
        assert np.allclose(got.axes, want.axes, atol=1e-7)
    assert scan.manifest.waveform.path_bias_m == 0.15
    assert scan.manifest.waveform.n_samples == 32
    assert scan.manifest.walls == (
        Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6),
    )


def test_subscans_of_one_plane_become_one_pose(source, capture):
    whole = source / "mf" / "1_120_0"
    shutil.rmtree(whole)
    pose = capture.poses[1]
    for sub, part in enumerate((slice(0, 10), slice(10, None))):
        half = type(pose)(
            signal=pose.signal[part],
            tx_positions=pose.tx_positions[part],
            rx_positions=pose.rx_positions[part],
            axes=pose.axes,
        )
        write_frame(source / "mf" / f"1_120_{sub}", half)
    scan = open_scan(source)
    assert scan.n_antennas == (36, 36, 36)
    poses = list(scan.poses())
    assert np.array_equal(poses[1].signal, pose.signal)
    assert poses[1].name == "1_120_0+1_120_1"


@pytest.mark.parametrize("repeated", [True, False])
def test_repeated_or_turned_planes_stay_poses(source, repeated):
    if repeated:
        shutil.copytree(source / "mf" / "1_120_0", source / "mf" / "1_120_1")
    else:
        write_frame(source / "mf" / "1_120_1", point_pose(125.0))
    scan = open_scan(source)
    assert [pose.name for pose in scan.poses()] == ["0_0_0", "1_120_0", "1_120_1", "2_240_0"]


def test_an_index_of_several_angles_is_named(source):
    write_frame(source / "mf" / "1_125_0", point_pose(125.0))
    (note,) = open_scan(source).notes
    assert "1 plane indices occur with several angles, the first as 1_120_0, 1_125_0" in note


def test_a_frame_that_occurs_twice_is_refused(source):
    shutil.copytree(source / "mf" / "1_120_0", source / "mf" / "01_120.0_0")
    with pytest.raises(UserError, match=r"is the same frame as 0?1_120"):
        open_scan(source)


def test_without_capture_json_everything_may_come_from_radar_toml(tmp_path, capture):
    source = write_geraf_sens(tmp_path / "c", capture, parameters=None)
    with pytest.raises(UserError, match=r"start_frequency_hz, .* are not known; give radar"):
        open_scan(source)
    scan = open_scan(
        source, start_frequency_hz=77e9, chirp_slope_hz_per_s=7e13, sample_rate_hz=625e3
    )
    assert scan.manifest.waveform.path_bias_m == 0.0
    assert "path_bias_m" in scan.notes[0]
    assert scan.manifest.walls == ()


def test_what_the_user_gives_goes_before_capture_json(source):
    assert open_scan(source, path_bias_m=0.2).manifest.waveform.path_bias_m == 0.2
    with pytest.raises(UserError, match="expected n_samples = 64, got 32"):
        open_scan(source, n_samples=64)


@pytest.mark.parametrize(
    ("change", "sizes"),
    [
        ({"box_size_m": 0.3}, [[0.3] * 3]),
        ({"box_size_m": [0.3, 0.2, 0.1]}, [[0.3, 0.2, 0.1]]),
        ({"box_size_m": [0.3, 0.2]}, [[0.3] * 3, [0.2] * 3]),
        ({"box_size_m": [[0.3, 0.2, 0.1]]}, [[0.3, 0.2, 0.1]]),
        (
            {"box_size_m": [0.3, 0.2, 0.1], "wall_thickness_m": [0.004, 0.003, 0.002]},
            [[0.3] * 3, [0.2] * 3, [0.1] * 3],
        ),
        ({"wall_permittivity": None}, []),
    ],
)
def test_walls_of_one_box_or_of_a_nest(tmp_path, capture, change, sizes):
    source = write_geraf_sens(tmp_path / "c", capture, parameters={**CAPTURE_JSON, **change})
    assert [list(wall.size_m) for wall in open_scan(source).manifest.walls] == sizes


def test_the_middle_of_the_box_may_lie_elsewhere(tmp_path, capture):
    stated = {**CAPTURE_JSON, "box_center_m": [0, 0, 0.09]}
    source = write_geraf_sens(tmp_path / "c", capture, parameters=stated)
    assert [wall.center_m for wall in open_scan(source).manifest.walls] == [(0.0, 0.0, 0.09)]
    for wrong in (0.09, [0, 0], [0, 0, "high"]):
        (source / "capture.json").write_text(json.dumps({**stated, "box_center_m": wrong}))
        with pytest.raises(UserError, match="box_center_m"):
            open_scan(source)


def test_other_folders_and_another_pose_count_are_mentioned(source):
    (source / "mf" / "calibration").mkdir()
    (source / "capture.json").write_text(json.dumps({**CAPTURE_JSON, "n_poses": 36}))
    folders, count = open_scan(source).notes
    assert "calibration" in folders
    assert count == "capture.json states n_poses = 36, found 3"
