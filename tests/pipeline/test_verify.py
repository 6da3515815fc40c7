"""A folder knows whether it still holds what was written, of what, and works where it is moved."""

import json
import re
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import geraf2
from geraf2 import examples
from geraf2.cli._flags import parse
from geraf2.cli.main import main
from geraf2.cli.reconstruct import Config, defaults
from geraf2.errors import UserError
from geraf2.io.atomic import write_text_atomic
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.pipeline.commands.evaluate import evaluate
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.commands.verify import verify
from geraf2.pipeline.los_options import LosOptions
from geraf2.pipeline.presets import BestPreset, FastPreset
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.run_record import RunOptions, RunRecord
from geraf2.scene import save_capture
from geraf2.surfaces import FitConfig
from helpers.console import the_error
from helpers.small_scene import COARSE_RENDER

COARSE = FastPreset(fit=FitConfig(spacing_m=0.01))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A scene and its run, with the files of a report but no report."""
    folder = tmp_path_factory.mktemp("made")
    save_capture(examples.small_capture()[0], folder / "scene")
    main(["los", "x".join(map(str, examples.BOX_M)), str(folder / "los")])
    prior = folder / "los" / "los.ply"
    options = RunOptions(calibrate="no", trust_los=True)
    reconstruct(folder / "scene", prior, COARSE, folder / "run", options=options)
    return folder


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "made")


def flip(path, at=-1):
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("name", ["mesh_content.ply", "config.toml"])
def test_one_flipped_bit_of_a_run_is_found(folder, name, capsys):
    assert main(["verify", str(folder / "run")]) == 0
    flip(folder / "run" / name)
    assert main(["verify", str(folder / "run")]) == 2
    error = the_error(capsys)
    assert "1 of " in error
    assert error.endswith(f"files are not what was written, got {name} (changed)")
    (folder / "run" / name).unlink()
    with pytest.raises(UserError, match=rf"{name} \(missing\)"):
        verify(folder / "run")


def test_scores_of_another_mesh_are_found_and_foreign_files_listed(folder):
    (folder / "run" / "notes.txt").write_text("mine")
    assert verify(folder / "run").notes == ("not of the run: notes.txt",)
    (folder / "run" / "metrics.json").write_text('{"mesh_digest": "0"}')
    with pytest.raises(UserError, match=r"metrics.json: is not of the mesh_content.ply beside it"):
        verify(folder / "run")


@pytest.mark.parametrize("array", ["signal", "antenna_count"])
def test_one_flipped_bit_of_a_scene_is_found(folder, array, capsys):
    scene = folder / "scene"
    assert main(["verify", str(scene)]) == 0
    capsys.readouterr()
    chunk = next(p for p in (scene / "radar.zarr" / array / "c").rglob("*") if p.is_file())
    flip(chunk, 0)
    for command in (["info", str(scene)], ["verify", str(scene)]):
        assert main(command) == 2
        assert re.search(f"{array} of plane .* is not what was written", the_error(capsys))
    chunk.unlink()
    with pytest.raises(UserError, match=f"{array} of plane .* is not what was written"):
        verify(scene)


def test_a_scene_of_another_version_has_no_checksums(folder):
    path = folder / "scene" / "radar.zarr" / "zarr.json"
    content = json.loads(path.read_text())
    del content["attributes"]["checksums"]
    path.write_text(json.dumps(content))
    assert verify(folder / "scene").notes[0].startswith("it was written without checksums")


def test_a_prior_is_verified_and_another_folder_is_none(folder, tmp_path):
    assert verify(folder / "los").n_files == 3
    flip(folder / "los" / "los.npz")
    with pytest.raises(UserError, match=r"los.npz \(changed\)"):
        verify(folder / "los")
    with pytest.raises(UserError, match="is no run folder"):
        verify(tmp_path)


@pytest.mark.parametrize("name", ["run/mesh", "run/mesh_box", "run/mesh_content", "los/los"])
def test_a_mesh_states_its_origin(made, name):
    ply = made / f"{name}.ply"
    header = ply.read_bytes().split(b"end_header")[0].decode()
    sidecar = json.loads(Path(f"{ply}.json").read_text())
    made_from = sidecar["made_from"]
    for text in (geraf2.__version__, *(f"{key} {value}" for key, value in made_from.items())):
        assert f"comment geraf2 {text}\n" in header
    assert str(made) not in header + json.dumps(sidecar)
    if name == "los/los":
        assert made_from["command"] == "geraf2 los"
        assert made_from["key"] == json.loads((made / "los" / "los.json").read_text())["key"]
        return
    glb = (made / f"{name}.glb").read_bytes()
    length = struct.unpack("<I", glb[12:16])[0]
    asset = json.loads(glb[20 : 20 + length])["asset"]
    assert asset["extras"] == {"made_from": made_from}
    assert geraf2.__version__ in asset["generator"]
    record = json.loads((made / "run" / "run.json").read_text())
    assert made_from["scene"] == record["scene"]["digest"]
    assert made_from["command"] == (
        "geraf2 reconstruct scene OUT --los los.ply --preset fast --trust-los"
        " --calibrate no --fit.spacing-m 0.01"
    )


@pytest.mark.parametrize(
    "record",
    [
        RunRecord(prior=PriorSource(box=(0.1, 0.2, 0.3), box_center=(0.0, -0.01, 0.0))),
        RunRecord(
            prior=PriorSource(los=PriorSource().los),
            options=RunOptions(
                hold_out=(90.0, 180.0),
                seed=5,
                trust_los=True,
                samples=4,
                photos=LosOptions(unit="mm"),
            ),
            config=BestPreset(),
        ),
        RunRecord(prior=PriorSource(box=(0.1, 0.2, 0.3)), config=COARSE),
    ],
)
def test_the_command_of_a_run_repeats_it(record):
    words = record.command("scene").split()[2:]
    config = parse(Config, words, prog="geraf2 reconstruct", default=defaults(words))
    assert config.box == record.prior.box
    assert config.box_center == record.prior.box_center
    assert config.settings == record.config
    for name in ("hold_out", "calibrate", "trust_los", "seed", "samples", "photos"):
        assert getattr(config, name) == getattr(record.options, name)


def test_hostile_names_stay_one_line_of_a_header(tmp_path):
    mesh = TriangleMesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]]))
    write_mesh(mesh, tmp_path / "m.ply", made_from={"scene": "a\nend_header\n\x1b[31m é"})
    header = (tmp_path / "m.ply").read_bytes().split(b"\nend_header\n")[0]
    assert b"comment geraf2 scene a end_header ?[31m ?" in header.replace(b"\x1b", b"?")


def test_the_folder_is_consistent_at_every_moment_of_another_run(folder, monkeypatch):
    """After each file that comes or goes, a command that is stopped there could be verified."""
    run, looked = folder / "run", []

    def look():
        looked.append(verify(run).n_files)

    def unlink(path, missing_ok=False):
        there, _ = path.exists(), remove(path, missing_ok=missing_ok)
        if there and path.parent in (run, run / "figures") and not path.name.startswith("."):
            look()

    def draw(folder, **_):  # what a report leaves; pictures take seconds
        for name in ("report.html", "figures/errors.png"):
            write_text_atomic(folder / name, f"{len(looked)}")

    remove = Path.unlink
    monkeypatch.setattr("geraf2.report.write_report", draw)
    truth = examples.small_capture()[1]
    evaluate(run, truth, n_samples=200, report=False)
    monkeypatch.setattr("geraf2.io.atomic._count", look)
    monkeypatch.setattr(Path, "unlink", unlink)
    options = RunOptions(calibrate="no", trust_los=True)
    scene, prior = folder / "scene", folder / "los" / "los.ply"
    for n_samples in (300, 200):  # the second draws a report again, which the first drew
        evaluate(run, truth, n_samples=n_samples)
    finer = replace(COARSE, fit=replace(COARSE.fit, bending_weight=0.5))
    reconstruct(scene, prior, finer, run, options=options, overwrite=True)
    evaluate(run, truth, n_samples=200, report=False)
    assert len(looked) > 30
    assert verify(run).notes == ()


def test_a_folder_that_is_moved_with_its_scene_works_from_anywhere(
    made, folder, tmp_path, monkeypatch, capsys
):
    moved = tmp_path / "elsewhere" / "deep"
    moved.parent.mkdir()
    folder.rename(moved)
    config = moved / "run" / "config.toml"
    config.write_text(config.read_text().replace(str(made), "/gone"))
    monkeypatch.chdir("/")
    record = RunRecord.read(moved / "run" / "config.toml")
    assert record.scene == moved / "scene"
    assert record.prior.los == moved / "los" / "los.ply"
    render = ["render", str(moved / "run"), *COARSE_RENDER, "--angles", "60"]
    assert main(render) == 0
    (moved / "scene").rename(tmp_path / "far")  # the scene alone
    assert main(render) == 2
    stated = "the scene of the run is no longer there; name it with --scene; it was called 'scene'"
    assert stated in the_error(capsys)
    assert main([*render, "--scene", str(tmp_path / "far")]) == 0
