"""Raw captures: order of the words, frames, packets, configurations."""

import json
import tracemalloc

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, _recording, load_importer
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest, RasterManifest, RawManifest
from helpers.raw_capture import (
    BOARD_RX,
    PROFILE,
    RADAR,
    STUDIO,
    WAVEFORM,
    beat,
    opened,
    packets_of,
    raster_positions,
    samples,
    scan_signal,
    whole_pose,
    words_of,
    write_words,
)

GIVEN = RawManifest(layout="4-lane", offset_binary=False, n_rx=4)
ORDERS = [
    (layout, offset, swap)
    for layout in ("4-lane", "2-lane-pairs", "2-lane-sequential", "iq")
    for offset in (False, True)
    for swap in (False, True)
]


@pytest.mark.parametrize(("layout", "offset", "swap"), ORDERS)
def test_every_order_of_the_words_is_found_out(tmp_path, layout, offset, swap):
    signal = beat()
    path = write_words(tmp_path / "a.bin", signal, layout, offset_binary=offset, swap_iq=swap)
    recording = opened(path)
    order = recording.evidence.order
    assert (order.layout, order.offset_binary, order.swap_iq) == (layout, offset, swap)
    assert (order.n_rx, recording.evidence.n_samples, recording.n_frames) == (4, 64, 40)
    assert recording.evidence.energy_ratio > 1000
    assert np.array_equal(samples(recording), signal)


@pytest.mark.parametrize(
    ("radar", "text"),
    [
        ({"raw": RawManifest(layout="2-lane-pairs")}, "contradict the layout given"),
        ({"raw": RawManifest(offset_binary=True)}, "contradict the layout given"),
        ({"raw": RawManifest(n_tx=2, n_chirps_per_frame=3)}, "no multiple of n_tx"),
        ({"raw": RawManifest(layout="2-lane-pairs", n_rx=3)}, "2-lane-pairs needs an even n_rx"),
        ({"raw": RawManifest(layout="2-lane-sequential"), "n_samples": 63}, "needs an even number"),
        ({"n_samples": 2}, "too few samples per chirp, expected 8 or more, got 2"),
    ],
)
def test_what_contradicts_the_samples_or_no_board_does_is_refused(tmp_path, radar, text):
    with pytest.raises(UserError, match=text):
        opened(write_words(tmp_path / "a.bin", beat()), **radar)


def test_noise_has_no_layout(tmp_path):
    noise = np.random.default_rng(0).normal(scale=300, size=(40, 4, 64, 2)) @ [1, 1j]
    path = write_words(tmp_path / "a.bin", noise)
    with pytest.raises(UserError, match="the layout cannot be found out"):
        opened(path)
    assert opened(path, raw=GIVEN, n_samples=64).n_frames == 40
    tone = np.broadcast_to(900 * np.exp(2j * np.pi * 0.07 * np.arange(2560)), (1, 4, 2560))
    with pytest.raises(UserError, match="samples per chirp cannot be found out"):
        opened(write_words(path, tone))


@pytest.mark.parametrize(
    ("cut", "text", "n_frames"),
    [
        (1, "odd number of bytes", 39),
        (6, "last frame is cut short after 1018 of 1024 bytes", 39),
        (1024 + 512, "last frame is cut short after 512 of 1024 bytes", 38),
    ],
)
def test_what_is_cut_short_is_refused_or_left_out(tmp_path, cut, text, n_frames):
    path = write_words(tmp_path / "a.bin", beat())
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(UserError, match=text):
        opened(path)
    kept = opened(path, ImportOptions(keep_good=True))
    assert kept.n_frames == n_frames
    assert any("left out" in note for note in kept.notes)
    assert np.array_equal(samples(kept), beat()[:n_frames])


