import json
from functools import partial
from importlib.resources import files

from geraf2.cli.main import main
from geraf2.io.mesh import read_mesh
from geraf2.pipeline.commands.image import ImageOptions
from geraf2.simulation import load_spec
from geraf2.surfaces.isosurface import surface_report

# Scores of the whole demo (docs/results.md), three times as long, and the allowed loss.
WHOLE_F1 = {0.015: 1.000, 0.005: 0.993, 0.003: 0.946}
MARGIN = {0.015: 0.01, 0.005: 0.02, 0.003: 0.03}


def test_the_demo_leaves_mesh_pictures_and_readmes_scores(tmp_path, capsys, monkeypatch):
    demo = (files("geraf2.simulation") / "demo.toml").read_text(encoding="utf-8")
    spec = tmp_path / "spec.toml"
    assert "n_poses = 24" in demo  # of which 9, and 3 of the 8 raised ones, score alike
    assert "n_poses = 8" in demo
    spec.write_text(
        demo.replace("n_poses = 24", "n_poses = 9").replace("n_poses = 8", "n_poses = 3")
        + "[numerics]\nwall_patch_m = 0.02\nantenna_block_m = 0.07\n"
    )
    out = tmp_path / "demo"
    monkeypatch.setattr("geraf2.cli.demo.load_spec", lambda _: load_spec(spec))
    monkeypatch.setattr("geraf2.cli.demo.ImageOptions", partial(ImageOptions, spacing_m=0.008))
    assert main(["demo", str(out)]) == 0
    text = capsys.readouterr().out
    for name in ("mesh_content.ply", "figures", "metrics.json", "report.html"):
        assert (out / "run" / name).exists()
    assert f"geraf2 view {out / 'run'}" in text
    metrics = json.loads((out / "run" / "metrics.json").read_text())
    scores = {score["threshold_m"]: score["f1"] for score in metrics["scores"]}
    assert {at: scores[at] for at in WHOLE_F1 if scores[at] < WHOLE_F1[at] - MARGIN[at]} == {}
    assert surface_report(read_mesh(out / "run" / "mesh_content.ply")).n_components == 1
    page = (out / "run" / "report.html").read_text()
    assert page.count("data:image/") >= 4


def test_the_demo_touches_no_folder_of_others(tmp_path, capsys):
    (tmp_path / "scene").mkdir()
    assert main(["demo", str(tmp_path)]) == 2
    assert "holds files but no demo of geraf2" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]
