"""`reconstruct --preset paper` from the command line, on a scene and settings of seconds."""

import json
import shutil

import numpy as np
import pytest

from geraf2 import _memory
from geraf2.cli.main import main
from geraf2.io.checkpoint import load_checkpoint
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import RunFolder
from geraf2.learned import glint_level, heatmaps
from geraf2.learned.checkpoints import KIND, VERSION
from geraf2.pipeline.stages import learned
from geraf2.scene import load_capture
from helpers.console import the_error
from helpers.small_scene import BOX

TINY = (
    "--preset paper --paper.n-cells 8 --paper.n-samples 10 --paper.n-antennas 16 "
    "--paper.n-clusters 1 --paper.n-looks 2 --paper.n-targets 64 "
    "--paper.stage1.n-steps 4 --paper.stage2.n-steps 4 --paper.grid-n 9 17 "
    "--paper.mesh-n 33 --paper.checkpoint-every 3 --no-report --calibrate no --trust-los"
)


def run(scene, out, *more):
    return main(["reconstruct", str(scene), str(out), *BOX, *TINY.split(), *more])


def contents(folder):
    return {path.relative_to(folder) for path in folder.rglob("*")}


def fields(folder):
    return load_checkpoint(folder / "fields.safetensors", kind=KIND, version=VERSION).arrays


@pytest.fixture(scope="module", autouse=True)
def coarse_maps():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(heatmaps, "COARSE_SPACING_M", 0.01)
        yield


@pytest.fixture(scope="module")
def paper_run(built_scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("paper") / "out"
    assert run(built_scene, out) == 0
    return out


def test_a_run_holds_fields_meshes_and_pictures(paper_run):
    for name in ("fields.safetensors", "sdf_fit.npz", "sdf.npz", "mesh.ply", "mesh_content.glb"):
        assert (paper_run / name).is_file()
    assert not (paper_run / "training").exists()
    content = read_mesh(paper_run / "mesh_content.ply")
    assert np.abs(content.vertices).max() < 0.1 - 0.012 + 1e-3
    assert set(RunFolder.read(paper_run).stages) == {"train", "mesh"}
    events = [json.loads(line) for line in (paper_run / "log.jsonl").read_text().splitlines()]
    last = [e for e in events if e["event"] == "training"][-1]
    assert (last["stage"], last["step"]) == (2, 8)


def test_the_corrected_form_reports_the_shift_of_the_level(built_scene, tmp_path):
    out = tmp_path / "out"
    assert run(built_scene, out, "--preset", "paper-corrected") == 0
    events = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    (reported,) = [e for e in events if e["event"] == "glint_level"]
    assert 0 < reported["glints"] <= 4 * len(load_capture(built_scene).poses)
    assert len(reported["outside_mm"]) == glint_level.N_ROUNDS
    assert reported["inward_mm"] <= sum(reported["outside_mm"]) + 1e-9


def test_interrupted_and_resumed_is_bit_identical(
    built_scene, paper_run, tmp_path, monkeypatch, capsys
):
    real = learned._Watcher.__call__

    def interrupted(watcher, step):
        real(watcher, step)
        if watcher._trainer.stages.steps_done == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(learned._Watcher, "__call__", interrupted)
    assert run(built_scene, tmp_path / "out") == 130
    assert "interrupted; OUT is as it was; a training continues" in the_error(capsys)
    assert run(built_scene, tmp_path / "out", "--overwrite") == 130  # from the start
    assert "interrupted" in the_error(capsys)
    left = {"checkpoint.safetensors", "log.jsonl"}
    assert {path.name for path in (tmp_path / "out" / "training").iterdir()} == left
    monkeypatch.setattr(learned._Watcher, "__call__", real)
    assert main(["verify", str(tmp_path / "out")]) == 2
    assert "holds a training that is not finished" in the_error(capsys)
    assert run(built_scene, tmp_path / "out") == 2
    assert "a training that --resume would finish" in the_error(capsys)
    assert run(built_scene, tmp_path / "out", "--resume") == 0
    assert contents(tmp_path / "out") == contents(paper_run)
    whole, parts = fields(paper_run), fields(tmp_path / "out")
    assert whole.keys() == parts.keys()
    for name, array in whole.items():
        np.testing.assert_array_equal(array, parts[name], err_msg=name)


def test_too_little_memory_is_reported_before_the_run(built_scene, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_memory, "available_memory_bytes", lambda: 100e6)
    assert run(built_scene, tmp_path / "out") == 2
    message = the_error(capsys)
    assert "the run will not fit into memory, expected about" in message
    assert "lower --paper.n-cells" in message
    assert not (tmp_path / "out").exists()


def test_planes_that_are_held_out_are_the_ones_rendered(built_scene, tmp_path, capsys):
    out = tmp_path / "out"
    more = ["--hold-out", "0", "40", "--paper.stage1.n-steps", "1", "--paper.stage2.n-steps", "0"]
    assert run(built_scene, out, *more) == 0
    assert main(["render", str(out), *RENDER]) == 0
    assert set(json.loads((out / "views" / "psnr.json").read_text())["psnr_db"]) == {"0", "40"}
    assert "(seen in training)" not in capsys.readouterr().out


RENDER = ["--n-draws", "1", "--spacing-m", "0.02"]


@pytest.mark.usefixtures("drawn")
def test_planes_are_rendered_beside_the_measured(paper_run, tmp_path, capsys):
    assert main(["render", str(paper_run), "--angles", "0", "40", *RENDER]) == 0
    text = capsys.readouterr().out
    assert "0 deg" in text
    assert "(seen in training)" in text
    record = json.loads((paper_run / "views" / "psnr.json").read_text())
    assert set(record["psnr_db"]) == {"0", "40"}
    with np.load(paper_run / "views" / "angle_040.0.npz") as view:
        error = np.mean((view["rendered"].astype(float) - view["measured"]) ** 2)
        psnr = 10 * np.log10(view["measured"].max() ** 2 / error)
    assert record["psnr_db"]["40"] == pytest.approx(psnr, abs=1e-3)
    for kind in ("measured", "rendered"):
        assert (paper_run / "views" / f"angle_000.0_{kind}.png").stat().st_size > 1000


def test_a_run_without_fields_is_not_rendered(paper_run, tmp_path, capsys):
    out = shutil.copytree(paper_run, tmp_path / "out")
    (out / "fields.safetensors").unlink()
    assert main(["render", str(out)]) == 2
    assert "the run has no fields.safetensors" in the_error(capsys)
