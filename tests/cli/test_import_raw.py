"""Raw captures from the command line, to an image; every fault is one line and exit code 2."""

import json

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.scene import load_capture
from helpers.raw_capture import (
    BOARD_RX,
    RADAR_TOML,
    TARGET,
    beat,
    packets_of,
    raster_positions,
    scan_signal,
    words_of,
)

STEP = 0.004
PERIOD = 0.01
BOARD = f"[antennas]\nrx_offsets_m = {BOARD_RX.tolist()}\n"


@pytest.fixture
def radar(tmp_path):
    path = tmp_path / "radar.toml"
    path.write_text(RADAR_TOML + f"[raw]\nframe_period_s = {PERIOD}\n" + BOARD)
    return path


@pytest.fixture
def places():
    return raster_positions(10, 12, STEP, serpentine=True)


@pytest.fixture
def recording(tmp_path, places):
    path = tmp_path / "adc_data.bin"
    path.write_bytes(words_of(scan_signal(places)).tobytes())
    return path


RASTER = ["--raster", "10", "12", str(STEP), str(STEP), "--serpentine"]


def run(recording, radar, *more):
    scene = recording.parent / "scene"
    return main(["import", "dca1000", str(recording), str(scene), "--radar", str(radar), *more])


def peak_of(tmp_path):
    box = ["--center-m", "0.35", "0", "0", "--size-m", "0.06", "0.06", "0.06"]
    arguments = [str(tmp_path / "scene"), str(tmp_path / "out"), *box, "--spacing-m", "0.002"]
    assert main(["image", *arguments]) == 0
    stored = np.load(tmp_path / "out" / "image.npz")
    index = np.unravel_index(stored["volume"].argmax(), stored["volume"].shape)
    return stored["origin_m"] + stored["spacing_m"] * np.array(index)


def test_a_raster_becomes_a_scene_that_focuses(tmp_path, recording, radar, places, capsys):
    assert run(recording, radar, *RASTER) == 0
    printed = capsys.readouterr().out
    assert "4-lane, two-complement" in printed
    assert "conjugated on import" in printed
    scene = load_capture(tmp_path / "scene")
    assert scene.poses[0].n_antennas == 480
    assert scene.provenance["layout"].startswith("4-lane, two-complement: energy")
    # A raw capture is kept as it is, half the bytes of complex numbers.
    metadata = json.loads((tmp_path / "scene" / "radar.zarr" / "signal" / "zarr.json").read_text())
    assert metadata["data_type"] == "int16"
    assert np.array_equal(scene.poses[0].signal, np.conj(scan_signal(places)).reshape(480, 64))
    assert np.abs(peak_of(tmp_path) - TARGET).max() <= 0.0021


