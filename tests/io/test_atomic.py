import errno
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.io.atomic import (
    atomic_folder,
    atomic_path,
    n_written,
    sweep_folder,
    write_json_atomic,
    write_npz_atomic,
    write_text_atomic,
)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def fail_in(manager, error):
    with manager as path:
        if path.is_dir():
            (path / "part").write_text("half")
        else:
            path.write_text("half")
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left")])
def test_a_file_and_a_folder_stay_what_they_were(tmp_path, error):
    write_text_atomic(tmp_path / "a.txt", "whole")
    with atomic_folder(tmp_path / "f") as folder:
        (folder / "old").write_text("old")
    for manager in (atomic_path(tmp_path / "a.txt"), atomic_folder(tmp_path / "f")):
        with pytest.raises((KeyboardInterrupt, UserError)):
            fail_in(manager, error)
    assert names(tmp_path) == ["a.txt", "f"]
    assert (tmp_path / "a.txt").read_text() == "whole"
    assert names(tmp_path / "f") == ["old"]


def test_objects_and_nan_are_refused_rather_than_pickled(tmp_path):
    with pytest.raises(TypeError, match="array 'a' has dtype object"):
        write_npz_atomic(tmp_path / "a.npz", {"a": np.array([{}])})
    with pytest.raises(ValueError, match="JSON"):
        write_json_atomic(tmp_path / "a.json", {"a": float("nan")})
    assert names(tmp_path) == []


KILLED = """
import os, sys
from pathlib import Path
from geraf2.io.atomic import atomic_folder, atomic_path
home = Path(sys.argv[1])
with atomic_path(home / "a.txt") as path, atomic_folder(home / "f") as folder:
    path.write_text("half")
    (folder / "part").write_text("half")
    print("written", flush=True)
    sys.stdin.readline()
"""


def test_what_a_killed_process_left_goes_and_what_a_live_one_writes_stays(tmp_path):
    (tmp_path / ".a-notes.txt").write_text("mine")
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "written\n"
        write_text_atomic(tmp_path / "a.txt", "whole")
        with atomic_folder(tmp_path / "f") as folder:
            (folder / "new").write_text("new")
        left = [name for name in names(tmp_path) if ".tmp" in name]
        assert len(left) == 2  # of the live process
        process.kill()
    write_text_atomic(tmp_path / "a.txt", "whole")
    with atomic_folder(tmp_path / "f") as folder:
        (folder / "newer").write_text("new")
    assert names(tmp_path) == [".a-notes.txt", "a.txt", "f"]
    assert names(tmp_path / "f") == ["newer"]


def test_a_whole_tree_is_swept_of_what_nobody_writes(tmp_path):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / ".sdf-abcdefgh.tmp.npz").write_text("half")
    with atomic_path(tmp_path / "deep" / "b.txt") as mine:
        mine.write_text("mine")
        sweep_folder(tmp_path)
    assert names(tmp_path / "deep") == ["b.txt"]


def test_a_signal_that_comes_with_the_rename_finds_something_written(tmp_path, monkeypatch):
    """Else a command that was stopped there would say that nothing was."""
    rename = Path.replace

    def interrupted(self, target):
        rename(self, target)
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    before = n_written()
    with pytest.raises(KeyboardInterrupt):
        write_text_atomic(tmp_path / "file", "new")
    assert (tmp_path / "file").read_text() == "new"
    assert n_written() == before + 1
