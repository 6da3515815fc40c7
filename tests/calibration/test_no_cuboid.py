"""Walls that fit no cuboid are refused: from exact flashes, and of a tube."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2 import examples, simulate
from geraf2.calibration.box_finder import find_box
from geraf2.calibration.box_search import Flashes
from geraf2.calibration.found_box import NoCuboidError, Seen
from geraf2.cli.main import main
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.pipeline import box_check
from geraf2.pipeline.events import Listener
from geraf2.scene import LosPrior
from geraf2.scene.store import save_capture
from helpers.carton import carton_capture
from helpers.synthetic import WAVEFORM

RADIUS_M, TUBE_M = 0.06, 0.09
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


def tube_signal(tx, rx):
    """Echoes of an upright tube, from the front and, through it, from behind."""
    away = np.hypot(*(0.5 * (tx + rx))[:, :2].T)
    total = 2.0 * np.stack([away - TUBE_M, away + TUBE_M], axis=1) + WAVEFORM.path_bias_m
    phase = 2.0 * np.pi / SPEED_OF_LIGHT_M_PER_S * total[..., None] * WAVEFORM.frequencies_hz
    signal = (np.array([[1.0], [0.5]]) * np.exp(-1j * phase)).sum(axis=1)
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, *signal.shape))
    return signal + noise[0] + 1j * noise[1]


@pytest.fixture(scope="module")
def scan():
    """Spheres in a tube, and the outside of the tube."""
    capture = carton_capture(n_poses=16, wall=0.0)
    poses = tuple(
        replace(p, signal=(p.signal + tube_signal(p.tx_positions, p.rx_positions)).astype("c8"))
        for p in capture.poses
    )
    made = trimesh.creation.cylinder(TUBE_M, 0.2, 48)
    outside = TriangleMesh(vertices=np.array(made.vertices), faces=np.array(made.faces))
    return replace(capture, poses=poses, walls=()), outside


def test_a_tube_is_refused_in_one_line_and_its_mesh_is_used(scan, tmp_path, capsys):
    capture, outside = scan
    save_capture(capture, tmp_path / "scene")
    write_mesh(outside, tmp_path / "tube.ply")
    command = ["reconstruct", str(tmp_path / "scene"), str(tmp_path / "out"), "--preset", "fast"]
    command += ["--fit.spacing-m", "0.01"]
    assert main([*command, "--no-report"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "the walls of the box fit no cuboid" in line
    assert "give the outside of the box with --los MESH, or --box X Y Z" in line
    assert not (tmp_path / "out" / "mesh_content.ply").exists()
    assert main([*command, "--no-report", "--los", str(tmp_path / "tube.ply")]) == 0
    assert (tmp_path / "out" / "mesh_content.ply").is_file()


def test_a_given_cuboid_is_kept_with_a_warning_and_a_mesh_without(scan):
    capture, outside = scan
    with pytest.raises(NoCuboidError, match="fit no cuboid"):
        find_box(capture)
    cuboid = LosPrior.from_box((0.2, 0.2, 0.2))
    for prior, name, what, is_warning in (
        (cuboid, "--box", "the prior", True),
        (cuboid, box_check.STATED, box_check.STATED, True),
        (LosPrior.from_mesh(outside), "--los", "the prior", False),
    ):
        check = box_check.check_prior(capture, prior, name, None, Listener(), None)
        assert check.prior is prior
        assert check.is_warning == is_warning
        assert check.text.startswith(f"the walls of the box fit no cuboid: {what} could not be")


def test_a_box_with_skewed_corners_is_found_by_the_walls_that_fit():
    """The walls across x are 8 degrees off their right angles to the others."""
    spec = examples.small_scene()
    wall = replace(spec.walls[0], size_m=(0.16, 0.16, 0.18))
    world = replace(spec.world, box_skew_deg=8.0)
    spec = replace(spec, walls=(wall,), scan=replace(spec.scan, n_poses=8), world=world)
    box = find_box(simulate(spec, seed=0)[0])
    assert (box.seen[:2] == Seen.SQUARELY).all(axis=1).tolist() == [True, False]
    assert box.size_m[0] == pytest.approx(0.16, abs=3e-3)