def test_what_the_check_refuses_after_the_writing_leaves_no_scene(
    tmp_path, recording, radar, capsys
):
    recording.write_bytes(np.ones(recording.stat().st_size // 2, dtype="<i2").tobytes())
    order = 'layout = "4-lane"\noffset_binary = false\nn_rx = 4\n'
    text = radar.read_text().replace("[raw]\n", f"[raw]\n{order}")
    radar.write_text("n_samples = 64\n" + text)
    assert run(recording, radar, *RASTER) == 2
    assert "the signal is constant" in capsys.readouterr().err
    assert not [path for path in tmp_path.iterdir() if "scene" in path.name]


def test_a_robot_log_becomes_the_same_scene(tmp_path, recording, radar, places):
    # The way back between rows is not there in a serpentine; 4 mm in 10 ms is 0.4 m/s.
    assert run(recording, radar, *log_of(tmp_path, places)) == 0
    by_log = load_capture(tmp_path / "scene")
    assert run(recording, radar, *RASTER, "--overwrite") == 0
    by_raster = load_capture(tmp_path / "scene")
    assert np.allclose(by_log.poses[0].tx_positions, by_raster.poses[0].tx_positions, atol=1e-9)
    assert np.array_equal(by_log.poses[0].signal, by_raster.poses[0].signal)


def test_a_capture_at_one_place_can_be_looked_at(tmp_path, radar, capsys):
    path = tmp_path / "a.bin"
    path.write_bytes(words_of(beat(), "2-lane-pairs", offset_binary=True).tobytes())
    assert main(["info", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "2-lane-pairs, offset binary" in printed
    assert "40 chirps x 64 samples x 4 receivers" in printed
    # Three equal echoes at 3.3, 5.1 and 7.4 bins: the one nearest to a whole bin loses least.
    assert "bin 5 of 64" in printed
    assert run(path, radar, "--static") == 0
    assert main(["info", str(tmp_path / "scene")]) == 0
    assert "antennas                 4" in capsys.readouterr().out


def test_info_shows_a_broken_recording(tmp_path, capsys):
    path = tmp_path / "a.bin"
    path.write_bytes(words_of(beat()).tobytes()[:-7])
    assert main(["info", str(path)]) == 0
    assert "odd number of bytes" in capsys.readouterr().err


def log_of(folder, places):
    rows = np.column_stack([PERIOD * np.arange(len(places)), places])
    path = folder / "log.csv"
    np.savetxt(path, rows, delimiter=",", header="time_s,x_m,y_m,z_m", comments="")
    return ["--positions", str(path)]


def cut_short(recording, _):
    recording.write_bytes(recording.read_bytes()[:-100])
    return RASTER


def log_with_a_jump(recording, places):
    return log_of(recording.parent, places + np.eye(3)[0] * 0.3 * (np.arange(120) == 50)[:, None])


FAULTS = {
    "truncated last frame": (
        cut_short,
        "the last frame is cut short after 924 of 1024 bytes",
        119 * 4,
    ),
    "positions that jump": (log_with_a_jump, "positions jump by 0.3 m in 0.01 s", 120 * 4),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_one_line_and_the_good_part_is_kept(
    name, tmp_path, recording, radar, places, capsys
):
    prepare, text, n_kept = FAULTS[name]
    flags = prepare(recording, places)
    assert run(recording, radar, *flags) == 2
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("geraf2:")]
    assert len(lines) == 1
    assert text in lines[0]
    assert not (tmp_path / "scene").exists()
    assert "--keep-good" in lines[0]
    assert run(recording, radar, *flags, "--keep-good") == 0
    assert load_capture(tmp_path / "scene").poses[0].n_antennas == n_kept


def test_lost_packets_are_reported(tmp_path, recording, radar, capsys):
    packets = packets_of(recording.read_bytes())
    recording.write_bytes(b"".join(packets[:40] + packets[41:]))
    assert run(recording, radar, *RASTER) == 0
    captured = capsys.readouterr()
    assert "1 lost" in captured.out
    assert "1456 bytes zero-filled" in captured.err
    assert np.abs(peak_of(tmp_path) - TARGET).max() <= 0.0021


def test_a_folder_with_one_file_a_place_becomes_the_same_scene(tmp_path, radar, places, capsys):
    folder = tmp_path / "scan"
    folder.mkdir()
    signal = scan_signal(places)
    signal[:, 1] = 0
    for place, one in enumerate(signal):
        (folder / f"place_{place}.bin").write_bytes(words_of(one[None]).tobytes())
    assert main(["info", str(folder)]) == 2
    assert "holds more than one recording" in capsys.readouterr().err
    assert main(["info", str(folder), "--file-per-position"]) == 0
    printed = capsys.readouterr()
    assert "dead receivers     1 (its samples are constant)" in printed.out
    assert "receiver 1 is dead" in printed.err
    assert run(folder, radar, *RASTER, "--file-per-position") == 0
    scene = load_capture(tmp_path / "scene")
    assert np.array_equal(scene.poses[0].signal, np.conj(signal).reshape(480, 64))
    capsys.readouterr()
    assert main(["info", str(tmp_path / "scene")]) == 0
    assert "dead receivers" in capsys.readouterr().out
