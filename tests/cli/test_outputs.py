"""One rule for what lies in OUT: nothing finished is replaced without --overwrite."""

import json

import numpy as np
import pytest

from geraf2.apps.photos import los
from geraf2.cli.main import main
from geraf2.io.run_folder import RunFolder
from geraf2.surfaces.extraction import extract_meshes
from helpers.console import the_error
from helpers.folders import contents
from helpers.small_scene import BOX, FAST, SPEC


@pytest.mark.parametrize(
    "flags",
    [
        [*BOX, *FAST, "--fit.bending-weight", "0.5"],
        ["--box", "0.21", "0.21", "0.21", *FAST],
    ],
)
def test_a_finished_mesh_is_replaced_only_on_request(built_run, built_scene, flags, capsys):
    before = contents(built_run)
    assert main(["reconstruct", str(built_scene), str(built_run), *flags]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert f"{built_run}: holds a finished mesh of other settings" in error
    assert error.endswith("choose another folder, or pass --overwrite to replace it")
    assert contents(built_run) == before


def test_the_run_of_another_scene_goes_whole_and_nothing_else(finished_run, tmp_path, capsys):
    (tmp_path / "spec.toml").write_text(SPEC.replace("n_poses = 9", "n_poses = 5"))
    other = str(tmp_path / "other")
    assert main(["simulate", str(tmp_path / "spec.toml"), other]) == 0
    (finished_run / "notes.txt").write_text("mine")
    image = ["image", other, str(finished_run), "--spacing-m", "0.02", "--plane", "0"]
    for command in (image, ["reconstruct", other, str(finished_run), "--preset", "fast"]):
        assert main(command) == 2
        printed = capsys.readouterr().err
        assert "holds the run of another scene ('scene')" in printed
        assert "finding the box" not in printed
    assert main([*image, "--overwrite"]) == 0
    left = {str(p.relative_to(finished_run)) for p in finished_run.rglob("*") if p.is_file()}
    images = {"image.npz", "image.json", "figures/projections.png"}
    assert left == {"notes.txt", "run.json", "log.jsonl", *images}
    assert set(RunFolder.read(finished_run).stages) == {"image"}
    assert main(image) == 0  # the same again
    assert main([*image[:-1], "1"]) == 2
    assert "holds a finished image of other settings" in the_error(capsys)


def test_a_scene_that_would_be_refused_is_refused_before_the_work(
    built_scene, tmp_path, capsys, monkeypatch
):
    def forbidden(*_, **__):
        pytest.fail("the work was done first")

    (tmp_path / "spec.toml").write_text(SPEC)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "diary.txt").write_text("mine")
    for module in ("commands.simulate.simulate", "commands.calibrate.calibrate_capture"):
        monkeypatch.setattr(f"geraf2.pipeline.{module}", forbidden)
    before = contents(built_scene)
    for command in (
        ["simulate", str(tmp_path / "spec.toml"), str(built_scene), "--seed", "1"],
        ["calibrate", str(built_scene), str(built_scene)],
    ):
        assert main(command) == 2
        assert "holds another scene; choose another folder, or pass" in the_error(capsys)
        assert main([*command[:2], str(tmp_path / "mine")]) == 2
        assert "holds files but no scene of geraf2" in the_error(capsys)
        assert main([*command[:2], "/proc/scene"]) == 2
        assert "/proc: cannot be written to" in the_error(capsys)
    assert contents(built_scene) == before


def test_a_finished_prior_is_replaced_only_on_request(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(los, "_N_LONGEST", 32)
    out = tmp_path / "los"
    assert main(["los", "0.2x0.2x0.2", str(out)]) == 0
    before = contents(out)
    assert main(["los", "0.3x0.2x0.2", str(out)]) == 2
    assert "holds a finished prior of '0.2x0.2x0.2'" in the_error(capsys)
    assert contents(out) == before
    assert main(["los", "0.2x0.2x0.2", str(out)]) == 0
    assert main(["los", "0.3x0.2x0.2", str(out), "--overwrite"]) == 0
    assert json.loads((out / "los.json").read_text())["source"] == "0.3x0.2x0.2"
    (out / "los.json").unlink()  # as a kill before the record leaves it
    assert main(["los", "0.2x0.2x0.2", str(out)]) == 0


def test_no_content_is_an_error_that_keeps_the_old_mesh(
    finished_run, built_scene, capsys, monkeypatch
):
    def without_content(*arguments, **options):
        found = extract_meshes(*arguments, **options)
        content = found.mesh_content.with_faces(np.empty((0, 3), dtype=np.int64))
        return found._replace(mesh_content=content)

    monkeypatch.setattr("geraf2.pipeline.stages.direct.extract_meshes", without_content)
    before = contents(finished_run)
    flags = [*BOX, *FAST, "--fit.bending-weight", "0.5", "--trust-los", "--overwrite"]
    assert main(["reconstruct", str(built_scene), str(finished_run), *flags]) == 2
    assert "no surface was found inside the box" in the_error(capsys)
    assert contents(finished_run) == before


def test_a_record_that_names_files_elsewhere_is_refused(finished_run, built_scene, capsys):
    record = json.loads((finished_run / "run.json").read_text())
    for file in ("../mine.txt", "/mine.txt", "figures/../../mine.txt"):
        record["files"] = {file: "0"}
        (finished_run / "run.json").write_text(json.dumps(record))
        assert main(["reconstruct", str(built_scene), str(finished_run), *BOX, "--overwrite"]) == 2
        assert "cannot be read as the record of a run" in the_error(capsys)
