"""Every bad input is refused: one line, exit code 2, nothing half-written, quickly.

Run in this process, each row in a folder of its own: `main` is what the command line calls.
"""

import shutil
import signal
import time

import pytest

from bad_inputs import first
from bad_inputs.things import make_things, named
from geraf2.cli.main import main

MOST_S = 10.0
ROWS = {f"{number} {row.name}"[:150]: row for number, row in enumerate(first.ROWS)}


@pytest.fixture(scope="session")
def things(tmp_path_factory):
    root = tmp_path_factory.mktemp("things")
    make_things(root)
    return root


@pytest.fixture
def place(things, tmp_path, request, monkeypatch):
    """Folder of a row, with copies of what it names."""
    row = request.node.callspec.params["row"]
    for name in named([row.line, *(change.path for change in row.changes)], things):
        source = things / name
        copy = shutil.copytree if source.is_dir() else shutil.copyfile
        copy(source, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def time_limit():
    def stop(*_):
        msg = f"took more than {MOST_S:g} s"
        raise AssertionError(msg)

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, MOST_S)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def content(folder):
    """Bytes of each file below a folder; None of a folder, the target of a link."""
    return {
        path.relative_to(folder).as_posix(): path.readlink()
        if path.is_symlink()
        else None
        if path.is_dir()
        else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_it_is_refused(row, place, capsys, time_limit):
    for change in row.changes:
        change.apply(place / change.path)
    before, start = content(place), time.perf_counter()
    code = main(row.line.split())
    seconds = time.perf_counter() - start
    said = capsys.readouterr()
    assert code == 2, said.err[-500:] or said.out[-300:]
    lines = [line for line in said.err.splitlines() if line.startswith("geraf2:")]
    assert len(lines) == 1
    assert lines[0].startswith("geraf2: error: ")
    assert "Traceback" not in said.err + said.out
    assert row.says in lines[0]
    assert len(lines[0]) < 700
    assert lines[0].isprintable()
    assert content(place) == before
    assert seconds < MOST_S