def test_parts_of_a_recording_are_one_stream(tmp_path):
    data = words_of(beat()).tobytes()
    for number, first in enumerate(range(0, len(data), 15001)):
        (tmp_path / f"adc_data_Raw_{number + 9}.bin").write_bytes(data[first : first + 15001])
    recording = opened(tmp_path)
    assert np.array_equal(samples(recording), beat())
    assert recording.notes == ()
    assert dict(recording.facts)["files"] == "3 parts, adc_data_Raw_9.bin to adc_data_Raw_11.bin"
    (tmp_path / "other_3.bin").write_bytes(data)
    with pytest.raises(UserError, match="more than one recording"):
        opened(tmp_path)


class TestPackets:
    data = words_of(beat()).tobytes()

    @staticmethod
    def write(tmp_path, packets):
        (tmp_path / "a.bin").write_bytes(b"".join(packets))
        return tmp_path / "a.bin"

    @pytest.mark.parametrize("payload", [1456, 46])
    def test_headers_are_removed(self, tmp_path, payload):
        recording = opened(self.write(tmp_path, packets_of(self.data, payload)))
        assert np.array_equal(samples(recording), beat())
        assert "0 lost" in dict(recording.facts)["packets"]
        assert recording.notes == ()

    def test_lost_packets_are_zero_and_reported(self, tmp_path):
        packets = packets_of(self.data)
        recording = opened(self.write(tmp_path, packets[:10] + packets[12:20] + packets[21:]))
        expected = bytearray(self.data)
        for lost in (10, 11, 20):
            expected[lost * 1456 : (lost + 1) * 1456] = bytes(1456)
        got = np.zeros(len(self.data), dtype=np.uint8)
        recording.stream.read_into(0, got)
        assert got.tobytes() == bytes(expected)
        assert "3 lost" in dict(recording.facts)["packets"]
        assert any(f"{3 * 1456} bytes zero-filled" in note for note in recording.notes)

    def test_reads_anywhere_agree_with_one_read(self, tmp_path):
        packets = packets_of(self.data)
        order = [0, 1, 3, 2, 4, 7, 8, *range(10, len(packets))]
        stream = opened(self.write(tmp_path, [packets[k] for k in order])).stream
        whole = np.zeros(stream.n_bytes, dtype=np.uint8)
        stream.read_into(0, whole)
        assert stream.n_bytes == len(self.data)
        for first, stop in [(1455, 1457), (4000, 12000), (30000, len(self.data))]:
            part = np.ones(stop - first, dtype=np.uint8)
            stream.read_into(first, part)
            assert np.array_equal(part, whole[first:stop])

    def test_a_broken_header_is_refused_or_ends_the_capture(self, tmp_path):
        packets = packets_of(self.data)
        packets[20] = b"\xff" * len(packets[20])
        path = self.write(tmp_path, packets)
        with pytest.raises(UserError, match=r"packet 20 of .* has a broken header"):
            opened(path)
        kept = opened(path, ImportOptions(keep_good=True))
        assert kept.n_frames == 20 * 1456 // 1024
        assert np.array_equal(samples(kept), beat()[: kept.n_frames])


class TestConfigurations:
    def test_studio_json_beside_the_recording_is_used(self, tmp_path):
        write_words(tmp_path / "adc_data.bin", beat())
        (tmp_path / "setup.mmwave.json").write_text(json.dumps(STUDIO))
        recording = opened(tmp_path)
        assert recording.config.first_sample_hz() == pytest.approx(77e9 + 60e12 * 6e-6)
        assert recording.config.frame_period_s == pytest.approx(4e-3)
        assert (recording.n_chirps_per_frame, recording.n_tx, recording.n_frames) == (2, 1, 20)

    def test_another_number_of_frames_is_refused_or_noted(self, tmp_path):
        write_words(tmp_path / "adc_data.bin", beat())
        text = json.dumps(STUDIO).replace('"numFrames": 20', '"numFrames": 30')
        (tmp_path / "setup.mmwave.json").write_text(text)
        with pytest.raises(UserError, match="states 30 frames, the file holds 20"):
            opened(tmp_path)
        kept = opened(tmp_path, ImportOptions(keep_good=True))
        assert any("states 30 frames" in note for note in kept.notes)

    def test_a_profile_defines_alternating_transmitters(self, tmp_path):
        (tmp_path / "radar.cfg").write_text(PROFILE)
        path = write_words(tmp_path / "a.bin", beat())
        recording = opened(path, ImportOptions(config=(tmp_path / "radar.cfg",)))
        assert (recording.n_tx, recording.n_chirps_per_frame, recording.n_frames) == (2, 20, 2)
        assert recording.config.first_sample_hz() == pytest.approx(77.36e9)
        assert recording.config.sample_rate_hz == pytest.approx(1e6)


