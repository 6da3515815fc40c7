"""Scripts in bench/ hold together: what one takes from another is there."""

import importlib
import json
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[1] / "bench"
SCRIPTS = sorted(p.relative_to(BENCH) for p in BENCH.rglob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=str)
def test_a_script_finds_what_it_imports(script, monkeypatch):
    monkeypatch.syspath_prepend(str((BENCH / script).parent))
    for name in {path.stem for path in SCRIPTS}:
        monkeypatch.delitem(sys.modules, name, raising=False)
    importlib.import_module(script.stem)


@pytest.fixture
def track(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCH))
    monkeypatch.delitem(sys.modules, "track", raising=False)
    return importlib.import_module("track")


def test_a_seed_counts_with_its_last_score_and_a_failure_as_zero(track):
    def result(seed, f1, error=None):
        return json.dumps({"seed": seed, "scores": {track.SCORE: f1}, "error": error})

    lines = [result(7, 0.5), result(8, 0.9, "it broke"), result(7, 0.75)]
    assert track.scores_of("\n".join(lines) + "\n") == {"7": 0.75, "8": 0.0}


def test_a_measurement_is_a_line_that_is_compared_with_the_one_before(
    track, tmp_path, monkeypatch, capsys
):
    def measure(ns, scores, machine):
        kernel = {"ns": ns, "vs_naive": 100.0 / ns, "quiet": True}
        monkeypatch.setattr(track, "kernels", lambda folder, repetitions: {"BM_A": kernel})
        monkeypatch.setattr(track, "population", lambda work, seeds: scores)
        monkeypatch.setattr(track, "machine", lambda: machine)
        monkeypatch.setattr(sys, "argv", ["track.py", str(tmp_path / "kept.jsonl")])
        assert track.main() == 0
        return capsys.readouterr().out

    assert "since" not in measure(2.0, {"1000": 0.5, "1001": 0.75}, "a")
    stated = measure(1.0, {"1000": 0.75, "1001": 0.5, "1002": 1.0}, "a")
    assert "BM_A: ns 2 -> 1, vs_naive 50 -> 100" in stated
    assert "2 seeds: mean F1 at 5 mm 0.6250 -> 0.6250, largest loss 0.250 (seed 1001)" in stated
    assert "ns" not in measure(4.0, {}, "another").split("BM_A:")[1]
    lines = (tmp_path / "kept.jsonl").read_text().splitlines()
    assert [json.loads(line)["machine"] for line in lines] == ["a", "a", "another"]
