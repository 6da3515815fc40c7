"""Material of parts from levels of returns that are made up."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.stats import norm

from geraf2.apps.inspection.bodies import body_of
from geraf2.apps.inspection.material import Measured, material_text
from geraf2.apps.inspection.materials import (
    Levels,
    Returns,
    materials_of,
    passed_shares,
    reflectivity_map,
)
from helpers.solids import ball
from helpers.specular import fibonacci_sphere

RADIUS_M = 0.02


def levels(mesh, level_db, *, scale_sigma_db=0.5, permittivity=None, n=200):
    """Levels on a ball, 3 dB apart."""
    rng = np.random.default_rng(0)
    at = rng.permutation(len(mesh.vertices))[:n]
    normals = mesh.vertices[at] / np.linalg.norm(mesh.vertices[at], axis=1, keepdims=True)
    spread = norm.ppf(0.9) * 3.0
    return Levels(
        positions=mesh.vertices[at],
        normals=normals,
        levels_db=level_db - spread + 3.0 * rng.normal(size=len(at)),
        scale_sigma_db=scale_sigma_db,
        permittivity=permittivity,
    )


def returns(depth_m=0.0, *, n=400, middle=(0.0, 0.0, 0.0), part=slice(None), probability=0.6):
    """Returns of a ball from all sides, at a depth behind its front."""
    normals = fibonacci_sphere(n)[part]
    positions = (RADIUS_M - depth_m) * normals + np.asarray(middle)
    chance = np.full(len(normals), probability)
    return Returns.of(positions, normals, chance, np.zeros(len(normals), dtype=bool))


def moved(mesh, by):
    return type(mesh)(vertices=mesh.vertices + np.asarray(by), faces=mesh.faces)


def trees(*meshes):
    return [KDTree(mesh.vertices) for mesh in meshes]


def test_returns_of_metal_stop_at_its_front_and_those_of_a_back_face_passed():
    """On the axis of a ball the back face seems to lie 2 n r behind the front."""
    part = trees(ball(RADIUS_M, 3))
    for depth_m, share in ((0.0, 0.0), (2.0 * np.sqrt(2.5) * RADIUS_M - 0.01, 1.0)):
        assert passed_shares(part, returns(depth_m)) == pytest.approx([share], abs=0.01)
    front = returns()
    known = front._replace(behind=front.normals[:, 0] > 0.5)
    known = Returns.of(*known[:4])
    assert passed_shares(part, known) == pytest.approx([0.25], abs=0.02)


def test_nothing_follows_from_one_side_or_few_returns():
    part = trees(ball(RADIUS_M, 3))
    one_side = fibonacci_sphere(400)[:, 0] > 0.0
    for few in (None, returns(part=one_side), returns(n=15)):
        assert np.isnan(passed_shares(part, few)).all()


@pytest.mark.parametrize(
    ("level_db", "kind"), [(0.0, "not determined"), (-6.8, "not determined"), (-17.0, "plastic")]
)
def test_a_level_alone_decides_only_far_below_metal(level_db, kind):
    mesh = ball(RADIUS_M, 3)
    (found,) = materials_of([body_of(mesh)], levels(mesh, level_db), None)
    assert found.kind == kind
    assert found.reflectivity_db.value == pytest.approx(level_db, abs=1.0)
    assert "dB against metal" in material_text(found)


def test_no_level_without_a_scale_with_few_returns_or_above_metal():
    mesh = ball(RADIUS_M, 3)
    bodies = [body_of(mesh)]
    for seen in (
        None,
        levels(mesh, np.nan, scale_sigma_db=np.nan),
        levels(mesh, 0.0, scale_sigma_db=6.0),
        levels(mesh, 0.0, n=10),
        levels(mesh, 12.0),
    ):
        (found,) = materials_of(bodies, seen, None)
        assert (found.kind, found.reflectivity_db) == ("not determined", None)
        (found,) = materials_of(bodies, seen, returns())
        assert (found.kind, found.reflectivity_db) == ("metal", None)


def test_each_part_has_the_material_of_its_own_returns():
    first, second = ball(RADIUS_M, 3), moved(ball(RADIUS_M, 3), [0, 0.2, 0])
    far, through = returns(), returns(0.05, middle=[0, 0.2, 0])
    every = Returns(*(np.concatenate(of) for of in zip(far, through, strict=True)))
    seen = levels(
        first, np.nan, scale_sigma_db=np.nan, permittivity=Measured(value=2.9, sigma=0.1)
    )._replace(thickness_m=(0.021, 0.058))
    bodies = [body_of(first), body_of(second)]
    metal, plastic = materials_of(bodies, seen, every)
    assert (metal.kind, plastic.kind) == ("metal", "plastic")
    assert plastic.permittivity.value == 2.9
    assert material_text(plastic).endswith(
        "permittivity 2.90 ± 0.20, 21 to 58 mm thick where both faces were seen"
    )
    assert (metal.permittivity, metal.thickness_m) == (None, None)
    metal, shell = materials_of(bodies, seen._replace(is_hollow=True), every)
    assert "shell" in material_text(shell)
    assert "shell" not in material_text(metal)
    _, blind = materials_of(bodies, None, every)
    assert material_text(blind).endswith("permittivity cannot be determined")


def test_the_map_has_the_levels_where_returns_came_from_and_nothing_elsewhere():
    mesh = ball(0.03, 4)
    normals = mesh.vertices / 0.03
    right = mesh.vertices[:, 0] > 0.0
    seen = levels(mesh, 0.0, n=len(mesh.vertices))
    keep = seen.positions[:, 0] > 0.0
    level = np.where(seen.positions[:, 1] > 0.0, -3.0, -9.0)
    half = seen._replace(
        positions=seen.positions[keep], normals=seen.normals[keep], levels_db=level[keep]
    )
    found = reflectivity_map(mesh.vertices, normals, half)
    assert np.isnan(found[mesh.vertices[:, 0] < -0.009]).all()
    far = right & (np.abs(mesh.vertices[:, 1]) > 0.01)
    assert found[far] == pytest.approx(np.where(mesh.vertices[far, 1] > 0, -3.0, -9.0))
