"""Reconstruction from the command line: results, faults, priors, scores."""

import errno
import json
import re
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.echoes import Glints
from geraf2.errors import UserError
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.mesh import Evidence, read_mesh
from geraf2.io.run_folder import RunFolder
from geraf2.pipeline.commands.evaluate import evaluate
from geraf2.pipeline.reconstruction import load_run
from geraf2.scene import load_capture, save_capture
from helpers.console import the_error
from helpers.folders import contents
from helpers.small_scene import BOX, FAST, QUICK_BEST

RESULTS = ("glints.npz", "sdf_fit.npz", "sdf.npz", "mesh.ply", "mesh_content.ply", "mesh.glb")


def run(scene, out, *more):
    # The report is drawn in the fixtures; here it would only take time.
    return main(["reconstruct", str(scene), str(out), *FAST, "--no-report", *more])


def test_a_run_holds_everything(built_run):
    for name in RESULTS:
        assert (built_run / name).is_file()
    content = read_mesh(built_run / "mesh_content.ply")
    assert (content.expected_error_m > 0).all()
    assert set(content.evidence) <= set(Evidence)
    assert np.abs(content.vertices).max() < 0.1
    assert "<img" in (built_run / "report.html").read_text()
    config = tomllib.loads((built_run / "config.toml").read_text())
    assert config["fit"]["spacing_m"] == 0.012
    assert (config["preset"], config["box"], config["seed"]) == ("fast", [0.2] * 3, 0)
    events = [json.loads(line) for line in (built_run / "log.jsonl").read_text().splitlines()]
    done = [e["stage"] for e in events if e["event"] == "done"]
    assert done == ["calibration", "glints", "sdf", "mesh", "verdict", "samples", "report"]
    assert events[-1]["event"] == "finished"
    assert [*RunFolder.read(built_run).stages] == ["box", *done]


def test_a_run_of_best_has_glints_and_outlines(built_scene, tmp_path):
    out, flags = tmp_path / "out", [*BOX, *QUICK_BEST, "--no-report", "--preset", "best"]
    assert main(["reconstruct", str(built_scene), str(out), *flags]) == 0
    stages = RunFolder.read(out).stages
    assert [*stages] == ["box", "calibration", "glints", "outlines", "sdf", "mesh", "verdict"]
    assert len(Glints.load(out / "glints.npz")) > 50
    assert stages["outlines"].numbers["outlines"] == len(Silhouettes.load(out / "silhouettes.npz"))
    assert read_mesh(out / "mesh_content.ply").expected_error_m.min() > 0
    config = tomllib.loads((out / "config.toml").read_text())
    assert config["preset"] == "best"
    assert config["refine"]["shadows"] is True


def test_samples_are_written_and_drawn_again(built_run):
    with np.load(built_run / "samples.npz") as stored:
        moves = stored["displacements_m"]
    content = read_mesh(built_run / "mesh_content.ply")
    assert moves.shape == (6, len(content.vertices))
    again = load_run(built_run).samples(6)
    np.testing.assert_array_equal(again.displacements_m, moves)
    assert again.mesh.expected_error_m == pytest.approx(content.expected_error_m)
    mesh = json.loads((built_run / "run.json").read_text())["stages"]["mesh"]["numbers"]
    low, high = mesh["volume_95_percent_cm3"]
    assert low < mesh["volume_cm3"] < high
    assert mesh["common_offset_sigma_mm"] > 0.0


def test_the_offset_that_calibration_leaves_open_is_part_of_every_sample(finished_run):
    record = json.loads((finished_run / "run.json").read_text())
    calibration = record["stages"]["calibration"]["numbers"]
    spreads = []
    for sigma_mm in (0.1, 4.0):
        calibration["common_offset_sigma_mm"] = sigma_mm
        (finished_run / "run.json").write_text(json.dumps(record))
        found = load_run(finished_run).samples(8)
        assert found.common_sigma_m == pytest.approx(1e-3 * sigma_mm)
        spreads.append(found.displacements_m.mean(axis=1).std())
    assert spreads[1] > spreads[0] + 2e-3
    with pytest.raises(UserError, match="samples must be at least 2"):
        load_run(finished_run).samples(1)


