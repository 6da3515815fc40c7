"""ROS 2 bags: samples, chains of poses, planes, the clock offset, faults; results as MCAP."""

import sys

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.apps.importers._bag import frame_clock
from geraf2.apps.importers.clock_offset import Sweep, find_clock_offset
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.io.manifest import AntennaManifest, RadarManifest, RawManifest
from helpers.console import the_error
from helpers.raw_capture import RADAR, RADAR_TOML
from helpers.ros_bag import PARTS, at_times, frames_of, scan_path, write_bag

RADAR_MANIFEST = RadarManifest(
    **RADAR, raw=RawManifest(n_rx=1), antennas=AntennaManifest(rx_offsets_m=[[0.0, 0.0, 0.0]])
)
LATE_S = 0.033
BYTES = "std_msgs/msg/UInt8MultiArray"


def opened(bag, **options):
    return load_importer("rosbag").open(bag, RADAR_MANIFEST, ImportOptions(**options))


@pytest.fixture(scope="module")
def path():
    return scan_path()


@pytest.fixture(scope="module")
def frames(path):
    return frames_of(path)


@pytest.fixture(scope="module")
def bag(tmp_path_factory, path, frames):
    return write_bag(tmp_path_factory.mktemp("ros") / "scan", path, frames, late_s=LATE_S)


@pytest.fixture(scope="module")
def few(frames):
    return frames[0][:150], frames[1][:150]


def offset_ms(scan):
    text = dict(scan.facts)["clock offset"].split()
    return float(text[1]), float(text[3])


def test_an_offset_of_the_clocks_is_found_and_applied(bag, path, frames):
    scan = opened(bag)
    found, sigma = offset_ms(scan)
    assert abs(found - 1e3 * LATE_S) < 0.3
    assert 0.0 < sigma < 0.3
    assert scan.manifest.provenance["clock offset"] == dict(scan.facts)["clock offset"]
    positions = np.concatenate([pose.tx_positions for pose in scan.poses()])
    expected, _ = at_times(path, frames[0])
    assert np.abs(positions - expected).max() < 1e-4
    signal = np.concatenate([pose.signal for pose in scan.poses()])
    assert signal.dtype == np.int16
    assert np.array_equal(signal[7].reshape(-1), frames[1][7])


