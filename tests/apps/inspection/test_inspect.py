"""`geraf2 inspect` on the run of a small scan: answers, files, exit codes, bad input."""

import csv
import json
import shutil
from contextlib import nullcontext

import numpy as np
import pytest
import trimesh

import geraf2
from geraf2.cli.main import main
from geraf2.geometry.transforms import apply_rigid
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.pipeline.commands.verify import verify
from geraf2.pipeline.events import Listener
from helpers.inspected import POSE, SMALL, block, few_starts, run_of, wedge


@pytest.fixture(autouse=True)
def quick_search():
    with few_starts():
        yield


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A wedge, and a block beside it."""
    return run_of(tmp_path_factory.mktemp("inspected") / "run", wedge(), SMALL)


@pytest.fixture(scope="module")
def cad(tmp_path_factory):
    """The wedge in millimetres, turned and shifted."""
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    path = tmp_path_factory.mktemp("cad") / "wedge.stl"
    trimesh.Trimesh(1e3 * wedge().vertices @ turn.T + 7.0, wedge().faces).export(path)
    return path


def glb_colours(path):
    """Colours of the vertices of a GLB, (n, 4)."""
    data = path.read_bytes()
    n = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + n])
    index = document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    view = document["bufferViews"][document["accessors"][index]["bufferView"]]
    start = 28 + n + view["byteOffset"]
    return np.frombuffer(data[start : start + view["byteLength"]], np.uint8).reshape(-1, 4)


def test_parts_alone_pass_and_the_expected_number_counts(run, capsys):
    assert main(["inspect", str(run), "--expect", "2"]) == 0
    shown = capsys.readouterr().out
    assert "part 1" in shown
    assert "result   pass" in shown
    assert main(["inspect", str(run), "--expect", "3"]) == 3
    assert "fails: 2 parts were found, 3 were expected" in capsys.readouterr().out
    assert verify(run).kind == "run"


def test_a_flat_body_beside_another_is_one_part(tmp_path):
    """Connected pieces count, whatever the echoes around them suggest."""
    flat = block((0.05, 0.04, 0.006), (-0.03, 0.0, 0.0))
    run = run_of(tmp_path / "run", flat, SMALL, has_glints=True)
    found = geraf2.inspect(run, expect=2, write=False)
    assert (found.verdict, len(found.parts), found.notes) == ("pass", 2, ())


def test_a_model_is_found_and_files_give_its_pose(run, cad, tmp_path, capsys):
    out = tmp_path / "answer"
    assert main(["inspect", str(run), "--cad", str(cad), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "model 'wedge': present" in shown
    assert "± holds 95 %" in shown
    assert "size by CAD" in shown
    assert "note: poses rest on the run alone, not on its scan" in shown
    found = json.loads((out / "inspection.json").read_text())
    (model,) = found["models"]
    assert (found["verdict"], model["name"], model["status"]) == ("pass", "wedge", "present")
    assert found["uncertainty"].startswith("sigma is one standard deviation")
    assert len(found["parts"][0]["extents_m"]) == len(model["lengths_m"]) == 3
    assert (model["unit"], model["part"], model["regions"]) == ("mm", 1, [])
    corner = np.array([0.007, 0.007, 0.007])  # of the model's frame, where the wedge has its middle
    assert apply_rigid(np.array(model["pose"]), corner) == pytest.approx(POSE[:3, 3], abs=5e-4)
    # Of the volume, as that of the part; the mean of the surface lies 0.5 mm away.
    center = apply_rigid(POSE, trimesh.Trimesh(wedge().vertices, wedge().faces).center_mass)
    assert model["center_m"] == pytest.approx(center, abs=2e-4)
    assert found["parts"][0]["center_m"] == pytest.approx(center, abs=2e-4)
    assert 0.0 < max(model["center_sigma_m"]) < 1e-3
    rows = list(csv.DictReader((out / "inspection.csv").read_text().splitlines()))
    assert rows[-1]["status"] == "pass"
    assert sum(r["kind"] == "model" and "turn" in r["quantity"] for r in rows) == 3
    colours, count = np.unique(glb_colours(out / "inspection.glb"), axis=0, return_counts=True)
    assert len(colours) == 2  # of both parts
    assert count.min() >= 8
    page = (out / "inspection.html").read_text()
    assert len(page) < 3e6
    assert "Pass: 2 parts, 1 of 1 models present." in page
    assert '"label":"CAD models"' in page


def test_another_part_and_a_missing_one_fail(run):
    models = [wedge(), block((0.04, 0.04, 0.003)), block((0.1, 0.08, 0.06))]
    found = geraf2.inspect(run, models, write=False)
    assert found.verdict == "fail"
    assert [r.match.status for r in found.models] == ["present", "wrong part", "missing"]
    assert "3 models, but only 2 parts in the box" in found.notes
    assert found.failures[0].startswith("'model 2' is swapped: part 2 is there instead, ")
    assert found.failures[1:] == ("'model 3' is missing",)


def test_models_at_the_poses_of_each_other_are_swapped(tmp_path):
    parts = block((0.02, 0.015, 0.03), (0.07, 0.0, 0.0)), block((0.03, 0.02, 0.012))
    run = run_of(tmp_path / "run", *parts, pose=np.eye(4))
    models = [block((0.02, 0.015, 0.03)), block((0.03, 0.02, 0.012), (0.07, 0.0, 0.0))]
    options = geraf2.InspectOptions(placed=True)
    found = geraf2.inspect(run, models, options=options, write=False)
    assert found.failures == ("'model 1' and 'model 2' are swapped",)


def test_faults_are_sentences_and_the_page_gives_the_reason(run, cad, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["inspect", str(run), "--cad", str(cad), "--placed", "--out", str(out)]) == 3
    shown = capsys.readouterr().out
    assert "fails: 'wedge' is turned against its nominal pose" in shown
    page = (out / "inspection.html").read_text()
    assert "Fail: 2 parts, 0 of 1 models present, but &#39;wedge&#39;" in page


def test_without_anything_required_nothing_is_judged(run, tmp_path, capsys):
    assert main(["inspect", str(run), "--out", str(tmp_path / "out")]) == 0
    assert "result   not judged: nothing was required" in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "inspection.json").read_text())
    assert (found["verdict"], found["failures"]) == ("not judged", [])


class Steps(Listener):
    """Fractions that each step reports."""

    def __init__(self):
        self.fractions = {}

    def step(self, label):
        return nullcontext(self.fractions.setdefault(label, []).append)


@pytest.mark.parametrize("any_of", [True, False])
def test_the_search_reports_its_progress_after_each_model(tmp_path, any_of):
    sides = [(0.02, 0.02, 0.01 + 0.001 * n) for n in range(3)]
    run = run_of(tmp_path / "run", block(sides[2]))
    listener, options = Steps(), geraf2.InspectOptions(any_of=any_of)
    models = [block(s) for s in sides]
    geraf2.inspect(run, models, options=options, write=False, listener=listener)
    fractions = listener.fractions
    assert fractions["finding the models"][:3] == pytest.approx([1 / 3, 2 / 3, 1])
    assert len(fractions["comparing surfaces"]) == (1 if any_of else 3)
    search = fractions.get("separating connected parts", [])
    assert bool(search) is not any_of
    assert search == sorted(set(search))
    assert max(search, default=0.5) <= 1.0


@pytest.mark.parametrize(
    ("path", "flags", "text"),
    [
        ("no_run", [], "is no run folder"),
        ("no_run/file", [], "is no run folder"),
        ("empty", [], "the mesh has no triangles"),
        ("run", ["--cad", "none.stl"], "does not exist"),
        ("run", ["--cad", "wedge.stl", "wedge.stl"], "the same CAD file is given twice"),
        ("run", ["--cad", "wedge.stl", "--scene", "none"], "none: no such scene"),
        ("run", ["--scene", "none"], "none: no such scene"),
    ],
)
def test_bad_input_is_one_line(run, cad, tmp_path, capsys, monkeypatch, path, flags, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "no_run").mkdir()
    (tmp_path / "no_run" / "file").write_text("no folder")
    (tmp_path / "run").symlink_to(run)
    shutil.copy(cad, tmp_path / "wedge.stl")
    shutil.copytree(run, tmp_path / "empty")
    nothing = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    write_mesh(nothing, tmp_path / "empty" / "mesh_content.ply")
    assert main(["inspect", path, *flags, "--out", "out"]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert text in error[-1]
    assert error[-1].startswith("geraf2: error:")
    assert "finding the models" not in "".join(error)
    assert not (tmp_path / "out").exists()
