"""A small simulated scene, reconstructed once for all tests of the command line."""

import io
import shutil
from contextlib import redirect_stderr, redirect_stdout
from types import SimpleNamespace

import pytest

from geraf2.cli.main import main
from helpers.drawing import drawn, not_drawn  # noqa: F401 - fixtures of the tests here
from helpers.found_boxes import box_found_once  # noqa: F401 - as above
from helpers.small_scene import BOX, FAST, SPEC


@pytest.fixture(scope="session")
def built_scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli")
    (folder / "spec.toml").write_text(SPEC)
    assert main(["simulate", str(folder / "spec.toml"), str(folder / "scene")]) == 0
    return folder / "scene"


@pytest.fixture
def scene(built_scene, tmp_path):
    return shutil.copytree(built_scene, tmp_path / "scene")


@pytest.fixture(scope="session")
def told_run(built_scene, tmp_path_factory):
    """The whole run: its folder, and what the command printed with --json and --verbose."""
    folder, out, err = tmp_path_factory.mktemp("run") / "out", io.StringIO(), io.StringIO()
    flags = [*BOX, *FAST, "--samples", "6", "--json", "--verbose"]
    with redirect_stdout(out), redirect_stderr(err):
        assert main(["reconstruct", str(built_scene), str(folder), *flags]) == 0
    return SimpleNamespace(path=folder, out=out.getvalue(), err=err.getvalue())


@pytest.fixture(scope="session")
def built_run(told_run):
    return told_run.path


@pytest.fixture
def finished_run(built_run, tmp_path):
    return shutil.copytree(built_run, tmp_path / "finished")
