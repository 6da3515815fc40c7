"""A small simulated scene, reconstructed once for all tests of the command line."""

import shutil

import pytest

from geraf2.cli.main import main
from helpers.drawing import drawn, not_drawn  # noqa: F401 - fixtures of the tests here
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
def built_run(built_scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    assert main(["reconstruct", str(built_scene), str(out), *BOX, *FAST]) == 0
    return out


@pytest.fixture
def finished_run(built_run, tmp_path):
    return shutil.copytree(built_run, tmp_path / "finished")
