"""Failed and interrupted rows."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from geraf2.apps.benchmark import RowResult, Runner, load_suite, making, rows_of
from geraf2.io.run_folder import CHECKPOINT_NAME
from helpers import batch_tasks

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
        (run / CHECKPOINT_NAME).parent.mkdir()
        (run / CHECKPOINT_NAME).touch()

    def interrupted(*_, resume, **__):
        seen.append((resume, run.exists()))
        raise KeyboardInterrupt

    monkeypatch.setattr(making, "reconstruct", interrupted)
    row = rows_of(load_suite(), ("paper_long",))[0]
    with pytest.raises(KeyboardInterrupt):
        making.make_row(row, tmp_path, run, 0, 1)
    assert seen == [(is_stopped, is_stopped)]


@pytest.fixture
def stand_in(monkeypatch):
    """Skip scenes, and replace rows by the calls of a test."""
    whole = Runner._call

    def replace(**calls):
        def call(runner, function, *arguments):
            if function is not making.make_row:
                return None, 0.0
            return whole(runner, *calls[arguments[0].case.label])

        monkeypatch.setattr(Runner, "_call", call)

    return replace


def test_a_killed_row_is_its_own_error_and_the_others_continue(tmp_path, suite_of, stand_in):
    stand_in(aborts=(os.abort,), ends=(dict.get, {}, "", RowResult()))
    runner = Runner(out=tmp_path / "out")
    seen, rows = [], rows_of(suite_of(SUITE))
    results = runner.run_all(rows, lambda row, _: seen.append(row.case.label))
    errors = [result.error for _, result in results]
    assert errors == ["its process was ended: SIGABRT", None]
    assert seen == ["aborts", "ends"]
    assert [runner.known(row) is not None for row in rows] == [False, True]


def test_an_interrupted_row_cleans_up(tmp_path, suite_of, stand_in, monkeypatch):
    """Trainings store a checkpoint when they are interrupted."""
    monkeypatch.setenv("PYTHONPATH", str(Path(batch_tasks.__file__).parent.parent))
    begun, cleaned = tmp_path / "begun", tmp_path / "cleaned"
    stand_in(aborts=(batch_tasks.hang_and_clean_up, begun, cleaned))

    def interrupt():
        while not begun.exists():
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs of a shell ignore it
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        Runner(out=tmp_path / "out").run_all(rows_of(suite_of(SUITE)), print)
    thread.join()
    signal.signal(signal.SIGINT, before)
    assert cleaned.exists()
