"""`--preset best` from the command line: its steps and files."""

import tomllib

from geraf2.cli.main import main
from geraf2.echoes import Glints
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import RunFolder
from helpers.small_scene import BOX, QUICK_BEST


def run(scene, out, *more):
    arguments = ["reconstruct", str(scene), str(out), *BOX, *QUICK_BEST, "--no-report"]
    return main([*arguments, "--preset", "best", *more])


def test_a_run_has_glints_of_the_rim_and_outlines_unless_switched_off(built_scene, tmp_path):
    out = tmp_path / "out"
    assert run(built_scene, out) == 0
    stages = RunFolder.read(out).stages
    assert [*stages] == ["box", "calibration", "glints", "selection", "sdf", "mesh", "verdict"]
    assert len(Glints.load(out / "rim_glints.npz")) > 50
    assert stages["selection"].numbers["outlines"] == len(Silhouettes.load(out / "silhouettes.npz"))
    assert read_mesh(out / "mesh_content.ply").expected_error_m.min() > 0
    config = tomllib.loads((out / "config.toml").read_text())
    assert config["preset"] == "best"
    assert config["refine"]["rim"]["sizes_m"] == [0.06, 0.04]
    assert run(built_scene, out, "--overwrite", "--refine.no-shadows") == 0
    assert not (out / "silhouettes.npz").exists()
