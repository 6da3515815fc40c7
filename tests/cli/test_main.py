import errno
import importlib
import logging
import os
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from geraf2 import __version__
from geraf2.cli import _console, doctor, info
from geraf2.cli._console import CONSOLE, rows, say, show_output, warn
from geraf2.cli.main import COMMANDS, describe_error, main
from geraf2.errors import UserError


@pytest.mark.parametrize(
    ("words", "code", "texts"),
    [
        (["--help"], 0, [f"  {name} " for name in COMMANDS]),
        ([], 2, ["usage: geraf2"]),
        (["--version"], 0, [f"geraf2 {__version__}\n"]),
    ],
)
def test_the_command_alone(words, code, texts, capsys):
    assert main(words) == code
    printed = capsys.readouterr().out
    assert all(text in printed for text in texts)


def test_progress_where_no_one_watches_is_a_line_a_minute(monkeypatch, capsys):
    now = [0.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], perf_counter=lambda: now[0])
    monkeypatch.setattr(_console, "time", clock)
    with CONSOLE.step("train") as progress:
        for step in range(100, 400):  # a run that continues from step 100
            progress(step / 1000)
            now[0] += 0.5
    assert capsys.readouterr().err.splitlines() == [
        "train ...",
        "train: 22 %, 0:06:30 left",
        "train: 34 %, 0:05:30 left",
        "train: 150.0 s",
    ]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_and_rejects_unknown_flags(name, capsys):
    assert main([name, "--help"]) == 0
    shown = capsys.readouterr().out
    assert f"geraf2 {name}" in shown
    assert not re.search(r"^ {4}\S", shown, re.MULTILINE)  # indented as in the source
    assert main([name, "--no-such-flag"]) == 2
    assert capsys.readouterr().err != ""


def test_help_is_quick_because_nothing_heavy_is_imported():
    code = (
        "import sys; from geraf2.cli.main import main; main(['--help']); "
        "heavy = {'numpy', 'torch', 'zarr', 'tyro', 'rich', 'matplotlib', 'scipy', 'pydantic'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (UserError("bad", where="file"), 2, "error: file: bad"),
        (KeyboardInterrupt(), 130, "interrupted; nothing was written"),
        (KeyboardInterrupt(signal.SIGTERM), 143, "interrupted; nothing was written"),
        (OSError(errno.ENOSPC, "No space"), 2, "error: the disk is full; nothing was written"),
        (OSError(errno.EACCES, "Permission denied", "x"), 2, "Permission denied"),
        (MemoryError(), 2, "error: not enough memory"),
        (SystemError("error return without exception set"), 2, "error: not enough memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), 2, "not enough memory"),
        (RuntimeError("first\nsecond"), 1, "internal error: RuntimeError: first second; --debug"),
        (ValueError(), 1, "internal error: ValueError: ValueError"),
    ],
)
def test_every_error_is_one_line_with_its_code(monkeypatch, capsys, error, code, text):
    def fail(config):
        raise error

    monkeypatch.setattr(info, "main", fail)
    assert main(["info", "scene"]) == code
    printed = capsys.readouterr().err
    assert text in printed
    assert printed.count("\n") == 1


def test_debug_shows_the_traceback_wherever_it_stands(capsys):
    for arguments in (["--debug", "info", "x"], ["info", "x", "--debug"]):
        assert main(arguments) == 2
        assert "Traceback" in capsys.readouterr().err


def test_an_interrupted_command_names_how_to_continue_only_if_it_can():
    for command in COMMANDS.values():
        message, _ = describe_error(KeyboardInterrupt(), command)
        module = importlib.import_module(f"geraf2.cli.{command.module}")
        assert ("--resume" in message) == hasattr(module.Config, "resume")


def test_doctor_finds_a_working_machine(capsys):
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    for word in ("numpy", "kernels use", "Embree", "threads", "everything works"):
        assert word in text


def test_doctor_names_what_does_not_work(monkeypatch, capsys):
    def broken():
        msg = "no such device"
        raise RuntimeError(msg)

    monkeypatch.setattr(doctor, "_check_embree", broken)
    assert main(["doctor"]) == 2
    captured = capsys.readouterr()
    assert "FAILS: RuntimeError: no such device" in captured.out
    assert captured.err == "geraf2: error: Embree does not work on this machine\n"


def test_control_characters_of_names_do_not_reach_the_terminal(capsys):
    name = "a\x1b[2J\r\nerror: b\u202e\udcff é"
    say(name)
    rows([("scene", name)])
    warn(name)
    CONSOLE.note(name)
    with show_output("info"):
        logging.getLogger("geraf2.test").warning(name)
    assert main(["info", name]) == 2
    stated = capsys.readouterr()
    assert stated.out.count(r"a\x1b[2J\r\nerror: b\u202e\udcff é") == 2
    for text in (stated.out, stated.err):
        assert all(line.isprintable() for line in text.splitlines())
        assert "\r" not in text
    assert len(stated.err.splitlines()) == 4


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("OMP_NUM_THREADS", "99999", "OMP_NUM_THREADS: too many threads, expected at most 1024"),
        ("OMP_NUM_THREADS", "9" * 5000, "OMP_NUM_THREADS: too many threads"),
        ("GERAF2_SIMD", "evil", "GERAF2_SIMD must be baseline, avx2 or avx512, got evil"),
    ],
)
def test_an_environment_that_would_end_the_process_is_named(name, value, line, monkeypatch, capsys):
    monkeypatch.setenv(name, value)
    assert main(["doctor"]) == 2
    assert line in capsys.readouterr().err


def test_pictures_do_not_depend_on_a_backend_of_matplotlib():
    code = "from geraf2.cli.main import main; main(['--version']); import matplotlib.figure"
    environment = {**os.environ, "MPLBACKEND": "evil"}
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, env=environment)


def test_a_missing_library_is_named_with_what_to_install():
    code = (
        "import sys\n"
        "class Missing:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'geraf2._core':\n"
        "            raise ImportError('libembree4.so.4: cannot open shared object file: x')\n"
        "sys.meta_path.insert(0, Missing())\n"
        "from geraf2.cli.main import main\n"
        "sys.exit(main(['info', 'scene']))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "the kernels need libembree4.so.4" in done.stderr
    assert "apt install libembree" in done.stderr
