"""A write fails: the command reports it in one line, and what was there is unchanged.

As SQLite's tests of full disks: the n-th write fails. Every write of a scene is tried; of a run,
which takes a second each time, every eighth and the last ones, by which it takes its place.
"""

import errno
import os
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from geraf2 import examples
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.scene.store import capture_digest, load_capture, save_capture
from helpers.folders import contents

COARSE = ["--preset", "fast", "--fit.spacing-m", "0.01"]
COARSE += ["--calibrate", "no", "--trust-los", "--threads", "1", "--no-report"]
COARSE += ["--box", *map(str, examples.BOX_M)]


class Disk:
    """Is full from the n-th write below a folder on."""

    def __init__(self):
        self.folder, self.left, self.n_writes = None, 0, 0
        sys.addaudithook(self._hear)

    def fill(self, folder, n_writes):
        """Let so many writes succeed from now on."""
        self.folder, self.left, self.n_writes = str(folder), n_writes, 0

    def empty(self):
        """Let all writes succeed; whether one failed before."""
        self.folder = None
        return self.left < 0

    def _hear(self, event, arguments):
        if self.folder is None:
            return
        if event == "open":
            path, _, flags = arguments
            # What is made anew, and what is appended to: a full disk shows when bytes are flushed.
            if isinstance(flags, int) and flags & (os.O_EXCL | os.O_APPEND):
                self.write(path)
        elif event == "os.rename" or (event == "os.mkdir" and not Path(arguments[0]).exists()):
            self.write(arguments[0])

    def write(self, path):
        if not isinstance(path, str) or not path.startswith(self.folder):
            return
        self.left -= 1
        self.n_writes += 1
        if self.left < 0:
            raise OSError(errno.ENOSPC, "No space left on device", path)


@pytest.fixture(scope="module")
def all_disks():
    return Disk()


@pytest.fixture
def disk(all_disks, monkeypatch):
    flush = os.fsync

    def fsync(descriptor):
        if all_disks.folder is not None:
            all_disks.write(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    yield all_disks
    all_disks.folder = None


@pytest.mark.slow
def test_a_full_disk_leaves_the_former_run_and_nothing_of_the_new(disk, tmp_path, capsys):
    scene, runs = tmp_path / "scene", tmp_path / "runs"
    save_capture(examples.small_capture()[0], scene)
    command = ["reconstruct", str(scene), str(runs / "out"), *COARSE]
    runs.mkdir()
    disk.fill(runs, 1000)
    assert main(command) == 0
    disk.empty()
    n_writes, former = disk.n_writes, contents(runs)
    assert n_writes > 40
    other = [*command, "--fit.bending-weight", "0.5", "--overwrite"]
    capsys.readouterr()
    for n in (*range(0, n_writes - 8, 8), *range(n_writes - 8, n_writes + 8)):
        disk.fill(runs, n)
        code = main(other)
        stated = [line for line in capsys.readouterr().err.splitlines() if "geraf2: " in line]
        if not disk.empty():
            assert (code, n > n_writes - 8) == (0, True), (n, stated)
            break
        assert (code, len(stated)) == (2, 1), stated
        assert "No space left on device" in stated[0] or "the disk is full" in stated[0]
        assert contents(runs) == former, n
        assert [path.name for path in runs.iterdir()] == ["out"]
    assert contents(runs) != former
    new = [*command[:2], str(tmp_path / "new" / "out"), *COARSE]
    disk.fill(tmp_path, n_writes // 2)
    assert main(new) == 2
    disk.empty()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["runs", "scene"]


def test_each_write_of_a_scene_fails_once_and_the_former_scene_stays(disk, tmp_path):
    folder = tmp_path / "scenes"
    capture, _ = examples.small_capture()
    former, capture = (replace(capture, poses=capture.poses[:n]) for n in (1, 3))
    save_capture(former, folder / "scene")
    digest, n = capture_digest(former), 0

    def is_saved():
        disk.fill(folder, n)
        with suppress(UserError):
            save_capture(capture, folder / "scene", overwrite=True)
        return not disk.empty()

    while not is_saved():
        assert capture_digest(load_capture(folder / "scene")) == digest, n
        assert [path.name for path in folder.iterdir()] == ["scene"], n
        n += 1
    assert n > 10
    assert capture_digest(load_capture(folder / "scene")) == capture_digest(capture)
