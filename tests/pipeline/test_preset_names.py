"""Names that presets had before are still read."""

import logging
import shutil

import pytest

import geraf2
from geraf2.apps.benchmark.suite import load_suite
from geraf2.cli.main import main
from geraf2.io.toml import to_table
from geraf2.pipeline import presets
from geraf2.pipeline.presets import FORMER_NAMES, PRESETS, preset_of_table, preset_type
from geraf2.pipeline.run_record import RunRecord


@pytest.mark.parametrize(("former", "name"), FORMER_NAMES.items())
def test_a_former_name_is_the_preset_with_one_note(former, name, caplog):
    presets._note_name.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert preset_type(former) is preset_type(former) is PRESETS[name]
    assert caplog.messages == [f"the preset {former} is called {name} now"]
    table = to_table(PRESETS[name]())
    assert preset_of_table({**table, "preset": former}, "x") == PRESETS[name]()
    assert geraf2.GlintPreset is geraf2.FastPreset
    assert geraf2.HybridPreset is geraf2.BestPreset


def test_a_run_of_the_former_name_opens_and_holds(tmp_path):
    capture, prior = geraf2.examples.small_capture()[0], geraf2.examples.small_run().prior
    shutil.copytree(geraf2.examples.small_run().path, tmp_path / "run")
    config = tmp_path / "run" / "config.toml"
    text = config.read_text()
    assert 'preset = "fast"' in text
    config.write_text(text.replace('preset = "fast"', 'preset = "glint"'))
    assert RunRecord.read(config).config == geraf2.FastPreset()
    assert geraf2.load_run(tmp_path / "run").content.faces.shape[0] > 0
    before = (tmp_path / "run" / "mesh_content.ply").stat().st_mtime_ns
    geraf2.reconstruct(capture, prior, "glint", tmp_path / "run", resume=True)
    assert (tmp_path / "run" / "mesh_content.ply").stat().st_mtime_ns == before


def test_command_line_and_suites_take_a_former_name(tmp_path, capsys):
    assert main(["reconstruct", "--help-preset", "hybrid"]) == 0
    assert "--hybrid.links.chord-m" in capsys.readouterr().out
    missing = [str(tmp_path / "missing"), str(tmp_path / "out"), "--box", "0.2", "0.2", "0.2"]
    for former in FORMER_NAMES:
        assert main(["reconstruct", *missing, "--preset", former]) == 2
        assert "no such scene" in capsys.readouterr().err
    text = (
        '[scenes.a]\nfigure = { name = "llama" }\nwalls = [{ size_m = [0.2, 0.2, 0.2] }]\n'
        '[methods.b]\ntitle = "b"\npreset = "hybrid"\nsettings.heatmaps = { n_rounds = 0 }\n'
        '[experiments.c]\ntitle = "c"\nscenes = ["a"]\nmethods = ["b"]\n'
    )
    (tmp_path / "suite.toml").write_text(text)
    config = load_suite(tmp_path / "suite.toml").config("b")
    assert (config.preset, config.heatmaps.n_rounds) == ("best", 0)
