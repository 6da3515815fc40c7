"""Failed and interrupted rows."""

import os
import time

import pytest

from geraf2.apps.benchmark import RowResult, Runner, load_suite, making, rows_of
from geraf2.io.run_folder import CHECKPOINT_NAME
from geraf2.pipeline.processes import Processes

SUITE = """
[scenes.llama]
[methods.fast]
title = "fast"
[experiments.some]
title = "Some"
scenes = ["llama"]
methods = ["fast"]
cases = [
  { label = "aborts", scene.disturbance.snr_db = 10.0 },
  { label = "exits", scene.disturbance.snr_db = 5.0 },
  { label = "ends", scene.disturbance.snr_db = 0.0 },
]
"""


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
        aborts=(os.abort,), exits=(os._exit, 3), ends=(dict.get, {}, "", RowResult())
    )
    runner = Runner(out=tmp_path / "out")
    runner._processes = processes
    seen, rows = [], rows_of(suite_of(SUITE))
    results = runner.run_all(rows, lambda row, _: seen.append(row.case.label))
    errors = [result.error for _, result in results]
    assert errors == ["its process was ended by SIGABRT", "exit code 3", None]
    assert seen == ["aborts", "exits", "ends"]
    assert [runner.known(row) is not None for row in rows] == [False, False, True]


def test_processes_end_when_it_is_interrupted(tmp_path, suite_of):
    processes = StandIn(aborts=(os._exit, 3), exits=(time.sleep, 600), ends=(time.sleep, 600))

    def interrupt(row, _):
        assert row.case.label == "aborts"
        raise KeyboardInterrupt

    start, runner = time.monotonic(), Runner(out=tmp_path / "out")
    runner._processes = processes
    with pytest.raises(KeyboardInterrupt):
        runner.run_all(rows_of(suite_of(SUITE)), interrupt)
    assert time.monotonic() - start < 300.0
    with pytest.raises(KeyboardInterrupt):  # nothing more is started
        Processes.call(processes, os.getpid)
