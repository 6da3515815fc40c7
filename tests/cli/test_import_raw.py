"""Raw captures from the command line: scenes, what is left of broken ones, what `info` shows."""

import json

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.scene import load_capture
from helpers.console import the_error
from helpers.raw_capture import (
    BOARD_RX,
    RADAR_TOML,
    beat,
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
def positions():
    return raster_positions(10, 12, STEP, serpentine=True)


@pytest.fixture
def recording(tmp_path, positions):
    path = tmp_path / "adc_data.bin"
    path.write_bytes(words_of(scan_signal(positions)).tobytes())
    return path


RASTER = ["--raster", "10", "12", str(STEP), str(STEP), "--serpentine"]


def run(recording, radar, *more):
    scene = recording.parent / "scene"
    return main(["import", "dca1000", str(recording), str(scene), "--radar", str(radar), *more])


def test_a_raster_becomes_a_scene(tmp_path, recording, radar, positions, capsys):
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
    assert np.array_equal(scene.poses[0].signal, np.conj(scan_signal(positions)).reshape(480, 64))


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


def test_a_capture_at_one_position_can_be_inspected(tmp_path, radar, capsys):
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


def test_the_good_part_of_a_recording_is_kept(tmp_path, recording, radar, capsys):
    recording.write_bytes(recording.read_bytes()[:-100])
    assert run(recording, radar, *RASTER) == 2
    assert "--keep-good" in the_error(capsys)
    assert run(recording, radar, *RASTER, "--keep-good") == 0
    assert load_capture(tmp_path / "scene").poses[0].n_antennas == 119 * 4
