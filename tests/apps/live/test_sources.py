"""Planes over sockets and from recordings that grow, with what goes wrong in them."""

import socket
import stat
import struct
import threading
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, RecordingOptions, load_importer
from geraf2.apps.live.opening import open_source
from geraf2.errors import UserError
from geraf2.io.container import join_parts
from geraf2.io.manifest import AntennaManifest, RadarManifest, RawManifest
from geraf2.io.plane_stream import FrameReader, end_frame, plane_frame, scan_frame
from geraf2.scene.store import manifest_of
from helpers.raw_capture import RADAR
from helpers.ros_bag import PERIOD_S, at_times, frames_of, rewritten, scan_path, write_bag

RADAR_MANIFEST = RadarManifest(
    **RADAR,
    raw=RawManifest(n_rx=1, frame_period_s=PERIOD_S, start_time_s=0.25),
    antennas=AntennaManifest(rx_offsets_m=[[0.0, 0.0, 0.0]]),
)
GIVEN = RecordingOptions(clock_offset_ms=0.0)


def _about(capture):
    return manifest_of(replace(capture, poses=()))


def _polled(source, wanted, seconds=20.0):
    """What comes until there are as many as wanted."""
    found, end = [], time.monotonic() + seconds
    while len(found) < wanted and time.monotonic() < end:
        found += source.poll()
        time.sleep(0.01)
    return found


def _sent(path, *parts):
    """Send bytes over a connection of their own."""
    with socket.socket(socket.AF_UNIX) as peer:
        peer.connect(str(path))
        for part in parts:
            peer.sendall(part)


def _same(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("signal", "tx_positions", "rx_positions", "axes")
    )


def test_frames_may_come_in_any_portions(capture):
    pose = capture.poses[1]
    sent = scan_frame(_about(capture)) + plane_frame(pose) + end_frame()
    for size in (1, 999, len(sent)):
        reader, found = FrameReader("here"), []
        for at in range(0, len(sent), size):
            found += reader.feed(sent[at : at + size])
        assert not reader.is_within
        manifest, got, end = found
        assert manifest == _about(capture)
        assert _same(got, pose)
        assert (got.name, got.angle_deg, end) == (pose.name, pose.angle_deg, None)
        assert got.signal.dtype == np.complex64


def _framed(header):
    return b"GRF2" + struct.pack("<I", len(header)) + header


@pytest.mark.parametrize(
    ("sent", "text"),
    [
        (b"GET / HTTP/1.1\r\n", "does not begin with GRF2"),
        (b"GRF2\xff\xff\xff\xff", "has a header that is too large"),
        (_framed(b"{]"), "has a header that is no JSON"),
        (_framed(b"[]"), "has a header that is no object"),
        (_framed(b'{"scan": "no"}'), "here"),
        (_framed(b'{"n_samples": 8}'), "n_antennas"),
        (_framed(b'{"n_antennas": -1, "n_samples": 512}'), "n_antennas"),
        (_framed(b'{"n_antennas": 9999999, "n_samples": 60000}'), "is too large"),
    ],
)
def test_a_frame_that_is_none_is_one_line(sent, text):
    with pytest.raises(UserError, match=text) as error:
        list(FrameReader("here").feed(sent))
    assert "\n" not in str(error.value)


def test_a_socket_gives_planes_and_survives_bad_senders(capture, tmp_path):
    path, first = tmp_path / "arm", capture.poses[0]
    about, other = _about(capture), replace(capture.waveform, sample_rate_hz=1.0e6)
    senders = [
        ((b"hello",), "does not begin"),
        ((plane_frame(first),), "a plane came before its scan"),
        ((scan_frame(about), plane_frame(first)[:-1]), "ended within a plane"),
        ((scan_frame(about.model_copy(update={"waveform": other})),), "is of another radar"),
    ]
    with closing(open_source(f"unix:{path}")) as source:
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert list(source.poll()) == []
        for parts, text in senders:
            thread = threading.Thread(target=_sent, args=(path, *parts))
            thread.start()
            (bad,) = _polled(source, 1)
            thread.join()
            assert text in bad.problem
        assert not source.ending
        parts = [scan_frame(about), *map(plane_frame, capture.poses[:3]), end_frame()]
        thread = threading.Thread(target=_sent, args=(path, *parts))
        thread.start()
        found = _polled(source, 3)
        thread.join()
        assert all(_same(new.pose, own) for new, own in zip(found, capture.poses, strict=False))
        assert source.about.waveform == capture.waveform
        list(source.poll())
        assert source.ending == "the end of the scan was sent"
        with pytest.raises(UserError, match="is in use"):
            open_source(f"unix:{path}")
    assert not path.exists()


