"""Headers of packets and chirps, zeros at either end, recordings that begin in mid-chirp."""

import struct

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions
from geraf2.errors import UserError
from geraf2.io.manifest import RawManifest
from helpers.raw_capture import beat, opened, samples, words_of

LAYOUTS = ["4-lane", "2-lane-sequential", "2-lane-pairs", "iq"]
SYNCS = {
    "two lanes": [0x0ADC, 0x0ADC, 0x0CDA, 0x0CDA],
    "in the order of the chip": [0x0ADC, 0x0CDA, 0x0ADC, 0x0CDA],
}


def with_headers(words, n_chirps, sync):
    header = np.array([*sync, *range(28)], "<u2").astype("<i2")
    chirps = words.reshape(n_chirps, -1)
    return np.hstack([np.tile(header, (n_chirps, 1)), chirps]).tobytes()


@pytest.mark.parametrize(("layout", "sync"), [*zip(LAYOUTS, [*SYNCS] * 2, strict=True)])
def test_headers_of_chirps_are_removed(tmp_path, layout, sync):
    path = tmp_path / "a.bin"
    path.write_bytes(with_headers(words_of(beat(), layout), 40, SYNCS[sync]))
    recording = opened(path)
    assert np.array_equal(samples(recording), beat())
    assert "64 bytes before each 1024 were removed" in recording.notes


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("zero", ["first sample", "first receiver"])
def test_zeros_of_a_signal_are_no_padding(tmp_path, layout, zero):
    signal = beat()
    signal[(0, 0, 0) if zero == "first sample" else (slice(None), 0)] = 0
    (tmp_path / "a.bin").write_bytes(words_of(signal, layout).tobytes())
    recording = opened(tmp_path / "a.bin")
    assert np.array_equal(samples(recording), signal)
    assert not any("zero and were left out" in note for note in recording.notes)


def test_headers_at_irregular_distances_are_refused(tmp_path):
    data = with_headers(words_of(beat()), 40, SYNCS["two lanes"])
    (tmp_path / "a.bin").write_bytes(data[:5000] + data[5064:])
    with pytest.raises(UserError, match=r"irregular distances.*lvdsStreamCfg -1 0 1 0"):
        opened(tmp_path / "a.bin")


def test_a_header_that_is_missing_further_on_is_named(tmp_path):
    words = words_of(beat(n_chirps=1200))
    data = with_headers(words, 1200, SYNCS["two lanes"])
    (tmp_path / "a.bin").write_bytes(data[: 1088 * 1100] + data[1088 * 1100 + 100 :])
    with pytest.raises(UserError, match="chirp 1100 has no header"):
        opened(tmp_path / "a.bin", ImportOptions(keep_good=True))


def headed(data, kind, payload=1456):
    packets = []
    for number, at in enumerate(range(0, len(data), payload), start=1):
        body, count = data[at : at + payload], struct.pack("<Q", at)[:6]
        head = {
            "length before the count": struct.pack("<II", number, len(body)) + count,
            "four bytes behind it": struct.pack("<I", number) + count + b"\x07\0\0\x01",
        }[kind]
        packets.append(head + body)
    return packets


@pytest.mark.parametrize(
    ("kind", "lost"),
    [("length before the count", None), ("four bytes behind it", 0), ("four bytes behind it", 7)],
)
def test_packet_headers_of_14_bytes_are_removed(tmp_path, kind, lost):
    signal = beat(n_chirps=120)
    packets = headed(words_of(signal).tobytes(), kind)
    if lost is not None:
        del packets[lost]
    (tmp_path / "a.bin").write_bytes(b"".join(packets))
    recording = opened(tmp_path / "a.bin", n_samples=64)
    assert "headers of 14 bytes" in dict(recording.facts)["packets"]
    same = np.all(samples(recording) == signal, axis=(1, 2))
    assert same.sum() >= 117
    assert same.all() == (lost is None)


@pytest.mark.parametrize(
    ("layout", "n_zeros"), [*zip(LAYOUTS, [8, 1000, 70000, 3_000_008], strict=True)]
)
def test_zeros_at_the_start_are_left_out(tmp_path, layout, n_zeros):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(n_zeros) + words_of(beat(), layout).tobytes())
    recording = opened(path)
    assert np.array_equal(samples(recording), beat())
    assert f"the first {n_zeros} bytes of a.bin are zero and were left out" in recording.notes


def test_zeros_of_whole_frames_stay_since_time_continues(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(5 * 1024) + words_of(beat()).tobytes())
    recording = opened(path)
    assert np.array_equal(samples(recording)[5:], beat())
    assert any("5 frames in which nothing was recorded" in note for note in recording.notes)


def test_zeros_at_the_end_are_named(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(words_of(beat()).tobytes() + bytes(10 * 1024))
    (note,) = opened(path).notes
    assert "the last 10240 bytes are zero (10 of 50 chirps)" in note


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("n_samples", [None, 64])
def test_a_recording_that_begins_in_mid_chirp_is_refused(tmp_path, layout, n_samples):
    path = tmp_path / "a_Raw_1.bin"
    path.write_bytes(words_of(beat(), layout).tobytes()[16 * 20 :])
    late = 64 - 20 if layout != "2-lane-sequential" else 64 - 16
    with pytest.raises(UserError, match=rf"middle of a chirp: one of 64 samples .* {late}"):
        opened(path, n_samples=n_samples, raw=RawManifest(n_rx=4))
    if layout == "4-lane":
        path.write_bytes(path.read_bytes()[16 * late :])
        kept = opened(path, ImportOptions(keep_good=True), n_samples=n_samples)
        assert np.array_equal(samples(kept), beat()[1:])