def test_the_command_states_the_offset_and_info_shows_it(tmp_path, bag, capsys):
    text = RADAR_TOML + "[raw]\nn_rx = 1\n[antennas]\nrx_offsets_m = [[0.0, 0.0, 0.0]]\n"
    (tmp_path / "radar.toml").write_text(text)
    scene, radar = str(tmp_path / "scene"), ["--radar", str(tmp_path / "radar.toml")]
    assert main(["import", "rosbag", str(bag), scene, *radar]) == 0
    assert "clock offset" in capsys.readouterr().out
    assert main(["info", scene]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "clock offset radar 3" in shown
    assert "from 10 lines" in shown


def test_info_lists_the_topics_of_a_bag(tmp_path, bag, path, frames, capsys):
    file = next(bag.glob("*.mcap"))
    for source in (bag, file):
        assert main(["info", str(source)]) == 0
        shown = " ".join(capsys.readouterr().out.split())
        assert "recorded 2023-11-14 22:13:20 UTC, 13.9 s" in shown
        assert "/radar/adc xwr_driver/msg/AdcFrame, 1341 messages: samples of a radar" in shown
        assert "/tf tf2_msgs/msg/TFMessage, 1391 messages: poses" in shown
        assert f"geraf2 import rosbag {source} scene" in shown
    unusable = write_bag(tmp_path / "b", path, frames, adc=None)
    assert main(["info", str(unusable)]) == 0
    done = capsys.readouterr()
    assert "no topic with samples of a radar" in done.err
    assert "import rosbag" not in done.out
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert main(["info", str(tmp_path / "old.bag")]) == 2
    assert "is a ROS 1 bag" in capsys.readouterr().err


def test_a_given_offset_goes_before_the_estimate(bag, path, frames):
    scan = opened(bag, clock_offset_ms=30.0)
    assert dict(scan.facts)["clock offset"] == "radar 30 ms late, given"
    positions = np.concatenate([pose.tx_positions for pose in scan.poses()])
    assert np.allclose(positions, at_times(path, frames[0] + 0.003)[0], atol=1e-5)


def test_lines_in_one_direction_do_not_determine_the_offset(tmp_path):
    path = scan_path(6, serpentine=False)
    bag = write_bag(tmp_path / "b", path, frames_of(path), late_s=0.01)
    scan = opened(bag)
    assert dict(scan.facts)["clock offset"] == "not determined, taken as 0 ms"
    assert any("give --clock-offset-ms" in note for note in scan.notes)


def test_noise_has_no_offset():
    rng = np.random.default_rng(0)
    path = scan_path(8)
    times = np.arange(0.0, path[0][-1], 0.01)
    noise = rng.normal(size=(len(times), 1, 32, 2)) @ [1, 1j]
    lines = [(0.05 + 1.35 * k, 1.25 + 1.35 * k) for k in range(8)]
    sweeps = [Sweep(interval_s=line, times_s=times, signal=noise) for line in lines]
    found = find_clock_offset(sweeps, lambda t: at_times(path, t)[0], 0.0038)
    assert found.n_lines == 8
    assert found.sigma_s == np.inf


@pytest.mark.parametrize(
    ("kind", "poses"),
    [(BYTES, "pose"), ("std_msgs/msg/Int16MultiArray", "odometry")],
)
def test_arrays_without_header_and_poses_of_one_topic_are_read(tmp_path, path, few, kind, poses):
    bag = write_bag(tmp_path / "b", path, few, adc=kind, poses=poses, storage="SQLITE3")
    scan = opened(bag, clock_offset_ms=0.0)
    assert dict(scan.facts)["positions from"].startswith("/radar/pose")
    positions = np.concatenate([pose.tx_positions for pose in scan.poses()])
    assert np.abs(positions - at_times(path, few[0])[0]).max() < 1e-5


def require_few(bag, few):
    """That a bag is read; its frames are too few for an offset of the clocks."""
    scan = opened(bag, clock_offset_ms=0.0)
    signal = np.concatenate([pose.signal for pose in scan.poses()])
    assert np.array_equal(signal[:, :, 0], np.stack(few[1])[:, ::2])


@pytest.mark.parametrize(
    ("storage", "compression"),
    [("MCAP", "STORAGE"), ("MCAP", "FILE"), ("SQLITE3", "MESSAGE")],
)
def test_compressed_bags_are_read(tmp_path, path, few, storage, compression):
    bag = write_bag(tmp_path / "b", path, few, storage=storage, compression=compression)
    require_few(bag, few)


def test_real_and_imaginary_parts_are_joined_where_they_are_as_many(tmp_path, path, few):
    require_few(write_bag(tmp_path / "bag", path, few, adc=PARTS), few)
    times, words = few
    odd = times, [frame[:-1] for frame in words]
    short = write_bag(tmp_path / "short", path, odd, adc=PARTS)
    with pytest.raises(UserError, match=r"real_data and imag_data .* differ in length"):
        opened(short)


def test_transmitters_that_take_turns_have_positions_of_their_own_times(tmp_path, path):
    delays = np.array([-0.001, 0.001])
    both = frames_of(path, delays_s=delays)
    bag = write_bag(tmp_path / "b", path, both, late_s=LATE_S)
    antennas = AntennaManifest(tx_offsets_m=np.zeros((2, 3)).tolist(), rx_offsets_m=[[0.0] * 3])
    raw = RawManifest(n_rx=1, n_tx=2, chirp_s=0.002)
    radar = RADAR_MANIFEST.model_copy(update={"raw": raw, "antennas": antennas})
    scan = load_importer("rosbag").open(bag, radar, ImportOptions())
    assert abs(offset_ms(scan)[0] - 1e3 * LATE_S) < 0.3
    positions = np.concatenate([pose.tx_positions for pose in scan.poses()]).reshape(-1, 2, 3)
    for k, delay in enumerate(delays):
        assert np.abs(positions[:, k] - at_times(path, both[0] + delay)[0]).max() < 1e-4


def test_stretches_between_turns_are_planes(tmp_path):
    path = scan_path(4, n_planes=2)
    bag = write_bag(tmp_path / "b", path, frames_of(path))
    scan = opened(bag, clock_offset_ms=0.0)
    assert len(scan.n_antennas) == 2
    assert any("2 planes" in note for note in scan.notes)
    axes = [pose.axes[0] for pose in scan.poses()]
    assert np.allclose(axes[0], [1, 0, 0], atol=1e-3)
    assert np.allclose(axes[1], [np.cos(np.pi / 6), np.sin(np.pi / 6), 0], atol=1e-3)


def test_lost_frames_are_refused_or_left_out(tmp_path, path, few):
    times, words = few
    kept = np.delete(np.arange(len(times)), [20, 21, 70])
    some = times[kept], [words[k] for k in kept]
    bag = write_bag(tmp_path / "b", path, some)
    with pytest.raises(UserError, match=r"3 of 150 frames are missing from /radar/adc.*got none"):
        opened(bag)
    scan = opened(bag, keep_good=True, clock_offset_ms=0.0)
    assert scan.n_antennas == (147,)
    signal = np.concatenate([pose.signal for pose in scan.poses()])
    assert np.array_equal(signal[20].reshape(-1), words[22])


def test_stamps_that_go_back_are_refused_or_left_out(tmp_path, path, few):
    times = few[0].copy()
    times[50] -= 0.1
    bag = write_bag(tmp_path / "b", path, (times, few[1]))
    with pytest.raises(UserError, match="do not increase at 1 of 150 messages"):
        opened(bag)
    assert opened(bag, keep_good=True, clock_offset_ms=0.0).n_antennas == (149,)


def test_jittered_stamps_are_frames_at_equal_times():
    rng = np.random.default_rng(1)
    true = 0.01001 * np.arange(2000)
    numbers, start, period = frame_clock(true + rng.uniform(0, 0.004, 2000), 0.01, "/a", "b")
    assert np.array_equal(numbers, np.arange(2000))
    assert abs(period - 0.01001) < 1e-6
    assert abs(start - 0.002) < 2e-4


@pytest.mark.parametrize(
    ("adc", "poses", "options", "text"),
    [
        (None, "tf", {}, r"has no topic with samples of a radar.*got /tf \(tf2_msgs"),
        (BYTES, None, {}, "has no poses of the radar"),
        (BYTES, "tf", {}, "no transforms lead from frame"),
        (BYTES, "tf", {"frames": ("room", "hand")}, "to 'hand', expected two of arm, radar, room"),
        (BYTES, "tf", {"adc_topic": "/x"}, r"no topic /x, .* expected /radar/adc \(std_msgs"),
        (BYTES, "tf", {"adc_topic": "/tf"}, "/tf holds no samples"),
        (BYTES, "tf", {"pose_topic": "/radar/adc"}, "holds no poses"),
    ],
)
def test_what_a_bag_lacks_is_named(tmp_path, path, few, adc, poses, options, text):
    few = few[0][:40], few[1][:40]
    bag = write_bag(tmp_path / "b", path, few, adc=adc, poses=poses)
    with pytest.raises(UserError, match=text):
        opened(bag, **options)


def test_transforms_without_a_common_time_are_refused(tmp_path, path, few):
    bag = write_bag(tmp_path / "b", path, few, poses="tf apart")
    with pytest.raises(UserError, match="'room' to 'radar' have no time in common"):
        opened(bag)


def test_broken_files_are_one_line(tmp_path, bag, capsys):
    data = next(bag.glob("*.mcap")).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    (tmp_path / "text.mcap").write_text("no bag")
    (tmp_path / "folder").mkdir()
    for name, text in [
        ("cut.mcap", "cannot be read"),
        ("text.mcap", "cannot be read"),
        ("folder", "cannot be read"),
        ("none.mcap", "no such file"),
    ]:
        assert main(["import", "rosbag", str(tmp_path / name), str(tmp_path / "scene")]) == 2
        assert text in the_error(capsys)
        assert not (tmp_path / "scene").exists()


@pytest.mark.parametrize(
    ("name", "code"),
    [(b"xwr_driver/msg/AdcFrame", b"x/msg/A:\n pass\nimport o"), (b" samples\n", b" s=1;b()\n")],
)
def test_a_definition_with_code_in_its_names_is_refused(tmp_path, bag, name, code):
    """Rosbags makes classes of the definitions in a bag: names must be identifiers."""
    assert len(name) == len(code)
    data = next(bag.glob("*.mcap")).read_bytes()
    assert name in data
    (tmp_path / "code.mcap").write_bytes(data.replace(name, code))
    with pytest.raises(UserError, match=r"cannot be read: Could not parse"):
        opened(tmp_path / "code.mcap")


def test_a_missing_extra_is_one_line(tmp_path, bag, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(UserError, match=r"need rosbags; pip install 'geraf2\[ros\]'"):
        opened(bag)


def test_a_message_that_is_not_one_frame_is_refused(bag):
    radar = RADAR_MANIFEST.model_copy(update={"raw": RawManifest(n_rx=1, n_chirps_per_frame=2)})
    with pytest.raises(UserError, match="a message is not one frame, expected 512 bytes"):
        load_importer("rosbag").open(bag, radar, ImportOptions())