class TestPositions:
    raster = RasterManifest(n_rows=4, n_columns=6, row_step_m=0.01, column_step_m=0.01)

    def scan(self, path, options=None, **radar):
        radar = RadarManifest(**{**RADAR, **radar})
        return load_importer("dca1000").open(path, radar, options or ImportOptions())

    @pytest.mark.parametrize(
        ("serpentine", "block"), [(False, 1 << 23), (True, 3000), (False, 100)]
    )
    def test_a_raster_is_filled_row_by_row(self, tmp_path, monkeypatch, serpentine, block):
        monkeypatch.setattr(_recording, "BLOCK_BYTES", block)
        positions = raster_positions(4, 6, 0.01, serpentine=serpentine)
        signal = scan_signal(positions)
        path = write_words(tmp_path / "a.bin", np.repeat(signal, 3, axis=0))
        raster = self.raster.model_copy(update={"serpentine": serpentine})
        antennas = {"rx_offsets_m": BOARD_RX.tolist()}
        scan = self.scan(path, raster=raster, antennas=antennas)
        got, tx, rx = whole_pose(scan)
        assert np.allclose(tx, np.repeat(positions, 4, axis=0), atol=1e-12)
        assert np.allclose(rx, (positions[:, None] + BOARD_RX).reshape(-1, 3), atol=1e-12)
        assert np.allclose(got, signal.reshape(-1, 64), rtol=1e-6)
        assert scan.phase_sign == 1
        assert scan.manifest.waveform.start_frequency_hz == pytest.approx(
            WAVEFORM.start_frequency_hz
        )

    def test_a_file_that_shrinks_while_it_is_read_is_named(self, tmp_path, monkeypatch):
        monkeypatch.setattr(_recording, "BLOCK_BYTES", 1100)
        path = write_words(tmp_path / "a.bin", scan_signal(raster_positions(4, 6, 0.01)))
        scan = self.scan(path, raster=self.raster)
        path.write_bytes(path.read_bytes()[:8000])
        with pytest.raises(UserError, match="became shorter while it was read"):
            whole_pose(scan)

    @pytest.mark.parametrize("n_antennas", [1, 20, 1000])
    def test_some_antennas_are_those_of_the_capture(self, tmp_path, n_antennas):
        signal = scan_signal(raster_positions(4, 6, 0.01))
        path = write_words(tmp_path / "a.bin", np.repeat(signal, 3, axis=0))
        scan = self.scan(path, raster=self.raster)
        whole, tx, rx = whole_pose(scan)
        (some,) = scan.thinned(n_antennas)
        rows = [int(np.flatnonzero((rx == one).all(axis=1)).item()) for one in some.rx_positions]
        assert len(set(rows)) == len(rows) == min(96, -(-n_antennas // 4) * 4)
        assert np.array_equal(tx[rows], some.tx_positions)
        assert np.allclose(whole[rows], some.signal, rtol=1e-6)

    def test_frames_that_do_not_fill_the_raster_are_refused_or_kept(self, tmp_path):
        path = write_words(tmp_path / "a.bin", scan_signal(raster_positions(4, 6, 0.01))[:-2])
        with pytest.raises(UserError, match="22 frames do not fill the raster, expected a mult"):
            self.scan(path, raster=self.raster)
        scan = self.scan(path, ImportOptions(keep_good=True), raster=self.raster)
        assert scan.n_antennas == (22 * 4,)

    def test_transmitters_take_turns_and_loops_are_averaged(self, tmp_path):
        signal = beat(n_chirps=48)
        tx = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.002], [0.0, 0.004, 0.0]]
        scan = self.scan(
            write_words(tmp_path / "a.bin", signal),
            ImportOptions(static=True),
            raw=RawManifest(n_tx=3, n_chirps_per_frame=6),
            antennas={"tx_offsets_m": tx, "rx_offsets_m": BOARD_RX.tolist()},
        )
        got, got_tx, got_rx = whole_pose(scan)
        assert np.allclose(
            got, signal.reshape(16, 3, 4, 64).mean(axis=0).reshape(12, 64), rtol=1e-5
        )
        assert np.allclose(got_tx, np.repeat(tx, 4, axis=0))
        assert np.allclose(got_rx, np.tile(BOARD_RX, (3, 1)))

    def test_memory_does_not_grow_with_the_file(self, tmp_path, monkeypatch):
        monkeypatch.setattr(_recording, "BLOCK_BYTES", 1 << 20)
        path = write_words(tmp_path / "a.bin", beat(n_chirps=600))
        with path.open("r+b") as handle:
            handle.truncate(128 << 20)  # sparse: the rest reads as zero
        raster = RasterManifest(n_rows=128, n_columns=1024, row_step_m=0.001, column_step_m=0.001)
        scan = self.scan(path, raster=raster)
        tracemalloc.start()
        n_antennas = sum(len(part.signal) for part in scan.poses())
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert n_antennas == 4 * 128 * 1024
        # Blocks decoded at once, each with its complex numbers; the file has 128 MB.
        assert peak < 20e6


