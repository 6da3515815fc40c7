"""Real signals to real processes; bench/python/signals.py sends them by the hundred."""

import importlib
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from geraf2.cli.main import main

BENCH = Path(__file__).parents[2] / "bench" / "python"


@pytest.fixture
def signals(monkeypatch):
    """The script; what it prepares, to which no signal is sent, is made in this process."""
    monkeypatch.syspath_prepend(str(BENCH))
    script = importlib.import_module("signals")
    monkeypatch.setattr(script, "call", lambda *words: main([*words, "--quiet"]))
    return script


@pytest.mark.slow
def test_signals_at_random_moments_leave_nothing_half_done(tmp_path, signals):
    stated = []
    bench = signals.Bench(tmp_path, ["fast", "los"])
    assert signals.run_trials(bench, 2, 3, stated.append) == 0, stated


@pytest.mark.slow
def test_of_two_runs_in_one_folder_one_wins(tmp_path, signals):
    stated = []
    assert signals.run_pairs(tmp_path, 1, 0, stated.append) == 0, stated


INTERRUPTED = """
import signal, sys
import numpy as np
from geraf2.geometry.nearest import nearest_distance
signal.signal(signal.SIGTERM, signal.default_int_handler)
def work():
    rng = np.random.default_rng(0)
    to, points = rng.normal(size=(20000, 3)), rng.normal(size=(400_000, 3))
    print("go", flush=True)
    nearest_distance(points, to, num_threads=2)
try:
    work()
except KeyboardInterrupt:
    np.ones(10_000_000)  # into the memory of the arrays
    print("interrupted")
"""


def test_a_signal_while_threads_look_for_neighbours_is_no_crash():
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "go\n"
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=120)[0] == "interrupted\n"
    assert process.returncode == 0


STOPPED_TWICE = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.SIG_DFL)  # a job in the background has it ignored
from geraf2.cli import main
def slow(rest, asked, n_threads):
    try:
        print("go", flush=True)
        time.sleep(60)
    finally:
        time.sleep(0.3)  # cleaning up
        print("cleaned", flush=True)
main._dispatch, sys.argv = slow, ["geraf2", "info", "scene"]
main.run()
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_second_signal_does_not_disturb_the_cleaning_up(number, code):
    with subprocess.Popen(
        [sys.executable, "-c", STOPPED_TWICE],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "go\n"
        for _ in range(3):
            process.send_signal(number)
        out, error = process.communicate(timeout=60)
    assert (process.returncode, out) == (code, "cleaned\n")
    assert error == "geraf2: interrupted; nothing was written\n"


@pytest.mark.parametrize(
    "work",
    [
        # A library that makes another error of it, as C extensions do while they are imported.
        "try:\n        stop()\n    except KeyboardInterrupt:\n        raise ImportError('failed')",
        # A destructor, which swallows what is raised in it.
        "type('D', (), {'__del__': lambda self: stop()})()\n    time.sleep(5)",
        # What it left half made complains when it goes.
        "half = type('H', (), {'__del__': lambda self: self.missing})()\n    stop()",
        # A task that nobody waits for any more, as of a store that is being opened.
        "import asyncio\n    task = asyncio.new_event_loop().create_future()\n"
        "    task.set_exception(FileNotFoundError('.zgroup'))\n    stop()",
        # A library that drops whatever is raised while it imports another, as several do.
        "import greedy\n    time.sleep(5)",
    ],
)
def test_signal_that_others_swallow_ends_the_command(work, tmp_path):
    (tmp_path / "greedy.py").write_text("try:\n    import slow\nexcept BaseException:\n    pass\n")
    slow = "import os, time\nos.kill(os.getpid(), 15)\ntime.sleep(0.1)\n"
    (tmp_path / "slow.py").write_text(slow)
    code = f"""
import os, sys, time
from geraf2.cli import main
sys.path.insert(0, "")
def stop():
    os.kill(os.getpid(), 15)
    time.sleep(0.1)
def dispatch(rest, asked, n_threads):
    {work}
main._dispatch, sys.argv = dispatch, ["geraf2", "doctor"]
main.run()
"""
    command = [sys.executable, "-c", code]
    how = {"capture_output": True, "text": True, "timeout": 60, "cwd": tmp_path}
    done = subprocess.run(command, check=False, **how)
    assert done.returncode == 128 + signal.SIGTERM
    assert "interrupted" in done.stderr
    assert len(done.stderr.splitlines()) == 1
