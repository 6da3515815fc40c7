"""`--preset best` from the command line: its steps and files."""

import tomllib

from geraf2.cli.main import main
from geraf2.echoes import Glints
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import RunFolder
from helpers.small_scene import BOX, QUICK_BEST


def test_a_run_has_glints_and_outlines(built_scene, tmp_path):
    out, flags = tmp_path / "out", [*BOX, *QUICK_BEST, "--no-report", "--preset", "best"]
    assert main(["reconstruct", str(built_scene), str(out), *flags]) == 0
    stages = RunFolder.read(out).stages
    assert [*stages] == ["box", "calibration", "glints", "outlines", "sdf", "mesh", "verdict"]
    assert len(Glints.load(out / "glints.npz")) > 50
    assert stages["outlines"].numbers["outlines"] == len(Silhouettes.load(out / "silhouettes.npz"))
    assert read_mesh(out / "mesh_content.ply").expected_error_m.min() > 0
    config = tomllib.loads((out / "config.toml").read_text())
    assert config["preset"] == "best"
    assert config["refine"]["shadows"] is True
