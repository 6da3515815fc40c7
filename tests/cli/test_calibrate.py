import json
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.cli.main import main
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.scene import load_capture, save_capture
from helpers.carton import PRIOR, SIDE_M, carton_capture, with_bias
from helpers.console import the_error
from helpers.folders import contents

PLAIN = ["--no-channels", "--no-positions"]


@pytest.fixture(scope="session")
def built_carton(tmp_path_factory):
    folder = tmp_path_factory.mktemp("carton") / "scene"

    def extras(inside):
        mesh = TriangleMesh(vertices=PRIOR.vertices, faces=PRIOR.faces)
        write_mesh(mesh, inside / "truth.ply", frame="capture")
        write_mesh(mesh, inside / "los.ply", frame="capture")

    save_capture(with_bias(carton_capture(n_poses=8), 0.0), folder, extras=extras)
    return folder


@pytest.fixture
def carton(built_carton, tmp_path):
    return shutil.copytree(built_carton, tmp_path / "carton")


def test_nothing_is_written_unasked(carton, capsys):
    before = contents(carton)
    assert main(["calibrate", str(carton), *PLAIN]) == 0
    assert contents(carton) == before
    shown = capsys.readouterr().out
    assert "instrument delay  0.0000 -> 0.1" in shown
    assert "nothing was written: give OUT, or SCENE twice" in shown


def test_a_box_that_nobody_states_is_found_by_radar(tmp_path, capsys):
    capture = replace(with_bias(carton_capture(n_poses=8), 0.0), walls=())
    save_capture(capture, tmp_path / "scene")
    assert main(["calibrate", str(tmp_path / "scene"), *PLAIN, "--no-frame", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["prior"] == "the box by radar"
    assert found["box"]["size_m"][:2] == pytest.approx(2 * [SIDE_M], abs=0.005)
    assert found["path_bias_m"] == pytest.approx(0.15, abs=5e-3)


def test_a_corrected_scene_records_its_corrections(carton, tmp_path, capsys):
    out = tmp_path / "corrected"
    assert main(["calibrate", str(carton), str(out), "--channels", "37"]) == 0
    capture = load_capture(out)
    table = tomllib.loads((out / "scene.toml").read_text())["calibration"][0]
    assert table["path_bias_before_m"] == 0.0
    assert table["path_bias_m"] == pytest.approx(0.15, abs=1e-3)
    assert table["path_bias_m"] == capture.waveform.path_bias_m
    assert 0.0 < table["path_bias_sigma_m"] < 2e-3
    assert table["delay_from"] == "walls"
    assert table["scene"] == "carton"
    assert table["prior"] == "los.ply"
    assert "prior_to_capture" not in table  # nothing was wrong with it
    assert read_mesh(out / "los.ply").vertices == pytest.approx(PRIOR.vertices, abs=1e-6)
    assert len(capture.calibration) == 1
    assert capture.calibration[0].path_bias_sigma_m == table["path_bias_sigma_m"]
    assert (out / "truth.ply").is_file()
    assert "->" in capsys.readouterr().out
    assert main(["info", str(out)]) == 0
    assert "calibrated" in capsys.readouterr().out
    # and a second calibration finds nothing more
    assert main(["calibrate", str(out), *PLAIN]) == 0
    again = capsys.readouterr().out.splitlines()[0]
    assert abs(float(again.split("->")[1].split()[0]) - table["path_bias_m"]) < 1e-3


def test_a_turned_box_is_moved_to_the_walls(carton, tmp_path):
    turn = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(2.5)])
    turned, out = turn.apply(PRIOR.vertices), tmp_path / "corrected"
    mesh = TriangleMesh(vertices=turned, faces=PRIOR.faces)
    write_mesh(mesh, carton / "los.ply", frame="capture")
    assert main(["calibrate", str(carton), str(out), *PLAIN]) == 0
    table = tomllib.loads((out / "scene.toml").read_text())["calibration"][0]
    assert table["prior_translation_sigma_m"][2] == pytest.approx(0.01, rel=0.01)
    matrix = np.array(table["prior_to_capture"])
    moved = read_mesh(out / "los.ply").vertices
    assert moved == pytest.approx(turned @ matrix[:3, :3].T + matrix[:3, 3], abs=1e-6)
    assert np.abs(moved - PRIOR.vertices).max() < 0.002


def test_write_corrects_the_scene_itself(carton):
    assert main(["calibrate", str(carton), str(carton), "--overwrite", *PLAIN, "--no-frame"]) == 0
    capture = load_capture(carton)
    assert capture.waveform.path_bias_m == pytest.approx(0.15, abs=1e-3)
    assert read_mesh(carton / "los.ply").vertices == pytest.approx(PRIOR.vertices, abs=1e-6)
    assert capture.calibration[0].prior_to_capture is None
    assert (carton / "truth.ply").is_file()
    # a second one is added to the record of the first
    again = ["calibrate", str(carton), str(carton), "--overwrite", *PLAIN, "--no-delay"]
    assert main(again) == 0
    first, second = load_capture(carton).calibration
    assert first == capture.calibration[0]
    delays = (first.path_bias_m, first.path_bias_m)
    assert second.delay_from == "kept"
    assert (second.path_bias_before_m, second.path_bias_m) == delays


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--no-delay", "--delay-search", "-0.1", "0.1"], "either --no-delay or --delay-search"),
        (["--no-delay", "--no-frame", *PLAIN], "nothing is left to search for"),
        (["--delay-search", "0.9", "1"], "walls of the box do not stand out"),
        (["--channels", "4", "--no-channels"], "give either --channels or --no-channels"),
        (["--channels", "4"], "--channels 4 does not divide the antennas of a plane"),
        (["--channels", "1369"], "has too few antennas in strong echoes"),
    ],
)
def test_bad_input_is_one_line(carton, capsys, arguments, message):
    assert main(["calibrate", str(carton), *arguments]) == 2
    assert message in the_error(capsys)
