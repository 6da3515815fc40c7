"""Walls that fit no cuboid are refused: from exact flashes, and from a simulated scan."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2 import examples, simulate
from geraf2.calibration.box_finder import find_box
from geraf2.calibration.box_search import Flashes
from geraf2.calibration.found_box import NoCuboidError
from geraf2.cli.main import main
from geraf2.geometry.boxes import FACES, box_corners
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.pipeline import box_check
from geraf2.pipeline.events import Listener
from geraf2.scene import LosPrior
from geraf2.scene.store import save_capture

RADIUS_M, SIDE_M, SKEW_DEG = 0.06, 0.16, 8.0
SIDES = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])


def flashes(degrees, error_m=0.0, is_metal=False):
    """Sub-apertures around upright walls, one for each direction; each sees those before it."""
    angle = np.deg2rad(degrees)
    toward = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    n, both = len(toward), 1 if is_metal else 2
    return Flashes(
        normals=np.concatenate([toward, -toward])[: both * n],
        offsets_m=RADIUS_M + np.repeat([-error_m, error_m], n)[: both * n],
        far=np.repeat([False, True], n)[: both * n],
        levels_db=np.full(both * n, -6.0),
        weights=np.ones(both * n),
        subapertures=np.tile(np.arange(n), 2)[: both * n],
        centers=0.4 * toward,
        ahead=-toward,
        loss_shift_m=0.0,
    )


@pytest.mark.parametrize(
    ("degrees", "error_m", "is_metal", "counts"),
    [
        (np.arange(0, 360, 10), 0.0, False, (4, 32)),  # a tube
        (np.arange(0, 360, 10), 0.012, False, (4, 32)),
        (np.arange(0, 360, 10), 0.0, True, (0, 0)),
        (np.arange(0, 360, 90), 0.0, False, (4, 0)),
        (np.array([0, 98, 180, 278]), 0.0, False, (2, 2)),  # skewed corners
    ],
)
def test_walls_along_and_beside_the_sides_of_a_cuboid_are_counted(
    degrees, error_m, is_metal, counts
):
    assert flashes(degrees, error_m, is_metal).walls_beside(SIDES) == counts


@pytest.fixture(scope="module")
def scan():
    """The walls across x are 8 degrees off their right angles to the others; and the outside."""
    spec = examples.small_scene()
    wall = replace(spec.walls[0], size_m=(SIDE_M, SIDE_M, 0.18))
    world = replace(spec.world, box_skew_deg=SKEW_DEG)
    spec = replace(spec, walls=(wall,), scan=replace(spec.scan, n_poses=8), world=world)
    corners = box_corners((0.0, 0.0, 0.0), wall.size_m)
    corners[:, 0] += np.tan(np.deg2rad(SKEW_DEG)) * corners[:, 1]
    return simulate(spec, seed=0)[0], TriangleMesh(vertices=corners, faces=FACES.copy())


def test_a_skewed_box_is_refused_in_one_line_and_its_mesh_is_used(scan, tmp_path, capsys):
    capture, outside = scan
    save_capture(capture, tmp_path / "scene")
    write_mesh(outside, tmp_path / "box.ply")
    command = ["reconstruct", str(tmp_path / "scene"), str(tmp_path / "out"), "--preset", "fast"]
    assert main([*command, "--no-report"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "the walls of the box fit no cuboid" in line
    assert "give the outside of the box with --los MESH, or --box X Y Z" in line
    assert not (tmp_path / "out" / "mesh_content.ply").exists()
    assert main([*command, "--no-report", "--los", str(tmp_path / "box.ply")]) == 0
    assert (tmp_path / "out" / "mesh_content.ply").is_file()


def test_a_given_cuboid_is_kept_with_a_warning_and_a_mesh_without(scan):
    capture, outside = scan
    with pytest.raises(NoCuboidError, match="fit no cuboid"):
        find_box(capture)
    for prior, is_warning in (
        (LosPrior.from_box((SIDE_M, SIDE_M, 0.3)), True),
        (LosPrior.from_mesh(outside), False),
    ):
        check = box_check.check_prior(capture, prior, "--box", None, Listener(), None)
        assert check.prior is prior
        assert check.is_warning == is_warning
        assert check.text.startswith("the walls of the box fit no cuboid: the prior was compared")
