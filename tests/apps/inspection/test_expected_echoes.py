"""Poses and absent parts by the echoes that a placed model should send."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import geraf2
from geraf2.apps.inspection.deviation import deviation_of
from geraf2.apps.inspection.echo_shares import PatchEchoes, share_of
from geraf2.apps.inspection.expected_echoes import (
    ExpectedEchoes,
    normal_equations,
)
from geraf2.apps.inspection.matching import Match, refine_by_echoes
from geraf2.apps.inspection.models import model_of
from geraf2.geometry.transforms import rigid
from geraf2.io.mesh import write_mesh
from geraf2.simulation.spec import FigureSpec, NumericsSpec, ScanSpec, SceneSpec
from helpers.inspected import block, measured_body, placement
from helpers.solids import joined, triangles

BOX_M = (0.14, 0.14, 0.14)
STUD = block((0.01, 0.01, 0.01), (-0.03, 0.0, 0.0), 0.002)


def prism():
    """Hexagonal, 5 cm high; each side faces one of 12 planes."""
    made = trimesh.creation.cylinder(radius=0.03, height=0.05, sections=6).subdivide_to_size(0.01)
    made.merge_vertices()
    return triangles(made)


def placed(pose):
    return placement(pose, 1e-6 * np.eye(6))


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """Echoes of a prism in a box."""
    path = tmp_path_factory.mktemp("part") / "prism.ply"
    write_mesh(prism(), path)
    spec = SceneSpec(
        figure=FigureSpec(mesh=str(path), height_m=0.05),
        walls=(geraf2.Wall(size_m=BOX_M, thickness_m=0.004, permittivity=1.6),),
        scan=ScanSpec(n_poses=12, spacing_m=0.006, aperture_m=(0.10, 0.14)),
        numerics=NumericsSpec(wall_patch_m=0.02, antenna_block_m=0.07),
    )
    capture = geraf2.simulate(spec, seed=0)[0]
    return ExpectedEchoes(capture, geraf2.LosPrior.from_box(BOX_M, walls=capture.walls))


def test_a_pose_that_is_off_by_degrees_is_put_right(expected):
    turn = Rotation.from_rotvec(np.deg2rad((-4.0, 1.0, 6.0))).as_matrix()
    (found,) = expected.match([prism()], [placed(rigid(turn, [5e-4, -4e-4, 3e-4]))])
    off = found.placement.pose[:3, 3]
    angle = Rotation.from_matrix(found.placement.pose[:3, :3]).magnitude()
    assert np.abs(off).max() < 4e-4
    assert np.rad2deg(angle) < 0.15
    assert (np.abs(off) < 4.0 * found.placement.position_sigma_m).all()
    assert found.explained > 0.7
    assert found.patches.silent == ()
    value, sigma = found.patches.shares.T
    certain = sigma < 0.2
    assert certain.mean() > 0.1
    assert value[certain].min() > 0.5


def test_what_sends_no_echo_is_absent(expected):
    model = joined(prism(), STUD)
    (found,) = expected.match([model], [placed(np.eye(4))])
    body = measured_body(prism(), np.eye(4))
    assert np.abs(found.placement.pose[:3, 3]).max() < 5e-4
    deviation = deviation_of(body, model, found.placement, 0.002, echoes=found.patches)
    absent = [region for region in deviation.regions if region.what == "absent"]
    assert len(absent) == 1
    assert absent[0].center_m == pytest.approx((-0.032, 0.0, 0.0), abs=4e-3)
    # Where the surface is there within the tolerance, a missing echo proves nothing.
    whole = measured_body(model, np.eye(4))
    there = deviation_of(whole, model, found.placement, 0.002, echoes=found.patches)
    assert [region for region in there.regions if region.what == "absent"] == []


def test_of_two_models_the_one_that_is_absent_is_reported(expected):
    gone = block((0.012, 0.02, 0.03), (-0.044, 0.0, 0.0), 0.004)
    models = [model_of(prism(), "prism"), model_of(gone, "gone")]
    matches = [
        Match(model=m, body=m, placement=placed(np.eye(4)), status="present") for m in range(2)
    ]
    found, patches = refine_by_echoes(matches, models, expected)
    assert [match.status for match in found] == ["present", "missing"]
    assert found[1].placement is None
    assert list(patches) == [0]
    assert patches[0].whole.value == pytest.approx(1.0, abs=0.2)


def test_errors_of_motions_are_as_large_as_stated():
    """Linear heat maps, each plane with its own gain; noise that neighbouring targets share."""
    rng, pulls = np.random.default_rng(0), []
    for _ in range(40):
        views, images, true = [], [], 1e-4 * rng.normal(size=6)
        for plane in range(36):
            image = rng.normal(size=(60, 7)) + 1j * rng.normal(size=(60, 7))
            image[:, 1:] *= 3e3
            noise = np.repeat(rng.normal(size=12) + 1j * rng.normal(size=12), 5)
            gain = rng.normal() + 1j * rng.normal()
            seen = gain * (image[:, 0] + image[:, 1:] @ true + 0.3 * noise)
            window = SimpleNamespace(plane=plane, measured=seen)
            views.append(SimpleNamespace(window=window))
            images.append(image[:, None])
        found = normal_equations(views, images, "plane")
        step = found.step([placed(np.eye(4))])[0]
        again = [i.copy() for i in images]
        for i in again:  # scores are those of the answer
            i[:, 0, 0] += i[:, 0, 1:] @ step
        covariance = normal_equations(views, again, "plane").covariance([placed(np.eye(4))])
        pulls.append((step - true) / np.sqrt(np.diag(covariance) - 5e-5**2))
    # 240 numbers of deviation one lie within 0.9 to 1.1; six of twelve scores are used up.
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.35


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_the_share_of_an_echo_that_came(share):
    rng = np.random.default_rng(1)
    windows = []
    for group in range(6):
        echo, rest = (rng.normal(size=200) + 1j * rng.normal(size=200) for _ in range(2))
        windows.append(PatchEchoes(group, (share - 1.0) * echo + 0.2 * rest, {3: echo}))
    found = share_of(windows, [3])
    assert found.value == pytest.approx(share, abs=0.03)
    # 0.46 of 0.2 over the root of two and of six groups, were all targets in phase
    assert found.sigma == pytest.approx(0.46 * 0.2 / np.sqrt(12), rel=0.3)
    assert share_of(windows, [4]).sigma == np.inf
