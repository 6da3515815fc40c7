"""`--preset best` from the command line: its stages, and what runs again."""

import json
import shutil
import tomllib

import pytest

from geraf2.cli.main import main
from geraf2.echoes import Glints
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import RunFolder
from helpers.small_scene import BOX, QUICK_BEST

AFTERWARDS = ("selection", "sdf", "mesh")
FIRST = ("calibration", "glints")
ALL = (*FIRST, *AFTERWARDS)


def run(scene, out, *more):
    arguments = ["reconstruct", str(scene), str(out), *BOX, *QUICK_BEST, "--no-report"]
    return main([*arguments, "--preset", "best", *more])


def stages(out):
    events = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    last = [k for k, e in enumerate(events) if e["event"] == "start"][-1]
    return [(e["event"], e["stage"]) for e in events[last:] if e["event"] in {"reused", "done"}]


@pytest.fixture(scope="module")
def built(built_scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("best") / "out"
    assert run(built_scene, out) == 0
    return out


@pytest.fixture
def finished(built, tmp_path):
    return shutil.copytree(built, tmp_path / "finished")


def test_a_run_has_linked_glints_and_those_of_the_rim(built):
    assert set(RunFolder.read(built).stages) == {"box", *ALL}
    assert len(Glints.load(built / "rim_glints.npz")) > 50
    assert read_mesh(built / "mesh_content.ply").expected_error_m.min() > 0
    config = tomllib.loads((built / "config.toml").read_text())
    assert config["preset"] == "best"
    assert config["refine"]["rim"]["sizes_m"] == [0.06, 0.04]


def test_a_run_searches_silhouettes_unless_switched_off(finished, scene):
    found = Silhouettes.load(finished / "silhouettes.npz")
    assert RunFolder.read(finished).stages["selection"].numbers["outlines"] == len(found)
    assert run(scene, finished, "--resume", "--overwrite", "--refine.no-shadows") == 0
    assert stages(finished) == [*(("reused", n) for n in FIRST), *(("done", n) for n in AFTERWARDS)]
    assert not (finished / "silhouettes.npz").exists()


def test_a_run_of_fast_continues_as_best(built_run, scene, tmp_path):
    out = shutil.copytree(built_run, tmp_path / "run")
    assert run(scene, out, "--resume", "--overwrite") == 0
    assert stages(out) == [*(("reused", n) for n in FIRST), *(("done", n) for n in AFTERWARDS)]
