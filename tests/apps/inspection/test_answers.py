"""Deviations, and models among parts, on measured parts that are made up."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.apps.inspection.bodies import Content
from geraf2.apps.inspection.deviation import deviation_of
from geraf2.apps.inspection.matching import match_models
from geraf2.apps.inspection.models import model_of, read_models
from geraf2.geometry.transforms import apply_rigid
from geraf2.io.planes import ScannedPlanes
from helpers.glint_sets import glints_at
from helpers.inspected import POSE, block, measured_body, placement, wedge
from helpers.solids import joined

SIDES = (0.06, 0.04, 0.02)
WAVELENGTH_M = 0.0039  # of 77 GHz
pytestmark = pytest.mark.usefixtures("quick_search")


def placed(pose=POSE, sigma_m=0.0):
    return placement(pose, np.diag([0.0] * 3 + [sigma_m**2] * 3))


def plane_at(x, y, z):
    """Corners of a plane of antennas across x, (1, 4, 3)."""
    return np.array([[[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]]])


def scanned(corners_m, wavelength_m=WAVELENGTH_M):
    return ScannedPlanes(corners_m=corners_m, wavelength_m=wavelength_m)


def with_bump(mesh, height_m):
    """Mesh with a flat bump, 12 mm wide, in the middle of its top."""
    x, y, z = mesh.vertices.T
    up = (np.abs(x) <= 0.0061) & (np.abs(y) <= 0.0061) & (z > 0.009)
    return replace(mesh, vertices=mesh.vertices + height_m * np.outer(up, [0, 0, 1.0]))


@pytest.mark.parametrize(("height_m", "what"), [(0.005, "too much"), (-0.005, "too little")])
def test_a_bump_is_found_where_it_is_and_only_where_it_was_seen(height_m, what):
    model = block(SIDES, edge_m=0.003)
    body = measured_body(with_bump(model, height_m), sigma_m=2e-4)
    found = deviation_of(body, model, placed(), 0.002)
    (region,) = found.regions
    assert region.what == what
    assert region.center_m == pytest.approx(
        apply_rigid(POSE, np.array([0, 0, 0.01 + height_m])), abs=2e-3
    )
    assert region.deviation_m == pytest.approx(height_m, abs=1e-3)
    assert found.seen_fraction > 0.9
    assert not deviation_of(
        replace(body, sigma_m=np.full(len(body.seen), 0.003)), model, placed(), 0.002
    ).regions
    blind = replace(body, seen=np.zeros_like(body.seen))
    unseen = deviation_of(blind, model, placed(), 0.002)
    assert unseen.regions == ()
    assert unseen.seen_fraction == 0.0


def test_what_should_have_echoed_and_is_not_there_is_absent():
    """A second block, missing, in sight of a plane at x = 0.4 m, and out of sight of one below."""
    rest, gone = block(SIDES), block((0.01, 0.02, 0.02), (0.0, 0.0, 0.04))
    body = measured_body(rest, np.eye(4), sigma_m=2e-4)
    side = plane_at(0.4, (-0.1, 0.1), (-0.1, 0.1))
    found = deviation_of(body, joined(rest, gone), placed(np.eye(4)), 0.002, scanned(side))
    (region,) = found.regions
    assert region.what == "absent"
    assert region.center_m == pytest.approx((0.005, 0.0, 0.04), abs=2e-3)
    assert region.area_m2 == pytest.approx(4e-4, rel=0.2)
    below = side[:, :, [1, 2, 0]] - [0, 0, 0.8]
    for planes in (scanned(below), scanned(side, wavelength_m=None)):
        found = deviation_of(body, joined(rest, gone), placed(np.eye(4)), 0.002, planes)
        assert not found.regions


def test_echoes_from_a_part_of_the_model_confirm_it():
    """Glints where the model is say that there is no bump; glints on the bump say that there is."""
    model = block(SIDES, edge_m=0.003)
    body = measured_body(with_bump(model, 0.005), np.eye(4), sigma_m=2e-4)
    at = np.linspace(-0.006, 0.006, 6)
    spots = np.array([(x, y, 0.01) for x in at for y in at])
    on_bump = spots + np.array([0, 0, 0.005])
    assert [len(faults(body, model, positions)) for positions in (spots, on_bump)] == [0, 1]


def faults(body, model, positions):
    glints = glints_at(positions, np.tile([0.0, 0.0, 1.0], (len(positions), 1)))
    return deviation_of(body, model, placed(np.eye(4)), 0.002, glints=glints).regions


@pytest.fixture(scope="module")
def models():
    made = {"wedge": wedge(), "low": wedge(0.02), "block": block(SIDES), "tiny": block((0.01,) * 3)}
    return [model_of(mesh, name) for name, mesh in made.items()]


def test_the_right_one_of_several_candidates_and_another_part_are_recognised(models):
    body = measured_body(models[1].mesh, unseen=(0, 0, -1))
    (found,) = match_models(models[:2], Content([body], body), any_of=True)
    assert (models[found.model].name, found.status) == ("low", "present")
    ((loser, misfit),) = found.rivals
    assert models[loser].name == "wedge"
    assert misfit > found.placement.misfit
    body = measured_body(block((0.075, 0.02, 0.02)))
    (found,) = match_models(models[:1], Content([body], body))
    assert found.status == "wrong part"
    assert found.placement.misfit > found.largest_misfit


@pytest.mark.parametrize(
    ("turn_deg", "shift_m", "status"),
    [(0.0, 0.0, "present"), (90.0, 0.0, "turned"), (0.0, 0.008, "moved"), (180.0, 0.0, "present")],
)
def test_a_part_is_compared_with_where_it_should_be(turn_deg, shift_m, status):
    """Half a turn of a block is none."""
    model = model_of(block(SIDES), "block")
    pose = np.eye(4)
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[0, 3] = shift_m
    body = measured_body(model.mesh, pose)
    (found,) = match_models([model], Content([body], body), placed=True)
    assert found.status == status


def stl(path, mesh, scale=1.0):
    trimesh.Trimesh(scale * mesh.vertices, mesh.faces).export(path)
    return path


@pytest.mark.parametrize(("unit", "per_metre"), [("mm", 1e3), ("m", 1.0), ("in", 1 / 0.0254)])
def test_the_unit_of_a_file_follows_from_its_size(tmp_path, unit, per_metre):
    path = stl(tmp_path / "part.stl", wedge(), per_metre)
    for asked in (None, unit):
        (model,) = read_models([path], [0.07], asked)
        assert (model.name, model.unit) == ("part", unit)
        assert np.ptp(model.mesh.vertices, axis=0) == pytest.approx(
            np.ptp(wedge().vertices, axis=0), rel=1e-5
        )


def test_models_of_one_name_are_told_apart_by_their_folders(tmp_path):
    (tmp_path / "b").mkdir()
    same = [stl(folder / "part.stl", wedge(), 1e3) for folder in (tmp_path, tmp_path / "b")]
    found = read_models(same, [0.07])
    assert [model.name for model in found] == [f"{tmp_path.name}/part", "b/part"]
    solid = stl(tmp_path / "b" / "part.STL", wedge(), 1e3)
    assert read_models([same[1], solid], [0.07])[1].name == str(solid)
    sides = found[0].lengths_m
    assert sides[0] >= sides[1] >= sides[2] > 0