@pytest.mark.parametrize(
    ("step", "stop", "stated"),
    [
        ("fit_sdf", (KeyboardInterrupt(), 130), "interrupted; OUT is as it was"),
        ("extract_meshes", (OSError(errno.ENOSPC, "No space left"), 2), "the disk is full; OUT is"),
    ],
)
def test_what_stops_a_run_is_one_line_and_changes_nothing(
    step, stop, stated, built_scene, finished_run, monkeypatch, capsys
):
    (error, code), before = stop, contents(finished_run.parent)

    def stopped(*_, **__):
        raise error

    monkeypatch.setattr(f"geraf2.pipeline.stages.direct.{step}", stopped)
    known = [*BOX, "--trust-los"]
    other = [*known, "--overwrite", "--fit.bending-weight", "0.5"]
    assert run(built_scene, finished_run, *other) == code
    assert stated in the_error(capsys)
    assert run(built_scene, finished_run.parent / "new", *known) == code
    assert contents(finished_run.parent) == before
    assert [path.name for path in finished_run.parent.iterdir()] == ["finished"]


def test_a_box_can_be_trusted_against_the_echoes(scene, tmp_path, capsys):
    assert run(scene, tmp_path / "out", "--box", "0.14", "0.14", "0.14") == 2
    assert "the scan shows another box than the prior, expected sides of 140" in the_error(capsys)
    assert run(scene, tmp_path / "out", "--box", "0.14", "0.14", "0.14", "--trust-los") == 0


def test_without_a_prior_the_box_is_found(scene, tmp_path, capsys):
    manifest = scene / "scene.toml"
    text = manifest.read_text()
    manifest.write_text(text.replace("0.2,", "0.15,"))  # what the scene states of the box
    assert manifest.read_text() != text
    assert run(scene, tmp_path / "out") == 0
    assert "faces -x +x -y +y seen squarely" in capsys.readouterr().err
    box = load_run(tmp_path / "out").numbers["box"]
    np.testing.assert_allclose(box["size_m"][:2], 0.2, atol=2e-3)
    assert set(box["faces"]) == {"-x", "+x", "-y", "+y", "-z", "+z"}
    np.testing.assert_allclose(load_run(tmp_path / "out").prior.cuboid[1], box["size_m"], atol=1e-5)
    warned = RunFolder.read(tmp_path / "out").warnings
    assert any("states sides of 150 x 150 mm, which the scan contradicts" in x for x in warned)


def test_no_glint_is_an_error_with_what_was_seen(scene, tmp_path, capsys):
    capture = load_capture(scene)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(2, *capture.poses[0].signal.shape)).astype(np.float32)
    poses = tuple(replace(pose, signal=noise[0] + 1j * noise[1]) for pose in capture.poses)
    save_capture(replace(capture, poses=poses), tmp_path / "noise")
    # Without the checks of the box, which by chance find echoes of noise outside of it.
    assert run(tmp_path / "noise", tmp_path / "out", *BOX, "--trust-los") == 2
    assert "no glint inside the box" in the_error(capsys)


def test_evaluate_prints_scores_and_draws_the_report_if_asked(finished_run, scene, capsys):
    arguments = ["evaluate", str(finished_run), "--truth", str(scene / "truth.ply")]
    before = (finished_run / "report.html").read_bytes()
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "F1 5 mm" in text
    assert (finished_run / "report.html").read_bytes() == before
    assert main([*arguments, "--report"]) == 0
    text = capsys.readouterr().out
    metrics = json.loads((finished_run / "metrics.json").read_text())
    assert metrics["seed"] == 0
    assert metrics["n_samples"] == 10000
    size = metrics["size"]
    ratio, (x, y, z) = size["volume_ratio"], (1e3 * e for e in size["extent_errors_m"])
    offset = 1e3 * metrics["surface_bias_m"]
    assert re.search(rf"volume +{ratio:.3f} of the truth's", text)
    assert f"x {x:+.2f}, y {y:+.2f}, z {z:+.2f} mm" in text
    assert re.search(rf"offset +{re.escape(f'{offset:+.2f}')} mm along the normal", text)
    page = (finished_run / "report.html").read_text()
    f1 = {round(1e3 * score["threshold_m"]): score["f1"] for score in metrics["scores"]}
    assert f"{f1[2]:.4f}" in page
    assert f"<td>{x:+.2f} / {y:+.2f} / {z:+.2f}</td>" in page
    parts = metrics["by_sight"]
    assert [part["part"] for part in parts] == ["in sight", "out of sight"]
    assert sum(part["area_fraction"] for part in parts) == pytest.approx(1.0)
    assert parts[0]["scores"][1]["f1"] > parts[1]["scores"][1]["f1"]
    held = metrics["expected_error"]
    assert f"{100 * held['within_one']:.0f} % of the area within one sigma" in text
    assert metrics["mesh_digest"] == RunFolder.read(finished_run).files["mesh_content.ply"]


