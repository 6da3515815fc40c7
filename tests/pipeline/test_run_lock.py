"""Several processes meet in one run folder."""

import json
import socket
import subprocess
import sys

import pytest

from geraf2.errors import UserError
from geraf2.io.run_folder import LOCK_NAME, RUN_NAME, RunFolder


def _open(path, digest="d"):
    return RunFolder.open(path, scene_digest=digest, scene_name="scene")


HOLD = """
import sys
from pathlib import Path
from geraf2.io.run_folder import RunFolder
run = RunFolder.open(Path(sys.argv[1]), scene_digest="d", scene_name="scene")
with run.locked():
    print("held", flush=True)
    sys.stdin.readline()
    run.mark_done("other", "key", [], 1.0)
"""


@pytest.fixture
def holder(tmp_path):
    """A process that holds the folder's lock until its input ends."""
    command = [sys.executable, "-c", HOLD, str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "held\n"
        yield process


def test_a_second_run_reports_who_holds_the_folder_and_changes_nothing(tmp_path, holder):
    run = _open(tmp_path / "out")
    before = (tmp_path / "out" / RUN_NAME).read_bytes()
    with pytest.raises(UserError, match="another run is writing") as caught, run.locked():
        pass
    assert f"process {holder.pid} on {socket.gethostname()}" in str(caught.value)
    assert (tmp_path / "out" / RUN_NAME).read_bytes() == before
    holder.communicate(timeout=30)
    with run.locked():  # what the other did meanwhile is known, not overwritten
        assert set(run.stages) == {"other"}
        run.mark_done("mine", "key", [], 1.0)
    assert set(RunFolder.read(tmp_path / "out").stages) == {"other", "mine"}


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path, holder):
    holder.kill()
    holder.wait(30)
    assert (tmp_path / "out" / LOCK_NAME).exists()
    with _open(tmp_path / "out").locked():
        pass
    assert not (tmp_path / "out" / LOCK_NAME).exists()


def test_a_process_of_another_host_counts_as_alive(tmp_path):
    run = _open(tmp_path / "out")
    (run.path / LOCK_NAME).write_text("1\nanother-host\n")
    stated = f"process 1 on another-host.*remove {LOCK_NAME}"
    with pytest.raises(UserError, match=stated), run.locked():
        pass


def test_another_scene_that_came_first_is_not_overwritten(tmp_path):
    late = RunFolder(tmp_path / "out", "late", "late")
    _open(tmp_path / "out", "first")
    with pytest.raises(UserError, match="another run has just begun"), late.locked():
        pass
    assert RunFolder.read(tmp_path / "out").scene_digest == "first"


def test_a_run_of_an_earlier_format_is_refused_with_a_hint(tmp_path):
    old = {"format": "geraf2-run", "version": 1, "scene": {"name": "s", "digest": "d"}}
    text = json.dumps({**old, "stages": {"mesh": {"key": "k", "files": {}, "seconds": 1.0}}})
    (tmp_path / RUN_NAME).write_text(text)
    with pytest.raises(UserError, match=r"format version 1.*run it again into a new folder"):
        _open(tmp_path)
    assert (tmp_path / RUN_NAME).read_text() == text


def test_lock_that_names_no_process_is_taken_over(tmp_path):
    # Killed between making the file and writing into it.
    run = _open(tmp_path / "out")
    (run.path / LOCK_NAME).touch()
    with run.locked():
        assert (run.path / LOCK_NAME).stat().st_size > 0
    assert not (run.path / LOCK_NAME).exists()
