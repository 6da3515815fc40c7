"""`geraf2 compare`: what appeared, vanished and moved, on parts that are made up."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import geraf2
from geraf2.apps.inspection.bodies import split_bodies
from geraf2.apps.inspection.comparison import (
    Scanned,
    body_shift,
    common_changes,
    compared,
    registered,
)
from geraf2.cli.main import main
from geraf2.geometry.transforms import apply_rigid, rigid
from helpers.inspected import block, measured, run_of, wedge
from helpers.solids import joined

HERE = np.eye(4)
CUBES = [block((0.02,) * 3, (x, 0.0, 0.0), 0.003) for x in (-0.05, 0.0, 0.05)]


def scanned(*meshes, pose=HERE, seed=0):
    whole = measured(joined(*meshes), pose, sigma_m=3e-4, seed=seed)
    return Scanned(whole, split_bodies(whole))


def kinds(changes):
    return sorted((change.what, change.is_body) for change in changes)


def test_a_second_scan_of_the_same_is_unchanged():
    changes, share = compared(scanned(*CUBES, seed=1), scanned(*CUBES), HERE, 0.002)
    assert changes == []
    assert share == 1.0


def test_a_part_that_is_gone_vanished_and_the_reverse_appeared():
    changes, _ = compared(scanned(*CUBES[:2], seed=1), scanned(*CUBES), HERE, 0.002)
    (gone,) = changes
    assert (gone.what, gone.is_body) == ("vanished", True)
    assert gone.center_m == pytest.approx((0.05, 0.0, 0.0), abs=1e-3)
    changes, _ = compared(scanned(*CUBES, seed=1), scanned(*CUBES[:2]), HERE, 0.002)
    assert kinds(changes) == [("appeared", True)]


def test_a_moved_part_has_its_shift_and_surface_that_grew_appeared():
    moved = replace(CUBES[2], vertices=CUBES[2].vertices + np.array([0, 0.005, 0]))
    changes, _ = compared(scanned(*CUBES[:2], moved, seed=1), scanned(*CUBES), HERE, 0.002)
    (change,) = changes
    assert (change.what, change.is_body) == ("moved", True)
    assert change.size_m == pytest.approx(0.005, abs=4 * change.sigma_m)
    assert change.probability > 0.99
    x, y, z = CUBES[1].vertices.T
    taller = replace(CUBES[1], vertices=np.stack([x, y, z + 0.004 * (z > 0.0099)], axis=1))
    changes, _ = compared(scanned(CUBES[0], taller, CUBES[2]), scanned(*CUBES), HERE, 0.002)
    assert kinds(changes) == [("appeared", False)]
    assert changes[0].center_m == pytest.approx((0.0, 0.0, 0.014), abs=3e-3)


def test_a_parcel_put_down_elsewhere_is_registered():
    """By 5 mm and 3 degrees: the pose comes from the content, and nothing changed."""
    parts = [wedge(), block((0.03, 0.02, 0.04), (0.07, 0.01, 0.0))]
    turn = Rotation.from_rotvec(np.deg2rad([0.5, -0.5, 3.0])).as_matrix()
    pose = rigid(turn, np.array([0.003, -0.004, 0.001]))
    here, there = scanned(*parts, pose=pose, seed=1), scanned(*parts)
    found = registered(here.whole, there.whole, HERE)
    points = here.whole.mesh.vertices
    assert np.abs(apply_rigid(found @ pose, parts[0].vertices) - parts[0].vertices).max() < 5e-4
    assert np.abs(apply_rigid(found, points) - points).max() > 0.004
    changes, _ = compared(here, there, found, 0.002)
    assert changes == []


def test_the_shift_of_a_part_scatters_as_stated():
    """Slow twin: scans of a part that did not move, their errors independent between vertices."""
    part = block((0.03, 0.02, 0.025), edge_m=0.009)  # a vertex a patch
    shifts, sigmas = [], []
    for seed in range(40):
        here = measured(part, HERE, sigma_m=3e-4, seed=2 * seed)
        there = measured(part, HERE, sigma_m=3e-4, seed=2 * seed + 1)
        shift, covariance = body_shift(here, there)
        shifts.append(shift)
        sigmas.append(np.sqrt(np.diag(covariance)))
    ratio = np.std(shifts, axis=0) / np.mean(sigmas, axis=0)
    assert (ratio > 0.2).all()
    assert (ratio < 1.3).all()


def test_a_change_must_differ_from_every_reference():
    usual, other = scanned(*CUBES), scanned(*CUBES[:2])
    here = scanned(*CUBES, seed=1)
    found = [compared(here, reference, HERE, 0.002)[0] for reference in (usual, other)]
    assert common_changes(found) == ()
    twice = [compared(here, other, HERE, 0.002)[0]] * 2
    assert kinds(common_changes(twice)) == [("appeared", True)]


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("packed") / "run", *CUBES, pose=HERE)


def test_exit_codes_and_json(packed, tmp_path, capsys):
    assert main(["compare", str(packed), str(packed)]) == 0
    assert "result   unchanged" in capsys.readouterr().out
    robbed = run_of(tmp_path / "robbed", *CUBES[:2], pose=HERE)
    assert main(["compare", str(robbed), str(packed), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["changed"] is True
    assert found["n_parts"] == [2, 3]
    assert [change["what"] for change in found["changes"]] == ["vanished"]
    assert geraf2.compare(robbed, [packed, robbed]).changes == ()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"box_m": (0.2, 0.25, 0.2)}, "is of another box"),
        ({"wavelength_m": 0.005}, "is of another radar"),
    ],
)
def test_a_reference_of_something_else_is_one_line(packed, tmp_path, capsys, options, text):
    other = run_of(tmp_path / "other", *CUBES, pose=HERE, **options)
    assert main(["compare", str(packed), str(other)]) == 2
    error = capsys.readouterr().err.strip()
    assert text in error
    assert len(error.splitlines()) == 1
    assert main(["compare", str(packed), str(tmp_path / "none")]) == 2
