"""Every bad input is refused: one line, exit code 2, nothing half-written, quickly.

Run in this process, each row in a folder of its own: `main` is what the command line calls.
"""

import resource
import shutil
import signal
import subprocess
import sys
import time

import pytest

from bad_inputs import apps, photos, walks
from bad_inputs.rows import IMPORT, RAW, SIMULATE, STUDIO, TABLES, UNPLACED
from bad_inputs.table import bad, toml
from bad_inputs.things import make_things, named
from geraf2.cli.main import main

MAX_CPU_S, MAX_S = 10.0, 60
"""Processor time; and wall time, of a machine that others use, too."""
ROWS = {
    f"{name} {number} {row.line}"[:120]: row
    for name, rows in {**TABLES, "photos": photos.ROWS, "apps": apps.ROWS}.items()
    for number, row in enumerate(rows)
}
# The rows spoil these good inputs; if one were bad, its rows would be refused for another reason.
GOOD = (
    "info scene",
    "info raw/adc.bin --radar radar.toml",
    IMPORT,
    RAW,
    UNPLACED + " --positions robot.csv",
    f"{RAW} --config {STUDIO}",
    "import mat scan.mat out",
    "import mmnorm norm.npz out",
    "import planar planar out",
    "los box.ply out --unit m",
    "plan --box 0.2 0.2 0.2 --elevations-deg 0",
    "plan --depth 0.3",
    "image scene out --every 4 --spacing-m 0.02",
)
# In a process that may not have more memory than this; with Python and torch, 1 GiB is for them.
LIMIT_BYTES = 4 << 30
HUNGRY = (
    bad(SIMULATE, toml("spec.toml", "scan.n_poses", "1000000"), text="n_poses"),
    bad("render run --spacing-m 0.0001 --max-memory 0.5", text="--spacing-m"),
    bad("render run --echo.n-nodes 10000 --max-memory 2", text="lower --echo.n-nodes"),
)


@pytest.fixture(scope="session")
def things(tmp_path_factory):
    root = tmp_path_factory.mktemp("things")
    make_things(root)
    return root


@pytest.fixture
def position(things, tmp_path, request, monkeypatch):
    """Folder of a row, with copies of what it names."""
    row = request.node.callspec.params["row"]
    for name in named([row.line, *(change.path for change in row.changes)], things):
        copy = shutil.copytree if (things / name).is_dir() else shutil.copyfile
        copy(things / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def time_limit():
    def stop(*_):
        msg = f"took more than {MAX_S} s"
        raise AssertionError(msg)

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(MAX_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def content(folder):
    """Bytes of each file below a folder, the target of a link; None of others and huge files."""
    return {
        path: path.readlink()
        if path.is_symlink()
        else path.read_bytes()
        if path.is_file() and path.stat().st_size < LIMIT_BYTES
        else None
        for path in sorted(folder.rglob("*"))
    }


def require_refused(row, code, err, out=""):
    assert code == 2, err[-500:] or out[-300:]
    (line,) = (line for line in err.splitlines() if line.startswith("geraf2:"))
    assert line.startswith("geraf2: error: ")
    assert "Traceback" not in err + out
    assert row.text in line
    assert len(line) < 700
    assert line.isprintable()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_it_is_refused(row, position, capsys, time_limit):
    for change in row.changes:
        change.apply(position / change.path)
    before, start = content(position), time.process_time()
    code = main(row.line.split())
    seconds = time.process_time() - start
    stated = capsys.readouterr()
    require_refused(row, code, stated.err, stated.out)
    assert content(position) == before
    assert seconds < MAX_CPU_S


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("row", [*map(bad, (*walks.LINES, SIMULATE))], ids=lambda row: row.line)
def test_every_flag_and_key_refuses_what_is_out_of_its_range(row, position, capsys):
    before, accepted = content(position), []
    for one in walks.walked(row.line):
        kept = {change.path: (position / change.path).read_bytes() for change in one.changes}
        for change in one.changes:
            change.apply(position / change.path)
        code, stated = main(one.line.split()), capsys.readouterr()
        for path, data in kept.items():
            (position / path).write_bytes(data)
        try:
            require_refused(one, code, stated.err, stated.out)
        except (AssertionError, ValueError) as error:
            accepted.append(f"{one}: {error}")
    assert accepted == []
    assert content(position) == before


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("row", [*map(bad, GOOD)], ids=GOOD)
def test_what_is_not_spoiled_is_accepted(row, position, capsys):
    assert main(row.line.split()) == 0, capsys.readouterr().err


@pytest.mark.parametrize("row", HUNGRY, ids=[row.line for row in HUNGRY])
def test_hungry_work_is_refused_where_memory_is_limited(row, position):
    for change in row.changes:
        change.apply(position / change.path)

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))

    command = [sys.executable, "-c", "from geraf2.cli.main import run; run()", *row.line.split()]
    done = subprocess.run(command, check=False, capture_output=True, text=True, preexec_fn=limit)
    require_refused(row, done.returncode, done.stderr)
