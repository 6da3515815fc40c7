import numpy as np
import pytest

from geraf2.fields import BoxSolid, NestedSets, SphereSolid
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior, Wall

WALL = Wall(size_m=(0.22, 0.2, 0.18), thickness_m=0.004, permittivity=1.6)
INNER = Wall(size_m=(0.15, 0.14, 0.13), thickness_m=0.006, permittivity=1.6)


def points(n=4000, seed=0):
    return np.random.default_rng(seed).uniform(-0.14, 0.14, (n, 3))


def test_a_box_has_the_distance_of_its_mesh():
    prior = LosPrior.from_box(WALL.size_m)
    box, mesh = BoxSolid(size_m=WALL.size_m), MeshScene(prior.vertices, prior.faces)
    np.testing.assert_allclose(
        box.signed_distance(points()), mesh.signed_distance(points()), atol=1e-7
    )


def test_signs_change_from_layer_to_layer():
    field = NestedSets.from_walls([WALL, INNER], SphereSolid(radius_m=0.04))
    ray = np.array([[x, 0.0, 0.0] for x in (0.12, 0.108, 0.09, 0.072, 0.05, 0.0)])
    got = field.signed_distance(ray)
    # air, outer wall, air, inner wall, air, content: to the nearest of the region's two boundaries
    np.testing.assert_allclose(got, [0.01, -0.002, 0.015, -0.003, 0.01, -0.04], atol=1e-12)


def test_the_distance_is_the_minimum_over_the_two_boundaries_of_the_region():
    """Equation 11 of the paper, written out region by region."""
    solids = [
        BoxSolid(size_m=(0.24, 0.24, 0.24)),
        BoxSolid(size_m=(0.2, 0.2, 0.2)),
        SphereSolid(radius_m=0.08, center_m=(0.01, 0.0, 0.0)),
        SphereSolid(radius_m=0.03),
    ]
    strong = [True, False, True, False]
    field, positions = NestedSets(solids, strong), points()
    want = np.empty(len(positions))
    for number, position in enumerate(positions):
        own = [solid.signed_distance(position[None])[0] for solid in solids]
        region = sum(d <= 0 for d in own)
        bounds = [abs(own[i]) for i in (region - 1, region) if 0 <= i < len(solids)]
        want[number] = min(bounds) * (-1 if region and strong[region - 1] else 1)
    np.testing.assert_allclose(field.signed_distance(positions), want, atol=1e-14)


def test_the_field_is_a_distance():
    field = NestedSets.from_walls([WALL], BoxSolid(size_m=(0.08, 0.08, 0.08)))
    a = points(3000, 1)
    b = a + np.random.default_rng(2).normal(0.0, 0.01, a.shape)
    change = np.abs(field.signed_distance(a) - field.signed_distance(b))
    assert (change <= np.linalg.norm(a - b, axis=1) + 1e-7).all()


def test_fields_of_vision_and_radar_agree_outside_the_box():
    field, outer = NestedSets.from_walls([WALL, INNER]), BoxSolid(size_m=WALL.size_m)
    positions = points()
    outside = positions[outer.signed_distance(positions) > 0]
    np.testing.assert_allclose(field.signed_distance(outside), outer.signed_distance(outside))


def test_sets_that_are_not_nested_are_refused():
    with pytest.raises(ValueError, match=r"solids\[1\] must lie inside solids\[0\], got a corner"):
        NestedSets([SphereSolid(radius_m=0.1), BoxSolid(size_m=(0.2, 0.1, 0.1))], [True, True])
    with pytest.raises(ValueError, match="one entry per set and at least one, got 0 and 0"):
        NestedSets([], [])
    with pytest.raises(ValueError, match="radius_m must be finite and positive"):
        SphereSolid(radius_m=0.0)