def test_a_socket_that_nobody_listens_at_is_replaced(tmp_path):
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "arm"))
    open_source(f"unix:{tmp_path / 'arm'}").close()
    (tmp_path / "file").write_text("mine")
    with pytest.raises(UserError, match="cannot be listened at"):
        open_source(f"unix:{tmp_path / 'file'}")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.fixture(scope="module")
def path():
    return scan_path(4, n_planes=3)


@pytest.fixture(scope="module")
def frames(path):
    return frames_of(path)


def _source(path, **options):
    return open_source(path, RADAR_MANIFEST, replace(GIVEN, **options))


def _again(source):
    source._next_s = 0.0  # without the pause between two reads
    return list(source.poll())


def _imported(name, source, **options):
    """Planes of an import, whose sign is that of the source."""
    scan = load_importer(name).open(source, RADAR_MANIFEST, ImportOptions(**options))
    planes, parts = [], list(scan.poses())
    for n_antennas in scan.n_antennas:
        own = []
        while sum(part.n_antennas for part in own) < n_antennas:
            own.append(parts.pop(0))
        planes.append(join_parts(own))
    return planes


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_a_whole_bag_gives_all_its_planes(tmp_path, path, frames, storage):
    bag = write_bag(tmp_path / "bag", path, frames, storage=storage)
    source = _source(bag)
    found = list(source.poll())
    assert source.ending == "the recording has ended"
    wanted = _imported("rosbag", bag, clock_offset_ms=0.0)
    assert len(found) == len(wanted) == 3
    for new, own in zip(found, wanted, strict=True):
        assert np.array_equal(new.pose.tx_positions, own.tx_positions)
        assert np.array_equal(new.pose.signal.real, own.signal[..., 0])


def test_planes_of_a_bag_that_grows_come_once_the_next_one_begins(tmp_path, path, frames):
    """Cut anywhere, also within a record; the file is what a recorder has written so far."""
    bag = write_bag(tmp_path / "bag", path, frames)
    data = rewritten(bag, tmp_path / "sorted", chunk_size=1 << 14).read_bytes()
    growing = tmp_path / "growing.mcap"
    growing.write_bytes(data[:3])
    source, counts = _source(growing), []
    for share in (0.0, 0.2, 0.45, 0.6, 0.8, 0.99):
        growing.write_bytes(data[: 3 + int(share * (len(data) - 3))])
        found = _again(source)
        assert not any(new.problem for new in found)
        counts.append(len(found))
        assert not source.ending
    assert sum(counts) == 2
    assert counts[:2] == [0, 0]
    growing.write_bytes(data)
    (last,) = _again(source)
    assert (last.name, source.ending) == ("2", "the recording has ended")


def test_a_bag_without_poses_is_one_line(tmp_path, path, frames):
    few = tuple(part[:50] for part in frames)
    source = _source(write_bag(tmp_path / "bag", path, few, poses=None))
    (bad,) = source.poll()
    assert "has no poses of the radar" in bad.problem
    assert "\n" not in bad.problem
    assert _again(source) == []


def test_a_file_of_a_dca1000_grows_with_its_positions(tmp_path, path, frames):
    _, words = frames
    data = np.concatenate([part.reshape(-1) for part in words]).astype("<i2").tobytes()
    stamps = np.arange(path[0][0], path[0][-1], 0.01)
    position, turns = at_times(path, stamps)
    cos, sin = np.cos(turns), np.sin(turns)
    x, y = cos * position[:, 0] - sin * position[:, 1], sin * position[:, 0] + cos * position[:, 1]
    zero = np.zeros_like(x)
    rows = np.stack(
        [stamps, x, y, position[:, 2], np.cos(turns / 2), zero, zero, np.sin(turns / 2)], axis=1
    )
    log, recording = tmp_path / "log.csv", tmp_path / "adc_data.bin"
    head = "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n"
    lines = [",".join(f"{value:.9g}" for value in row) + "\n" for row in rows]
    source, counts = _source(tmp_path, positions=log), []
    assert source is None  # nothing is there yet
    for share in (0.3, 0.6, 0.9, 1.0):
        log.write_text(head + "".join(lines[: int(share * len(lines))]))
        recording.write_bytes(data[: int(share * len(data))])
        source = source or _source(recording, positions=log)
        counts.append(len(_again(source)))
    assert sum(counts) == 2
    (last,) = source.poll(is_last=True)
    assert last.name == "2"
    wanted = _imported("dca1000", recording, positions=log, keep_good=True)
    assert len(wanted) == 3
    assert np.array_equal(last.pose.tx_positions, wanted[2].tx_positions)