@pytest.mark.data
class TestRealCaptures:
    def test_iwr1443_in_two_lanes(self, shared_data):
        recording = opened(shared_data / "dca1000" / "iwr1443_2lane.bin")
        evidence = recording.evidence
        assert str(evidence.order) == "2-lane-pairs, two-complement"
        assert evidence.energy_ratio > 1000
        assert evidence.next_ratio < 5
        assert (recording.n_frames, evidence.n_samples, evidence.order.n_rx) == (400, 256, 4)
        assert dict(recording.facts)["strongest echo"] == "bin 19 of 256"
        assert recording.notes == ()

    def test_awr1243_in_offset_binary_with_a_dead_receiver(self, shared_data):
        folder = shared_data / "dca1000"
        path = folder / "awr1243_offset_binary.bin"
        recording = opened(path)
        assert dict(recording.facts)["dead receivers"] == "1 (its samples are constant)"
        with pytest.raises(UserError, match="states 2 lanes"):
            opened(path, ImportOptions(config=(folder / "iwr1443_cf.json",)))
        evidence = recording.evidence
        assert str(evidence.order) == "iq, offset binary"
        assert evidence.energy_ratio > 20
        assert (recording.n_frames, evidence.n_samples, evidence.order.n_rx) == (256, 256, 4)

    def test_xwr16xx_with_strong_coupling(self, shared_data):
        path = shared_data / "dca1000" / "xwr16xx_coupling.bin"
        with pytest.raises(UserError, match="the last frame is cut short after 654 of 4096 bytes"):
            opened(path)
        recording = opened(path, ImportOptions(keep_good=True))
        evidence = recording.evidence
        assert str(evidence.order) == "2-lane-sequential, two-complement"
        assert evidence.energy_ratio > 20
        assert (recording.n_frames, evidence.n_samples, evidence.order.n_rx) == (1023, 256, 4)
        assert dict(recording.facts)["strongest echo"] == "bin 29 of 256"
        with pytest.raises(UserError, match="contradict the layout given"):
            opened(path, raw=RawManifest(layout="4-lane"))
