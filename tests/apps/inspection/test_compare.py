"""`geraf2 compare`: what appeared, vanished, moved and was swapped, on scans that are made up."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import geraf2
from geraf2.apps.inspection import coherent_change, compare_runs
from geraf2.apps.inspection.bodies import split_bodies
from geraf2.apps.inspection.coherent_change import Signals
from geraf2.apps.inspection.comparison import (
    Play,
    Scanned,
    common_changes,
    compare_scans,
    register_scans,
)
from geraf2.apps.inspection.material import UNKNOWN
from geraf2.apps.inspection.scan_evidence import Cells, Evidence, find_missed, shifts_of
from geraf2.cli.main import main
from geraf2.geometry.transforms import apply_rigid, rigid
from geraf2.io.planes import ScannedPlanes, save_planes
from geraf2.io.points import read_cloud
from geraf2.io.run_folder import PEAKS_NAME, PLANES_NAME, RunFolder
from geraf2.ops import signal_tracer
from geraf2.scene.aperture import Aperture
from helpers.inspected import CUBES, block, glints_of, measured_body, planes_around, run_of, wedge
from helpers.solids import joined

HERE = np.eye(4)
WALLS = Play(turn_rad=0.005, shift_m=0.0005)


def scanned(*meshes, pose=HERE, seed=0, metal=()):
    """Scan of parts, with the probability that each is metal."""
    whole = measured_body(joined(*meshes), pose, sigma_m=3e-4, seed=seed)
    apertures, bodies = planes_around(), split_bodies(whole)
    glints = glints_of(whole, apertures, seed=seed + 100)
    evidence = Evidence(glints, (glints.positions, glints.normals), apertures)
    kinds = {True: "metal", False: "plastic"}
    materials = [replace(UNKNOWN, kind=kinds[p > 0.5], metal_probability=p) for p in metal]
    return Scanned(whole, bodies, evidence, materials or [UNKNOWN] * len(bodies))


def changes_of(here, there, play=WALLS):
    return compare_scans(here, there, HERE, play, 0.0005)[0]


def kinds(changes):
    return sorted((change.what, change.is_body) for change in changes)


def test_a_second_scan_of_the_same_is_unchanged():
    changes, pose, share = compare_scans(
        scanned(*CUBES, seed=1), scanned(*CUBES), HERE, WALLS, 0.0005
    )
    assert changes == []
    assert share > 0.9
    assert pose == pytest.approx(HERE, abs=1e-3)


def test_a_part_that_is_gone_vanished_and_the_reverse_appeared():
    (gone,) = changes_of(scanned(*CUBES[:2], seed=1), scanned(*CUBES))
    assert (gone.what, gone.is_body) == ("vanished", True)
    assert gone.center_m == pytest.approx((0.05, 0.0, 0.0), abs=2e-3)
    assert kinds(changes_of(scanned(*CUBES, seed=1), scanned(*CUBES[:2]))) == [("appeared", True)]


def test_a_part_of_another_shape_or_material_was_swapped():
    other = block((0.012, 0.034, 0.03), (0.05, 0.0, 0.0), 0.003)
    (change,) = changes_of(scanned(*CUBES[:2], other, seed=1), scanned(*CUBES))
    assert change.what == "swapped"
    assert change.center_m == pytest.approx((0.05, 0.0, 0.0), abs=6e-3)
    metal = scanned(*CUBES, metal=(0.99, 0.99, 0.99))
    plastic = scanned(*CUBES, seed=1, metal=(0.99, 0.02, 0.98))
    (change,) = changes_of(plastic, metal)
    assert (change.what, change.is_body) == ("swapped", True)
    assert change.probability == pytest.approx(0.99 * 0.98)


@pytest.mark.parametrize("shift_mm", [(0.0, 4.0, 0.0), (0.0, 0.0, -4.0), (3.0, 3.0, 0.0)])
def test_a_moved_part_has_its_shift(shift_mm):
    shift, middle = 1e-3 * np.array(shift_mm), np.array([0.05, 0.0, 0.0])
    moved = replace(CUBES[2], vertices=CUBES[2].vertices + shift)
    (change,) = changes_of(scanned(*CUBES[:2], moved, seed=1), scanned(*CUBES))
    assert (change.what, change.is_body) == ("moved", True)
    assert change.size_m == pytest.approx(np.linalg.norm(shift), abs=4 * change.sigma_m)
    assert change.center_m == pytest.approx(tuple(middle + shift), abs=1.5e-3)


def test_a_parcel_put_down_elsewhere_is_registered():
    """By 5 mm and 3 degrees, without walls: the pose comes from the content."""
    parts = [wedge(), block((0.03, 0.02, 0.04), (0.07, 0.01, 0.0))]
    turn = Rotation.from_rotvec(np.deg2rad([0.5, -0.5, 3.0])).as_matrix()
    pose = rigid(turn, np.array([0.003, -0.004, 0.001]))
    here, there = scanned(*parts, pose=pose, seed=1), scanned(*parts)
    free = Play(turn_rad=0.05, shift_m=0.005)
    found, _, shifts = register_scans(here, there, HERE, free)
    assert np.abs(apply_rigid(found @ pose, parts[0].vertices) - parts[0].vertices).max() < 5e-4
    assert shifts == {}
    assert changes_of(here, there, free) == []


def test_one_wild_cell_is_no_moved_part_and_many_that_agree_are():
    rng = np.random.default_rng(0)
    normals, at = rng.normal(size=(36, 3)), 0.03 * rng.normal(size=(36, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    parts, e = np.repeat([0, 1, 2], 12), 0.0008 * rng.normal(size=36)
    wild, moved = e.copy(), e + 0.0025 * normals[:, 0] * (parts == 1)
    wild[14] += 0.006
    for distances, wanted in ((wild, []), (moved, [1])):
        cells = Cells(parts, distances, normals, np.cross(at, normals), np.full(36, 0.0008**2))
        assert list(shifts_of(cells, 3, np.zeros(3), WALLS, np.zeros(6))[2]) == wanted


def test_a_scan_without_likely_glints_shows_nothing():
    one = scanned(*CUBES)
    glints = one.evidence.glints.select(np.zeros(0, dtype=int))
    none = one._replace(evidence=one.evidence._replace(glints=glints))
    for pair in ((one, none), (none, one)):
        assert register_scans(*pair, HERE, WALLS)[0] == pytest.approx(HERE)


def test_only_glints_that_the_planes_face_can_be_missed():
    one = scanned(CUBES[0]).evidence
    blind = one._replace(peaks=(np.zeros((1, 3)), np.array([[1.0, 0, 0]])))
    upper = [aperture for aperture in planes_around() if abs(aperture.axes[0][2]) < 0.5]
    visible, missed = find_missed(one, blind._replace(apertures=upper), HERE)
    up = np.abs(one.glints.normals[:, 2]) > 0.9
    assert not visible[up].any()
    assert (missed == visible).all()
    assert visible[~up].any()
    assert not find_missed(one, one, HERE)[1].any()


def test_a_change_must_differ_from_every_reference():
    usual, other = scanned(*CUBES), scanned(*CUBES[:2])
    here = scanned(*CUBES, seed=1)
    found = [changes_of(here, reference) for reference in (usual, other)]
    assert common_changes(found) == ()
    assert kinds(common_changes([changes_of(here, other)] * 2)) == [("appeared", True)]


def test_an_echo_that_came_is_found_by_its_phases(monkeypatch):
    """One of all planes, added to a scan, at a position on the content."""
    run, capture = geraf2.examples.small_run(), geraf2.examples.small_capture()[0]
    plane_middles = np.array([pose.phase_centers.mean(axis=0) for pose in capture.poses])
    at = read_cloud(run.path / PEAKS_NAME)[0]
    at = at[np.argmin(np.linalg.norm(at - at.mean(axis=0), axis=1))][None]
    poses = []
    for pose in capture.poses:
        antennas = pose.tx_positions, pose.rx_positions
        size = np.full(1, 2.0 * np.abs(pose.signal).mean(), dtype=np.complex64)
        echo = signal_tracer(size, at, *antennas, capture.waveform, num_threads=1)
        poses.append(replace(pose, signal=pose.signal + echo))
    scans = iter([replace(capture, poses=tuple(poses)), capture])
    monkeypatch.setattr(coherent_change, "_CELL_M", 0.006)  # fewer positions
    monkeypatch.setattr(
        compare_runs, "_signals", lambda *_: Signals(next(scans), plane_middles, run.prior.cuboid)
    )
    (change,) = geraf2.compare(run, [run], write=False).changes
    assert change.what == "appeared"
    assert change.center_m == pytest.approx(tuple(at[0]), abs=6e-3)


def test_exit_codes_and_json(packed, robbed, capsys):
    assert main(["compare", str(packed), str(packed)]) == 0
    shown = capsys.readouterr()
    assert "result   unchanged" in shown.out
    assert "packed0/run: the run does not record where its scene is\n" in shown.err
    assert main(["compare", str(robbed), str(packed), "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["changed"] is True
    assert found["n_parts"] == [2, 3]
    assert [change["what"] for change in found["changes"]] == ["vanished"]
    assert "comparison.html" in RunFolder.read(robbed).files
    assert geraf2.compare(robbed, [packed, robbed], write=False).changes == ()


AXES = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
AWAY = Aperture.from_rectangle(np.array([2.0, 2.0, 3.0]), AXES, np.array([0.05, 0.05]))


@pytest.mark.parametrize(
    ("options", "corners_m", "text"),
    [
        ({"box_m": (0.2, 0.25, 0.2)}, None, "is of another box"),
        ({"wavelength_m": 0.005}, None, "is of another radar"),
        ({"has_glints": False}, None, "has no peaks to compare"),
        ({}, AWAY.corners_m, "show different sides of the content"),
    ],
)
def test_a_reference_of_something_else_is_one_line(
    packed, tmp_path, capsys, options, corners_m, text
):
    other = tmp_path / "other"
    run_of(other, *CUBES, **{"pose": HERE, "has_glints": True, **options})
    if corners_m is not None:
        planes = ScannedPlanes(corners_m=corners_m[None], wavelength_m=0.0039)
        save_planes(planes, other / PLANES_NAME)
    assert main(["compare", str(packed), str(other)]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert text in error[-1]
    assert "other" in error[-1]
    assert len(error) == 1 or corners_m is not None  # the notes of a comparison come before
