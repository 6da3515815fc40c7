"""Every setting of the presets fast and best is read by a step."""

import sys
from dataclasses import fields, is_dataclass, replace

import pytest

import geraf2
from geraf2.io.run_folder import RunFolder
from geraf2.pipeline.events import Listener
from geraf2.pipeline.presets import BestPreset, FastPreset, run_preset
from geraf2.pipeline.stages import direct
from geraf2.pipeline.stages.job import Job, kept_peaks
from helpers.shadows import outlines


def leaves(config, path=""):
    """Dotted names of all settings below a config."""
    for one in fields(config):
        value = getattr(config, one.name)
        if is_dataclass(value):
            yield from leaves(value, f"{path}{one.name}.")
        else:
            yield path + one.name


def recording(config, read, path=""):
    """The same config, whose reads are added to `read` by their dotted names."""
    names = {one.name for one in fields(config)}

    def getter(self, name):
        caller = sys._getframe(1)
        copied = caller.f_globals["__name__"] in ("dataclasses", "geraf2._bounds")
        if name in names and not copied and caller.f_code.co_name != "__post_init__":
            read.add(path + name)
        return object.__getattribute__(self, name)

    kind = type(type(config).__name__, (type(config),), {"__getattribute__": getter})
    values = {
        name: recording(value, read, f"{path}{name}.") if is_dataclass(value) else value
        for name in names
        for value in [getattr(config, name)]
    }
    return kind(**values)


def do_steps(config, capture, prior, folder):
    """Do all steps; best also with an outline, which so small a scan does not show."""
    run = RunFolder(folder, "0" * 32, "capture")
    folder.mkdir()
    job = Job(
        run=run,
        capture=capture,
        prior=prior,
        config=config,
        inputs={},
        listener=Listener(),
        peaks=kept_peaks(prior, config, 1),
        num_threads=1,
    )
    run_preset(job)


def coarse(preset):
    fit = {"spacing_m": 0.008}
    if isinstance(preset, FastPreset):
        return replace(preset, fit=replace(preset.fit, **fit))
    refine = replace(preset.refine, fit=replace(preset.refine.fit, **fit))
    return replace(preset, refine=refine)


@pytest.mark.slow
@pytest.mark.parametrize("preset", [FastPreset(), BestPreset()], ids=lambda one: one.preset)
def test_every_setting_is_read_by_a_step(preset, tmp_path, monkeypatch):
    capture, _ = geraf2.examples.small_capture()
    prior = replace(geraf2.LosPrior.from_box(geraf2.examples.BOX_M), walls=capture.walls)
    read = set()
    config = coarse(preset)
    kept = type(config)(
        **{
            one.name: recording(value, read, f"{one.name}.") if is_dataclass(value) else value
            for one in fields(config)
            for value in [getattr(config, one.name)]
        }
    )
    search = direct.find_silhouettes
    monkeypatch.setattr(
        direct, "find_silhouettes", lambda *of: search(*of) and outlines([0], [0.03] * 3)
    )
    do_steps(kept, capture, prior, tmp_path / "run")
    unread = [name for name in leaves(preset) if name not in read | {"preset"}]
    assert unread == []
