"""Scripts in bench/ hold together: what one takes from another is there."""

import importlib
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
