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
from geraf2.cli._console import CONSOLE, printing, rows, say, warn
from geraf2.cli.main import COMMANDS, describe_error, main
from geraf2.errors import UserError


def test_help_lists_every_command(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in COMMANDS)


def test_no_command_shows_the_help_and_fails(capsys):
    assert main([]) == 2
    assert "usage: geraf2" in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"geraf2 {__version__}\n"


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
    words = COMMANDS[name].usage.replace("[", "").replace("]", "").split()
    assert main([name, *words, "--no-such-flag"]) == 2
    assert capsys.readouterr().err != ""


def test_help_of_reconstruct_fits_one_screen_and_names_the_command_for_photos(capsys):
    assert main(["reconstruct", "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 60
    text = " ".join(" ".join(lines).split())
    assert "--photos: Options of the photos of --los, explained by `geraf2 los --help`" in text
    assert "to-radar, camera-axes" in text


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
        (
            OSError(errno.ENOSPC, "No space left on device"),
            2,
            "error: the disk is full; nothing was written",
        ),
        (OSError(errno.EACCES, "Permission denied", "x"), 2, "Permission denied"),
        (MemoryError(), 2, "error: not enough memory"),
        (SystemError("error return without exception set"), 2, "error: not enough memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), 2, "not enough memory"),
        (RuntimeError("first\nsecond"), 1, "internal error: RuntimeError: first second; --debug"),
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


@pytest.mark.parametrize("arguments", [["--debug", "info", "x"], ["info", "x", "--debug"]])
def test_debug_shows_the_traceback_wherever_it_stands(capsys, arguments):
    assert main(arguments) == 2
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("name", list(COMMANDS))
def test_an_interrupted_command_names_how_to_continue_only_if_it_can(name):
    message, code = describe_error(KeyboardInterrupt(), COMMANDS[name])
    assert code == 130
    module = importlib.import_module(f"geraf2.cli.{COMMANDS[name].module}")
    assert ("--resume" in message) == hasattr(module.Config, "resume")


def test_an_error_without_text_is_named():
    assert describe_error(ValueError())[0].startswith("internal error: ValueError: ValueError")


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
    with printing("info"):
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
        ("OMP_NUM_THREADS", "4096,2", "got 4096"),
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


def test_an_error_about_a_long_value_stays_short():
    error = UserError("w" * 9999, where="p" * 9999, expected="e" * 9999, got="g" * 9999, hint="do")
    assert len(str(error)) < 1300
    assert str(error).endswith("; do")


@pytest.mark.parametrize(
    ("command", "out"), [("doctor", "libembree4.so.4, which"), ("info scene", "")]
)
def test_a_missing_library_is_named_with_what_to_install(command, out):
    code = (
        "import sys\n"
        "class Missing:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'geraf2._core':\n"
        "            raise ImportError('libembree4.so.4: cannot open shared object file: x')\n"
        "sys.meta_path.insert(0, Missing())\n"
        "from geraf2.cli.main import main\n"
        f"sys.exit(main({command.split()!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert out in done.stdout
    assert done.stderr.count("\n") == 1
    assert "internal error" not in done.stderr
    if command != "doctor":
        assert "the kernels need libembree4.so.4" in done.stderr
        assert "apt install libembree" in done.stderr
