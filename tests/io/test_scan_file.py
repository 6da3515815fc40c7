"""Scan files: what is written is read, by the importer of raw recordings, too."""

import json
from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.apps.importers._board import Board
from geraf2.apps.importers._robot_log import read_log
from geraf2.apps.importers._tracks import log_track, planes_of
from geraf2.errors import UserError
from geraf2.io.manifest import AntennaManifest, RadarManifest, RawManifest
from geraf2.io.scan_file import (
    ScanFile,
    ScanLine,
    SweptArray,
    SweptPlane,
    read_scan_file,
    write_scan_file,
)
from helpers.raw_capture import BOARD_RX, echo, words_of

LOOKS_X = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
LOOKS_Y = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
PERIOD_S = 0.01


def line(start, end, start_s, n_positions=9, **more):
    return ScanLine(
        start_m=start,
        end_m=end,
        n_positions=n_positions,
        start_s=start_s,
        speed_m_per_s=0.5,
        **more,
    )


SCAN = ScanFile(
    planes=(
        SweptPlane(
            name="x",
            axes=LOOKS_X,
            lines=(
                line((0.0, -0.02, -0.01), (0.0, 0.02, -0.01), 0.0),
                line((0.0, 0.02, 0.01), (0.0, -0.02, 0.01), 0.1),
            ),
        ),
        SweptPlane(
            name="y", axes=LOOKS_Y, lines=(line((0.33, -0.34, 0.0), (0.37, -0.34, 0.0), 0.3),)
        ),
    ),
    array=SweptArray(
        tx_offsets_m=((0.0, 0.0, 0.0),),
        rx_offsets_m=tuple(map(tuple, BOARD_RX.tolist())),
        chirp_s=PERIOD_S,
    ),
    spacing_m=0.005,
)


def test_a_scan_file_is_read_as_it_was_written(tmp_path):
    write_scan_file(tmp_path / "scan.json", SCAN)
    assert read_scan_file(tmp_path / "scan.json") == SCAN
    assert SCAN.seconds == pytest.approx(0.38)
    assert SCAN.n_antennas == 27 * 4


def test_a_robot_reads_the_same_positions_turns_and_times_in_csv(tmp_path):
    for name in ("scan.csv", "scan.json"):
        write_scan_file(tmp_path / name, SCAN)
    text, plan = (read_log(tmp_path / n, keep_good=False) for n in ("scan.csv", "scan.json"))
    assert text.times_s == pytest.approx(plan.times_s)
    assert text.positions == pytest.approx(plan.positions)
    assert text.quaternions == pytest.approx(plan.quaternions)
    assert text.rotations_at(np.array([0.34])).as_matrix()[0] == pytest.approx(np.array(LOOKS_Y).T)


def test_transmitters_that_take_turns_send_from_where_the_arm_is_then():
    array = SweptArray(
        tx_offsets_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.01)), rx_offsets_m=((0.0, 0.0, 0.0),)
    )
    scan = replace(SCAN, planes=SCAN.planes[:1], array=array)
    tx, rx = scan.antennas(scan.planes[0])
    at = scan.planes[0].lines[0].positions_m
    late_m = 0.5 * 0.5e-3  # half a chirp of 1 ms, at 0.5 m/s along +y
    assert tx[:2] == pytest.approx(at[0] + np.array([[0, -late_m, 0], [0, late_m, 0.01]]))
    assert rx[:2] == pytest.approx(at[0] + np.array([[0, -late_m, 0], [0, late_m, 0]]))
    for still in (
        replace(scan, motion="stop-and-go"),
        replace(scan, array=replace(array, order="ddm")),
    ):
        tx, rx = still.antennas(still.planes[0])
        assert rx[:18] == pytest.approx(np.repeat(at, 2, axis=0))


