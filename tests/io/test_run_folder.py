"""A result takes the place of the former one in one step, and several processes meet there."""

import errno
import signal
import subprocess
import sys

import pytest

from geraf2.errors import UserError
from geraf2.io import run_folder
from geraf2.io.locks import BusyFolderError
from geraf2.io.run_folder import RunFolder, StageRecord

MESH, SCORES, IMAGE = "mesh_content.ply", "metrics.json", "image.npz"


def write(out, mesh=b"mesh", digest="d", name="scene", **options):
    """Replace what is in a folder by a result of two files."""
    run = RunFolder.open(out, scene_digest=digest, scene_name=name, **options)
    with run.replace_whole() as new:
        new.stages["mesh"] = StageRecord(seconds=1.5)
        (new.path / MESH).write_bytes(mesh)
        (new.path / "glints.npz").write_bytes(b"glints of " + mesh)
        new.log("done", level="info")
        new.take_over()
    return run


def contents(folder):
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def add(run, name, content):
    with run.rewrite(name):
        (run.path / name).write_bytes(content)


@pytest.mark.parametrize("in_place", [False, True])
def test_what_a_new_result_keeps_of_the_former(tmp_path, monkeypatch, in_place):
    out = tmp_path / "out"
    run = write(out)
    add(run, SCORES, b"scores")
    with run.rewrite(IMAGE):
        (out / IMAGE).write_bytes(b"image")
        run.stages["image"], run.asked["image"] = StageRecord(seconds=1.0), "key"
    (out / "own" / "deep").mkdir(parents=True)
    (out / "own" / "deep" / "notes.txt").write_text("mine")
    if in_place:
        monkeypatch.chdir(out)
    inode = out.stat().st_ino
    assert write(out, b"mesh").stages.keys() == {"mesh", "image"}
    kept = contents(out)
    assert kept[SCORES] == b"scores"
    assert (out.stat().st_ino == inode) == in_place
    write(out, b"other mesh")
    now = contents(out)
    assert SCORES not in now
    assert (now[IMAGE], now["own/deep/notes.txt"]) == (b"image", b"mine")
    assert RunFolder.read(out).files.keys() == {MESH, "glints.npz", IMAGE}
    assert RunFolder.read(out).asked == {"image": "key"}
    assert not list(tmp_path.rglob(".*"))


def fail(run):
    with run.replace_whole() as other:
        (other.path / MESH).write_bytes(b"another")
        raise UserError(what="full", where=other.path / "glints.npz")


@pytest.mark.parametrize("in_place", [False, True])
def test_a_failure_leaves_what_was_there_and_nothing_new(tmp_path, monkeypatch, in_place):
    new = tmp_path / "not" / "yet" / "out"
    old = write(tmp_path / "out").path
    before = contents(tmp_path)
    if in_place:
        monkeypatch.chdir(old)
    for out in (new, old):
        run = RunFolder.open(out, scene_digest="d", scene_name="scene")
        with pytest.raises(UserError, match=f"^{out}/glints.npz: full"):
            fail(run)
        assert contents(tmp_path) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


KILLED = """
import os, signal, sys
from pathlib import Path
from geraf2.io.run_folder import RunFolder
run = RunFolder.open(Path(sys.argv[1]), scene_digest="d", scene_name="scene")
with run.replace_whole() as new:
    (new.path / "mesh_content.ply").write_bytes(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_kill_leaves_what_was_there(tmp_path):
    out = write(tmp_path / "out").path
    before = contents(out)
    done = subprocess.run([sys.executable, "-c", KILLED, str(out)], check=False, timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert contents(out) == before
    write(out, b"next")  # and sweeps what the killed process left
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


HOLD = """
import sys
from pathlib import Path
from geraf2.io.run_folder import RunFolder, StageRecord
run = RunFolder.read(Path(sys.argv[1]))
with run.rewrite("metrics.json"):
    print("held", flush=True)
    sys.stdin.readline()
    run.stages["other"] = StageRecord(seconds=1.0)
"""


@pytest.fixture
def holder(tmp_path):
    """A process that writes into the folder until its input ends."""
    write(tmp_path / "out")
    command = [sys.executable, "-c", HOLD, str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "held\n"
        yield process


def test_a_second_command_reports_who_writes_and_changes_nothing(tmp_path, holder):
    run, before = RunFolder.read(tmp_path / "out"), contents(tmp_path)
    for writes in (lambda: add(run, SCORES, b""), lambda: write(tmp_path / "out", b"b")):
        with pytest.raises(BusyFolderError, match="another command is writing") as caught:
            writes()
        assert f"process {holder.pid};" in str(caught.value)
        assert contents(tmp_path) == before
    holder.communicate(timeout=30)
    add(run, SCORES, b"{}")  # what the other did meanwhile is known, not overwritten
    assert RunFolder.read(tmp_path / "out").stages.keys() == {"mesh", "other"}


def test_the_lock_goes_with_its_process(tmp_path, holder):
    holder.kill()
    holder.wait(30)
    write(tmp_path / "out", b"next")


def test_of_two_results_at_once_the_first_stays(tmp_path):
    run = RunFolder.open(tmp_path / "out", scene_digest="d", scene_name="scene")
    with pytest.raises(BusyFolderError, match="another result was written"), run.replace_whole():
        write(tmp_path / "out", b"first")
    assert contents(tmp_path / "out")[MESH] == b"first"


def test_a_file_system_without_second_names_gets_copies(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EPERM, "no second names")

    monkeypatch.setattr(run_folder.os, "link", refuse)
    write(tmp_path / "out")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    write(tmp_path / "out", b"next")
    assert contents(tmp_path / "out")["notes.txt"] == b"mine"


def test_a_folder_that_is_a_link_is_filled_where_it_leads(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to("real")
    write(tmp_path / "out")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "real" / MESH).is_file()


def test_a_result_that_came_after_the_folder_was_opened_is_not_replaced(tmp_path):
    def opened():
        return RunFolder.open(tmp_path / "run", scene_digest="a", scene_name="scene")

    late = opened()
    with opened().replace_whole() as new:
        (new.path / "mesh.ply").write_bytes(b"first")
    with pytest.raises(UserError, match="another result was written"), late.replace_whole():
        pytest.fail("the work must not begin")
    assert (tmp_path / "run" / "mesh.ply").read_bytes() == b"first"
