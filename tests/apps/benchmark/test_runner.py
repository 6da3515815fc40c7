"""Rows of photos and their truths; failed and interrupted rows."""

import os
import shutil
import time

import numpy as np
import pytest

from geraf2.apps.benchmark import RowResult, Runner, load_suite, making, rows_of
from geraf2.errors import UserError
from geraf2.io.mesh import write_mesh
from geraf2.io.run_folder import CHECKPOINT_NAME
from geraf2.pipeline.processes import Processes
from geraf2.scene import LosPrior

SUITE = """
[scenes.llama]
[methods.photos]
title = "photos"
kind = "photos"
photos = "quick"
[experiments.photos]
title = "Photos"
scenes = ["llama"]
methods = ["photos"]
cases = [
  { label = "box", scene = { photos = { subject = "box" } } },
  { label = "content", scene = { photos = { subject = "content" } } },
  { label = "none" },
]
"""


@pytest.fixture
def results(tmp_path, monkeypatch, suite_of):
    scene = tmp_path / "scene"
    scene.mkdir()
    for name, side in (("truth", 0.1), ("los", 0.2)):
        mesh = LosPrior.from_box((side, side, side)).mesh
        write_mesh(mesh, scene / f"{name}.ply", frame="capture")

    def small_cube(source, out, options, **_):
        assert (source, options.preset) == (scene / "photos", "quick")
        out.mkdir()
        shutil.copy(scene / "truth.ply", out / "los.ply")

    monkeypatch.setattr(making, "make_los", small_cube)
    rows = {row.case.label: row for row in rows_of(suite_of(SUITE))}
    with pytest.raises(UserError, match="no photos"):
        making.make_row(rows.pop("none"), scene, tmp_path / "none", 0, 1)
    return tmp_path, {
        label: making.make_row(row, scene, tmp_path / label, 0, 1) for label, row in rows.items()
    }


def test_photos_are_scored_by_what_they_show(results):
    out, by_case = results
    assert by_case["content"].f1_5mm == pytest.approx(1.0)
    # Of a cube of 10 cm nothing lies near the sides of one of 20.
    assert by_case["box"].f1_15mm == 0.0
    assert by_case["box"].chamfer_1e3_m2 > 1.0
    has_content = [(out / label / "mesh_content.ply").is_file() for label in ("content", "box")]
    assert has_content == [True, False]
    assert np.isfinite(by_case["content"].median_m)


@pytest.mark.parametrize("is_stopped", [True, False])
def test_a_stopped_training_continues_and_another_run_begins_again(
    tmp_path, monkeypatch, is_stopped
):
    """Without a checkpoint, an unfinished run is removed."""
    run, seen = tmp_path / "run", []
    run.mkdir()
    (run / "mesh.ply").touch()
    if is_stopped:
        (run / CHECKPOINT_NAME).touch()

    def interrupted(*_, resume, **__):
        seen.append((resume, run.exists()))
        raise KeyboardInterrupt

    monkeypatch.setattr(making, "reconstruct", interrupted)
    row = rows_of(load_suite(), ("paper_long",))[0]
    with pytest.raises(KeyboardInterrupt):
        making.make_row(row, tmp_path, run, 0, 1)
    assert seen == [(is_stopped, is_stopped)]


class StandIn(Processes):
    """Skips scenes, and replaces rows by calls of a test."""

    def __init__(self, **calls):
        super().__init__()
        self.calls = calls

    def call(self, function, *arguments):
        if function is not making.make_row:
            return super().call(os.getpid)
        return super().call(*self.calls[arguments[0].case.label])


def test_a_killed_row_is_its_own_error_and_the_others_continue(tmp_path, suite_of):
    processes = StandIn(
        box=(os.abort,), content=(os._exit, 3), none=(dict.get, {}, "", RowResult())
    )
    runner = Runner(out=tmp_path / "out")
    runner._processes = processes
    seen, rows = [], rows_of(suite_of(SUITE))
    results = runner.run_all(rows, lambda row, _: seen.append(row.case.label))
    errors = [result.error for _, result in results]
    assert errors == ["its process was ended by SIGABRT", "exit code 3", None]
    assert seen == ["box", "content", "none"]
    assert [runner.known(row) is not None for row in rows] == [False, False, True]


def test_processes_end_when_it_is_interrupted(tmp_path, suite_of):
    processes = StandIn(box=(os._exit, 3), content=(time.sleep, 600), none=(time.sleep, 600))

    def interrupt(row, _):
        assert row.case.label == "box"
        raise KeyboardInterrupt

    start, runner = time.monotonic(), Runner(out=tmp_path / "out")
    runner._processes = processes
    with pytest.raises(KeyboardInterrupt):
        runner.run_all(rows_of(suite_of(SUITE)), interrupt)
    assert time.monotonic() - start < 300.0
    with pytest.raises(KeyboardInterrupt):  # nothing more is started
        Processes.call(processes, os.getpid)
