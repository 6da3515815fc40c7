"""`geraf2 reconstruct --preset` of the methods to compare with, on the small scene."""

import json

import pytest

from geraf2.cli.main import main
from geraf2.fields import SdfGrid
from geraf2.io.checkpoint import load_checkpoint
from geraf2.io.mesh import read_mesh
from geraf2.learned.checkpoints import KIND, VERSION, config_of
from geraf2.learned.model import DOMAIN_MARGIN
from helpers.small_scene import BOX

UNCHECKED = ["--calibrate", "no", "--trust-los", "--no-report"]
COARSE = {
    "matched-filter": "--matched-filter.spacing-m 0.01",
    "back-projection": "--back-projection.spacing-m 0.01",
    "normal-field": "--normal-field.spacing-m 0.01 --normal-field.level.n-levels 3 "
    "--normal-field.level.n-planes 1 --normal-field.level.n-points 2000",
}


@pytest.mark.parametrize("preset", COARSE)
def test_a_baseline_makes_a_run_that_can_be_evaluated(preset, built_scene, tmp_path):
    out = tmp_path / "out"
    arguments = ["reconstruct", str(built_scene), str(out), *BOX, "--preset", preset, *UNCHECKED]
    assert main([*arguments, *COARSE[preset].split()]) == 0
    content = read_mesh(out / "mesh_content.ply")
    assert content.faces.shape[0] > 20
    assert abs(content.vertices).max() < 0.1  # the box is cropped out
    truth = ["--truth", str(built_scene / "truth.ply"), "--n-samples", "500"]
    assert main(["evaluate", str(out), *truth]) == 0
    # As coarse as this scene is, the scores mean nothing; only their presence counts.
    assert json.loads((out / "metrics.json").read_text())["truth_to_mesh"]["median_m"] < 0.1


def test_geraf1_trains_inside_the_cropped_box_and_is_not_rendered(built_scene, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["reconstruct", str(built_scene), str(out), *BOX, "--preset", "geraf1", *UNCHECKED]
    small = (
        "--paper.stage1.n-steps 3 --paper.n-cells 8 --paper.n-samples 8 --paper.n-antennas 16 "
        "--paper.n-targets 64 --paper.mesh-n 25 --paper.grid-n 17 --level.n-levels 3 "
        "--level.n-planes 1 --level.n-points 1000"
    )
    assert main([*arguments, *small.split()]) == 0
    fields = load_checkpoint(out / "fields.safetensors", kind=KIND, version=VERSION)
    config = config_of(fields.header, out)
    assert not config.ulos
    assert config.stage2.n_steps == 0
    assert config.stage1.train_reflectivity
    sdf = SdfGrid.load(out / "sdf_fit.npz")
    cropped = 0.5 * DOMAIN_MARGIN * (0.2 - 2 * config.crop_m)
    assert [axis[-1] for axis in sdf.grid.axes_m] == pytest.approx([cropped] * 3)
    assert main(["render", str(out)]) == 2
    assert "fast, best, paper or paper-corrected, got geraf1" in capsys.readouterr().err