def test_a_recording_takes_the_position_of_each_transmitter(tmp_path):
    array = SweptArray(
        tx_offsets_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.01)), rx_offsets_m=SCAN.array.rx_offsets_m
    )
    write_scan_file(tmp_path / "scan.json", replace(SCAN, array=array))
    log = read_log(tmp_path / "scan.json", keep_good=False)
    about = {"frame_period_s": PERIOD_S, "start_time_s": 0.0, "keep_good": False}
    track = log_track(log, 39, **about)
    board = Board(
        tx_offsets=np.array(array.tx_offsets_m),
        rx_offsets=np.array(array.rx_offsets_m),
        axes=np.eye(3),
    )
    for plane, own in zip(SCAN.planes, planes_of(track), strict=True):
        parts = [board.antennas(own.tx_positions[slice(*r)], own.at(*r)[1]) for r in own.ranges]
        for found, expected in zip(zip(*parts, strict=True), log.scan.antennas(plane), strict=True):
            assert np.concatenate(found) == pytest.approx(expected, abs=1e-9)


def test_a_recording_along_a_scan_file_becomes_its_planes(tmp_path):
    n_frames = 39  # of which those between the lines are of no use
    frames = np.arange(n_frames)
    tx, rx = np.zeros((n_frames * 4, 3)), np.zeros((n_frames * 4, 3))
    for plane in SCAN.planes:
        for track in plane.lines:
            at = np.round(track.times_s / PERIOD_S).astype(int)
            assert np.isin(at, frames).all()
            tx[4 * at[:, None] + np.arange(4)] = track.positions_m[:, None]
            rx[4 * at[:, None] + np.arange(4)] = track.positions_m[:, None] + BOARD_RX @ np.array(
                plane.axes
            )
    signal = echo(tx, rx).reshape(n_frames, 4, -1)
    (tmp_path / "a.bin").write_bytes(words_of(signal).tobytes())
    write_scan_file(tmp_path / "scan.json", SCAN)
    radar = RadarManifest(
        start_frequency_hz=77.36e9,
        chirp_slope_hz_per_s=60e12,
        sample_rate_hz=1e6,
        path_bias_m=0.15,
        raw=RawManifest(frame_period_s=PERIOD_S, n_chirps_per_frame=1),
    )
    options = ImportOptions(positions=tmp_path / "scan.json")
    scan = load_importer("dca1000").open(tmp_path / "a.bin", radar, options)
    assert scan.n_antennas == (72, 36)
    poses = list(scan.poses())
    pieces = {
        name: [p for p in poses if p.axes == pytest.approx(np.array(axes))]
        for name, axes in (("x", LOOKS_X), ("y", LOOKS_Y))
    }
    for plane in SCAN.planes:
        own = pieces[plane.name]
        for found, expected in zip(
            ("tx_positions", "rx_positions"), SCAN.antennas(plane), strict=True
        ):
            joined = np.concatenate([getattr(pose, found) for pose in own])
            assert joined == pytest.approx(expected, abs=1e-9)
    assert any("12 of 39 frames lie between the lines" in note for note in scan.notes)
    far = [[*offset[:2], offset[2] + 0.002] for offset in BOARD_RX.tolist()]
    elsewhere = radar.model_copy(update={"antennas": AntennaManifest(rx_offsets_m=far)})
    with pytest.raises(UserError, match="contradict those of radar, expected rx_offsets_m with"):
        load_importer("dca1000").open(tmp_path / "a.bin", elsewhere, options)
    two = replace(SCAN, array=replace(SCAN.array, rx_offsets_m=SCAN.array.rx_offsets_m[:2]))
    write_scan_file(tmp_path / "scan.json", two)
    with pytest.raises(UserError, match="contradicts the recording, expected 1 transmitters and 2"):
        load_importer("dca1000").open(tmp_path / "a.bin", radar, options)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.update(format="other"), 'is no scan file, expected "format": "geraf2-scan"'),
        (lambda t: t.update(speed=1), "unknown key 'speed'"),
        (lambda t: t["planes"][0]["lines"][1].update(start_s=0.05), "time stamps go back at pl"),
        (
            lambda t: t["planes"][0]["lines"][1].update(phase_reference="second"),
            "sweeps of plane 'x' overlap with different phase references, got '' and 'second'",
        ),
        (lambda t: t["planes"][1].update(axes=[[1, 0, 0]] * 3), "orthonormal, right-handed"),
        (lambda t: t.update(planes=[]), "planes"),
    ],
)
def test_a_broken_scan_file_is_one_line(tmp_path, change, message):
    path = tmp_path / "scan.json"
    write_scan_file(path, SCAN)
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))
    with pytest.raises(UserError) as error:
        read_scan_file(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
