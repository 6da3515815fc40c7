"""A former name of a preset or a setting is refused in one line that states the present one."""

import pytest

from geraf2.cli._flags import parse
from geraf2.cli.calibrate import Config as CalibrateConfig
from geraf2.cli.main import main
from geraf2.cli.reconstruct import Config
from geraf2.errors import UserError, speaking_of_flags
from geraf2.io import former_names
from geraf2.io.toml import to_table
from geraf2.pipeline.presets import PRESETS, BestPreset, FastPreset, preset_of_table, preset_type


def keys(table, prefix=""):
    for name, value in table.items():
        yield f"{prefix}{name}"
        if isinstance(value, dict):
            yield from keys(value, f"{prefix}{name}.")


@pytest.mark.parametrize(("former", "name"), former_names.PRESETS.items())
def test_a_former_preset_is_refused_with_its_name(former, name, tmp_path, capsys):
    line = f"preset {former!r} is called {name!r} now"
    with pytest.raises(UserError, match=line):
        preset_type(former)
    with pytest.raises(UserError, match=f"^run.toml: {line}"):
        preset_of_table({"preset": former}, "run.toml")
    missing = [str(tmp_path / "missing"), str(tmp_path / "out"), "--box", "0.2", "0.2", "0.2"]
    assert main(["reconstruct", *missing, "--preset", former]) == 2
    told = capsys.readouterr().err
    assert line in told
    assert told.count("\n") == 1


def test_a_former_section_is_refused_in_a_file_and_as_a_flag():
    table = {"preset": "best", "hybrid": {"rim": {"sizes_m": [0.06]}}}
    with pytest.raises(UserError, match=r"^run.toml: hybrid is called refine now$"):
        preset_of_table(table, "run.toml")
    for flag, now in (
        ("--hybrid.rim.sizes-m", "--refine.rim.sizes-m"),
        ("--hybrid.shadow-clearance-m", "--refine.outline-clearance-m"),
    ):
        with speaking_of_flags(), pytest.raises(UserError, match=f"^{flag} is called {now} now"):
            parse(Config, ["scene", "out", flag, "0.001"], prog="geraf2 reconstruct")


def test_a_removed_flag_of_calibrate_is_refused_as_removed():
    with pytest.raises(UserError, match=r"^autofocus.min_gain was removed"):
        parse(CalibrateConfig, ["scene", "--autofocus.min-gain", "1"], prog="geraf2 calibrate")


OF_PRESETS = sorted(name for name in former_names.REMOVED if not name.startswith("autofocus."))


@pytest.mark.parametrize("removed", OF_PRESETS)
def test_a_removed_setting_is_refused_as_removed(removed):
    preset = "best" if removed.startswith("refine.") else "fast"
    table = 1
    for part in reversed(removed.split(".")):
        table = {part: table}
    with pytest.raises(UserError, match=f"run.toml: {removed} was removed and has no successor"):
        preset_of_table({"preset": preset, **table}, "run.toml")
    flag = "--" + removed.replace("refine.", "hybrid.").replace("_", "-")
    with speaking_of_flags(), pytest.raises(UserError, match=f"^{flag} was removed"):
        parse(Config, ["scene", "out", flag, "1"], prog="geraf2 reconstruct")


def test_no_present_name_is_in_the_table():
    present = {key for preset in (BestPreset, FastPreset) for key in keys(to_table(preset()))}
    assert not present & {*former_names.REMOVED, *former_names.RENAMED}
    assert set(former_names.RENAMED.values()) <= present
    assert not PRESETS.keys() & former_names.PRESETS.keys()
    assert former_names.former_setting("refine.rim.sizes_m") == ""
