"""From files to scores on a capture that an independent simulator made."""

import json

import pytest

from geraf2.cli.main import main


@pytest.fixture
def source(shared_data):
    if not (shared_data / "spot_carton").is_dir():
        pytest.skip("spot_carton is absent from the shared captures")
    return shared_data / "spot_carton"


@pytest.mark.data
@pytest.mark.slow
def test_from_the_capture_to_its_scores(source, tmp_path, capsys):
    scene, out = str(tmp_path / "scene"), str(tmp_path / "out")
    assert main(["import", "geraf-sens", str(source), scene]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "142128" in shown
    assert "phase sign exp(-j...)" in shown
    los = ["--los", str(source / "los_box.ply")]
    assert main(["reconstruct", scene, out, *los, "--preset", "fast", "--no-report"]) == 0
    finished = json.loads((tmp_path / "out" / "log.jsonl").read_text().splitlines()[-1])
    assert finished["event"] == "finished"
    assert main(["evaluate", out, "--truth", str(source / "truth_object.ply")]) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    scores = {round(1e3 * s["threshold_m"]): s["f1"] for s in metrics["scores"]}
    assert scores[15] >= 0.999
    assert scores[5] >= 0.98
    assert scores[3] >= 0.88
    assert metrics["chamfer_1e3_m2"] <= 0.0075
