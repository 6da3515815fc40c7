"""Comparison of full-wave captures with physical optics, on captures of the simulator."""

from functools import partial

import pytest

import geraf2
from geraf2.io.toml import write_toml
from geraf2.pipeline.commands.simulate import simulate_scene
from geraf2.surfaces import FitConfig


@pytest.fixture(scope="module")
def captures(tmp_path_factory, wave):
    """A body whose capture is the simulator's own."""
    folder = tmp_path_factory.mktemp("captures") / "thing"
    folder.mkdir()
    spec = geraf2.examples.small_scene()
    simulate_scene(spec, folder / wave.comparison.SCENE_NAME)
    write_toml(folder / wave.comparison.TWIN_NAME, spec)
    return folder.parent


def test_equal_captures_have_equal_scores_and_no_difference(captures, tmp_path, wave, monkeypatch):
    monkeypatch.setattr(wave.comparison, "_SPACING_M", 0.008)
    few = partial(wave.comparison.evaluate, n_samples=1000)
    monkeypatch.setattr(wave.comparison, "evaluate", few)
    coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.006))
    monkeypatch.setattr(wave.comparison, "preset_type", lambda _: lambda: coarse)
    folders = wave.comparison.bodies(captures)
    table = wave.comparison.compare(folders, ["fast"], tmp_path)
    header, full, own, _, heat_header, heat = table
    assert header.startswith("body")
    assert full.split()[:4] == ["thing", "fast", "full", "wave"]
    assert own.split()[:4] == ["thing", "fast", "physical", "optics"]
    assert full.split()[4:] == own.split()[4:]
    assert float(full.split()[4]) > 0.8
    assert heat_header.startswith("heat maps")
    assert float(heat.split()[1]) < -80
    result = next(tmp_path.glob("runs/thing-full-wave-fast/result.json"))
    before = result.stat().st_mtime_ns
    assert wave.comparison.compare(folders, ["fast"], tmp_path) == table
    assert result.stat().st_mtime_ns == before  # what is done is kept
