"""Real faults of the machine: what is there stays whole, and one line names the cause."""

import os
import resource
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from bad_inputs.things import make_foreign
from geraf2 import examples
from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from geraf2.pipeline.commands.verify import verify
from geraf2.scene import save_capture

BOX = [str(side) for side in examples.BOX_M]
COARSE = ["--preset", "fast", "--fit.spacing-m", "0.006"]
COARSE += ["--calibrate", "no", "--trust-los"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults") / "scene"
    save_capture(examples.small_capture()[0], folder)
    return folder


def geraf2_with(*words, limits=(), env=None, cwd=None):
    """Run a command line.

    limits: pairs of RLIMIT_... and how many. env: None takes a name away.
    """

    def limited():
        for kind, most in limits:
            resource.setrlimit(kind, (most, most))

    code = "import sys; from geraf2.cli.main import run; sys.argv[0] = 'geraf2'"
    values = {**os.environ, **(env or {})}
    return subprocess.run(
        [sys.executable, "-c", f"{code}\nrun()", *map(str, words)],
        capture_output=True,
        check=False,
        preexec_fn=limited,
        env={name: value for name, value in values.items() if value is not None},
        cwd=cwd,
        timeout=300,
    )


def one_line(done):
    stated = [x for x in done.stderr.decode(errors="replace").splitlines() if "geraf2: " in x]
    assert (done.returncode, len(stated)) == (2, 1), done.stderr
    assert "internal error" not in stated[0]
    return stated[0]


def reconstruct(scene, out, *more, **faults):
    words = ["reconstruct", scene, out, "--box", *BOX, *COARSE, "--no-report", *more]
    return geraf2_with(*words, **faults)


@pytest.mark.parametrize("size", [40_000, 0])
def test_files_that_cannot_be_written_stop_a_run_in_one_line(scene, tmp_path, size):
    out, limits = tmp_path / "out", [(resource.RLIMIT_FSIZE, size)]
    error = one_line(reconstruct(scene, out, limits=limits))
    assert "File too large" in error
    assert not list(tmp_path.iterdir())


def test_without_room_for_temporary_files_there_is_one_line(scene, tmp_path):
    nowhere = [(resource.RLIMIT_FSIZE, 0)]
    assert geraf2_with("info", scene, limits=nowhere, cwd=tmp_path).returncode == 0
    code = f"import geraf2; geraf2.reconstruct({str(scene)!r}, {examples.BOX_M}, 'fast')"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)),
        cwd=tmp_path,
    )
    stated = b"UserError: there is no folder for temporary files"
    assert done.stderr.splitlines()[-1].startswith(b"geraf2.errors." + stated)


@pytest.mark.parametrize("most", [10, 24])
def test_a_limit_of_open_files_is_one_line(scene, tmp_path, most):
    done = reconstruct(scene, tmp_path / "out", limits=[(resource.RLIMIT_NOFILE, most)])
    if done.returncode == 0:
        verify(tmp_path / "out")
    else:
        assert "Too many open files" in one_line(done)
        assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    make_foreign(folder)
    return folder


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize(
    ("name", "part"),
    [("geraf-sens", "frames"), ("mat", "scan.mat"), ("mmnorm", "norm.npz"), ("planar", "planar")],
)
def test_files_that_vanish_or_shrink_while_they_are_imported(foreign, tmp_path, name, part, cut):
    """After the importer has looked at all of them, before it reads the samples."""
    source = tmp_path / part
    (shutil.copytree if (foreign / part).is_dir() else shutil.copy)(foreign / part, source)
    poses = load_importer(name).open(source, RadarManifest(), ImportOptions()).poses()
    next(poses)
    for path in [source] if source.is_file() else [p for p in source.rglob("*") if p.is_file()]:
        if cut:
            os.truncate(path, path.stat().st_size // 2)
        else:
            path.unlink()
    with suppress(UserError):  # or it was read before
        for _ in poses:
            pass


def test_without_home_and_in_a_locale_that_is_not_utf_8(scene, tmp_path):
    odd = shutil.copytree(scene, tmp_path / "odd")
    text = (odd / "scene.toml").read_text()
    frame = 'frame = "Würfel ²\\u001b[31m"'
    (odd / "scene.toml").write_text(text.replace('frame = "capture"', frame), encoding="utf-8")
    env = {"PATH": os.environ["PATH"], "LC_ALL": "C", "PYTHONUTF8": "0", "HOME": None}
    env |= {"PYTHONIOENCODING": "ascii:strict", "PYTHONCOERCECLOCALE": "0"}
    done = geraf2_with("info", odd, env=env)
    assert done.returncode == 0, done.stderr
    assert rb"W\xfcrfel \xb2\x1b[31m (metres)" in done.stdout
    assert b"\x1b" not in done.stdout
    strange = Path(os.fsdecode(bytes(odd) + b"\xff"))
    odd.rename(strange)
    done = reconstruct(strange, tmp_path / "out", env=env)
    assert done.returncode == 0, done.stderr
    assert verify(tmp_path / "out").notes == ()
    error = one_line(geraf2_with("render", tmp_path / "out", "--angles", "60", env=env))
    assert "name it with --scene" in error
