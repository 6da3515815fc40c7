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
