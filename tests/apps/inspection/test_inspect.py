"""`geraf2 inspect` on runs that are made up: answers, files, exit codes, bad input."""

import csv
import json

import numpy as np
import pytest
import trimesh

import geraf2
from geraf2.cli.main import main
from geraf2.geometry.transforms import apply_rigid
from geraf2.pipeline.commands.verify import verify
from helpers.inspected import POSE, SMALL, block, run_of, wedge

pytestmark = pytest.mark.usefixtures("quick_search")


def glb_colours(path):
    """Colours of the vertices of a GLB, (n, 4)."""
    data = path.read_bytes()
    n = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + n])
    index = document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    view = document["bufferViews"][document["accessors"][index]["bufferView"]]
    start = 28 + n + view["byteOffset"]
    return np.frombuffer(data[start : start + view["byteLength"]], np.uint8).reshape(-1, 4)


def test_parts_are_judged_by_their_number_alone_where_it_is_required(listed, capsys):
    run = listed / "run"
    for flags, code, line in (
        ([], 0, "result   not judged: nothing was required"),
        (["--expect", "2"], 0, "result   pass"),
        (["--expect", "3"], 3, "fails: 2 parts were found, 3 were expected"),
    ):
        assert main(["inspect", str(run), *flags]) == code
        assert line in capsys.readouterr().out
    found = json.loads((run / "inspection.json").read_text())
    assert (found["result"], len(found["failures"])) == ("fail", 1)
    assert verify(run).kind == "run"


def test_a_flat_body_beside_another_is_one_part(tmp_path):
    """Connected pieces count, whatever the echoes around them suggest."""
    flat = block((0.05, 0.04, 0.006), (-0.03, 0.0, 0.0))
    run = run_of(tmp_path / "run", flat, SMALL, has_glints=True)
    found = geraf2.inspect(run, expect=2, write=False)
    assert (found.result, len(found.parts), found.notes) == ("pass", 2, ())


def test_a_model_is_found_and_files_give_its_pose(listed, tmp_path, capsys):
    run, cad, out = listed / "run", listed / "wedge.stl", tmp_path / "answer"
    assert main(["inspect", str(run), "--cad", str(cad), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    for text in ("model 'wedge': present", "± holds 95 %", "size by CAD", "not on its scan"):
        assert text in shown
    found = json.loads((out / "inspection.json").read_text())
    (model,) = found["models"]
    assert (found["result"], model["name"], model["status"]) == ("pass", "wedge", "present")
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


def test_another_part_and_a_missing_one_fail_and_each_step_reports_progress(failed):
    found, steps = failed.answer, failed.steps
    assert [r.match.status for r in found.models] == ["present", "wrong part", "missing"]
    assert "3 models, but only 2 parts in the box" in found.notes
    assert found.failures[0] == "2 parts were found, 3 were expected"
    assert found.failures[1].startswith("'model 1' is out of tolerance: too much (+")
    assert found.failures[2].startswith("'model 2' is swapped: part 2 is there instead, ")
    assert found.failures[3:] == ("'model 3' is missing",)
    assert steps["finding the models"][:3] == pytest.approx([1 / 3, 2 / 3, 1])
    assert len(steps["comparing surfaces"]) == 3
    search = steps["separating connected parts"]
    assert search == sorted(set(search))
    assert 0.0 < max(search) <= 1.0


def test_models_at_the_poses_of_each_other_are_swapped(tmp_path):
    parts = SMALL, block((0.03, 0.02, 0.012))
    run = run_of(tmp_path / "run", *parts, pose=np.eye(4))
    models = [block((0.02, 0.015, 0.03)), block((0.03, 0.02, 0.012), (0.07, 0.0, 0.0))]
    options = geraf2.InspectOptions(placed=True)
    found = geraf2.inspect(run, models, options=options, write=False)
    assert found.failures == ("'model 1' and 'model 2' are swapped",)


def test_the_page_gives_the_reason_of_a_failure(listed, tmp_path, capsys):
    flags = ["--cad", str(listed / "wedge.stl"), "--placed", "--out", str(tmp_path)]
    assert main(["inspect", str(listed / "run"), *flags]) == 3
    assert "fails: 'wedge' is turned against its nominal pose" in capsys.readouterr().out
    page = (tmp_path / "inspection.html").read_text()
    assert "Fail: &#39;wedge&#39; is turned against its nominal pose" in page


def item(name, more=""):
    """Table of a list of contents."""
    return f'[[item]]\nname = "{name}"\ncad = "{name}.stl"\n{more}'


def list_at(folder, text):
    """Flag of a list that is written there."""
    (folder / "contents.toml").write_text(text)
    return ["--expect", str(folder / "contents.toml")]


@pytest.mark.parametrize(
    ("text", "code", "sentence"),
    [
        (item("block", 'material = "metal"\n') + item("wedge"), 0, "the material of 'block'"),
        (item("wedge"), 3, "fails: part 2 is surplus: "),
    ],
)
def test_a_list_of_contents_is_a_verdict(listed, capsys, text, code, sentence):
    assert main(["inspect", str(listed / "run"), *list_at(listed, text)]) == code
    assert sentence in capsys.readouterr().out
