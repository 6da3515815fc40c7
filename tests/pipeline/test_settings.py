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


def kinds_of(config):
    """Types of a config and of those in it."""
    inner = [getattr(config, one.name) for one in fields(config)]
    return {type(config)}.union(*(kinds_of(value) for value in inner if is_dataclass(value)))


def record_reads(kind, read, monkeypatch):
    """Add the settings of a type that are read to `read`, but for those that it copies itself."""

    def getter(self, name):
        caller = sys._getframe(1)
        copied = caller.f_globals["__name__"] in ("dataclasses", "geraf2._bounds")
        if not copied and caller.f_code.co_name != "__post_init__":
            read.add((kind, name))
        return object.__getattribute__(self, name)

    monkeypatch.setattr(kind, "__getattribute__", getter)


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
    config, read = coarse(preset), set()
    kinds = kinds_of(config)
    for kind in kinds:
        record_reads(kind, read, monkeypatch)
    search = direct.find_silhouettes
    monkeypatch.setattr(
        direct, "find_silhouettes", lambda *of: search(*of) and outlines([0], [0.03] * 3)
    )
    do_steps(config, capture, prior, tmp_path / "run")
    settings = {(kind, one.name) for kind in kinds for one in fields(kind)}
    assert settings - read - {(type(preset), "preset")} == set()