@pytest.fixture(scope="module")
def built_evaluation(built_run, built_scene, tmp_path_factory):
    out = shutil.copytree(built_run, tmp_path_factory.mktemp("evaluated") / "out")
    truth = ["--truth", str(built_scene / "truth.ply"), "--n-samples", "500"]
    assert main(["evaluate", str(out), *truth, "--report"]) == 0
    (out / "views").mkdir()  # as `render` leaves it
    for name in ("psnr.json", "angle_000.0.npz", "angle_000.0_rendered.png"):
        (out / "views" / name).write_text("of the first mesh")
    return out


@pytest.fixture
def evaluated_run(built_evaluation, tmp_path):
    return shutil.copytree(built_evaluation, tmp_path / "evaluated")


OF_THE_MESH = ("metrics.json", "views", "figures/errors.png", "figures/truth.npz")


def test_a_new_mesh_does_not_inherit_scores_or_pictures(evaluated_run, built_scene):
    assert all((evaluated_run / name).exists() for name in OF_THE_MESH)
    other = ["--fit.bending-weight", "0.5", "--overwrite"]
    assert main(["reconstruct", str(built_scene), str(evaluated_run), *BOX, *FAST, *other]) == 0
    assert not any((evaluated_run / name).exists() for name in OF_THE_MESH)
    page = (evaluated_run / "report.html").read_text()
    assert "F1 15 mm" not in page
    assert "the truth" not in page


def test_scores_and_pictures_of_an_unchanged_mesh_stay(evaluated_run, scene):
    names = ("metrics.json", "figures/errors.png", "figures/mesh.png", "figures/slices.png")
    before = [(evaluated_run / name).read_bytes() for name in names]
    same = [*BOX, *FAST, "--samples", "6"]
    assert main(["reconstruct", str(scene), str(evaluated_run), *same]) == 0
    assert [(evaluated_run / name).read_bytes() for name in names] == before
    assert (evaluated_run / "views" / "psnr.json").is_file()
    page = (evaluated_run / "report.html").read_text()
    assert "F1 15 mm" in page
    assert "beside the truth" in page
    assert "share of samples over the distance" in page


def test_evaluate_knows_planes_and_seed_without_the_scene(finished_run, scene, tmp_path):
    """The run folder holds where its antennas were; of planes that it left out nothing counts."""
    half, truth = tmp_path / "half", tmp_path / "gone" / "truth.ply"
    left_out = ["--hold-out", "0", "40", "80", "120", "160", "--seed", "7"]
    assert run(scene, half, *BOX, "--trust-los", *left_out) == 0
    scene.rename(tmp_path / "gone")
    few = {"n_samples": 500, "report": False}
    shares = [evaluate(f, truth, **few).by_sight[0].area_fraction for f in (finished_run, half)]
    assert 0.0 < shares[1] < shares[0]
    for seed, expected in ((None, 7), (3, 3)):
        assert evaluate(half, truth, **few, seed=seed).seed == expected
        assert json.loads((half / "metrics.json").read_text())["seed"] == expected
    (half / "planes.json").write_text('{"corners_m": [[1, 2]]}')
    with pytest.raises(UserError, match=r"planes.json: cannot be read as the planes of a run"):
        evaluate(half, truth, **few)
    (half / "planes.json").unlink()
    assert evaluate(half, truth, **few).by_sight == ()
