"""Every write of a run fails once; the run reports it in one line and continues when asked again.

As SQLite's tests of full disks: the n-th write fails, for all n up to the end. A run that is
continued repeats only the stage that failed, so one folder takes all faults, one after the other.
"""

import errno
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from geraf2 import examples
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.io.run_folder import RUN_NAME
from geraf2.pipeline.commands.verify import verify
from geraf2.scene.store import capture_digest, load_capture, save_capture

COARSE = ["--preset", "fast", "--fit.spacing-m", "0.006", "--fit.distance-rounds", "1"]
COARSE += ["--calibrate", "no", "--trust-los", "--threads", "1"]
# Of a temporary name.
RANDOM = re.compile(r"-\w{8}(?=\.|$)")


class Disk:
    """Fails the first write below a folder that has not failed before."""

    def __init__(self):
        self.folder = None
        self.failed = set()
        self._seen = {}
        self.is_full = False
        sys.addaudithook(self._hear)

    def attempt(self, folder):
        """Make one write fail from now on, if one is left."""
        self.folder, self._seen, self.is_full = str(folder), {}, False

    def _hear(self, event, arguments):
        if self.folder is None:
            return
        if event == "open":
            path, _, flags = arguments
            # What is made anew, and what is appended to: a full disk shows when bytes are flushed.
            if isinstance(flags, int) and flags & (os.O_EXCL | os.O_APPEND):
                self.write("open", path)
        elif event == "os.rename" or (event == "os.mkdir" and not Path(arguments[0]).exists()):
            self.write(event, arguments[0])

    def write(self, kind, path):
        if self.is_full or not isinstance(path, str) or not path.startswith(self.folder):
            return
        known = (kind, RANDOM.sub("", Path(path).name))
        self._seen[known] = self._seen.get(known, 0) + 1
        write = (*known, self._seen[known])
        if write not in self.failed:
            self.failed.add(write)
            self.is_full = True
            raise OSError(errno.ENOSPC, "No space left on device", path)


@pytest.fixture(scope="module")
def all_disks():
    return Disk()


@pytest.fixture
def disk(all_disks, monkeypatch):
    flush = os.fsync

    def fsync(descriptor):
        if all_disks.folder is not None:
            all_disks.write("fsync", str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    all_disks.failed = set()
    yield all_disks
    all_disks.folder = None


def _until_done(disk, folder, command, after_fault, capsys):
    """Run a command until no write fails; the number of faults."""
    for number in range(1000):
        disk.attempt(folder)
        code = main([*map(str, command)])
        disk.folder = None
        stated = [line for line in capsys.readouterr().err.splitlines() if "geraf2: " in line]
        if not disk.is_full:
            assert code == 0, stated
            return number
        assert (code, len(stated)) == (2, 1), (stated, disk.failed)
        assert "internal error" not in stated[0]
        assert not list(folder.rglob(".*.tmp*")), disk.failed
        after_fault()
    pytest.fail("faults without end")


@pytest.mark.slow
def test_each_write_of_a_run_fails_once_and_nothing_is_lost(disk, tmp_path, capsys):
    scene, out, whole = tmp_path / "scene", tmp_path / "runs" / "out", tmp_path / "whole"
    save_capture(examples.small_capture()[0], scene)
    box = [str(side) for side in examples.BOX_M]
    end = ["--box", *box, *COARSE, "--no-report"]
    assert main(["reconstruct", str(scene), str(whole), *end]) == 0
    kept = [0]

    def after_fault():
        if (out / RUN_NAME).exists():
            kept.append(verify(out).n_files)
            assert kept[-1] >= kept[-2], disk.failed

    command = ["reconstruct", scene, out, *end, "--resume"]
    out.parent.mkdir()
    n_faults = _until_done(disk, out.parent, command, after_fault, capsys)
    assert n_faults > 80
    for name in ("mesh.ply", "mesh_content.glb", "sdf.npz"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()


def test_each_write_of_a_scene_fails_once_and_the_former_scene_stays(disk, tmp_path):
    folder = tmp_path / "scenes"
    capture, _ = examples.small_capture()
    former = replace(capture, poses=capture.poses[:2])
    save_capture(former, folder / "scene")
    digest = capture_digest(former)

    def fails():
        disk.attempt(folder)
        try:
            save_capture(capture, folder / "scene", overwrite=True)
        except UserError as error:
            return str(error)
        finally:
            disk.folder = None

    while (stated := fails()) is not None:
        assert "No space left on device" in stated
        assert capture_digest(load_capture(folder / "scene")) == digest, disk.failed
        assert [path.name for path in folder.iterdir()] == ["scene"], disk.failed
    assert len(disk.failed) > 10
    assert not disk.is_full
    assert capture_digest(load_capture(folder / "scene")) == capture_digest(capture)
