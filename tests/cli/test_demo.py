import json

from geraf2.cli.main import main
from small_scene import FAST, SPEC


def test_the_demo_leaves_mesh_pictures_and_metrics(tmp_path, capsys):
    spec = tmp_path / "spec.toml"
    spec.write_text(SPEC)
    out = tmp_path / "demo"
    assert main(["demo", str(out), "--spec", str(spec), *FAST]) == 0
    text = capsys.readouterr().out
    for name in ("mesh_content.ply", "figures", "metrics.json", "report.html"):
        assert (out / "run" / name).exists()
        assert name in text
    metrics = json.loads((out / "run" / "metrics.json").read_text())
    assert metrics["scores"][0]["f1"] > 0.5
    page = (out / "run" / "report.html").read_text()
    assert page.count("data:image/png") >= 4
    # Once more with another seed: the demo replaces its own run.
    assert main(["demo", str(out), "--spec", str(spec), "--seed", "1", *FAST]) == 0


def test_the_demo_touches_no_folder_of_others(tmp_path, capsys):
    (tmp_path / "scene").mkdir()
    assert main(["demo", str(tmp_path)]) == 2
    assert "holds files but no demo of geraf2" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]
