"""Modal radius: surfaces of known curvature, and the offset of a wrong delay."""

import numpy as np
import pytest

from geraf2.echoes.radius import modal_radius_m, pair_radii
from helpers.glint_sets import glints_at, glints_on_sphere


def ring_of_cylinder(radius_m, offset_m=0.0, n=400, seed=0):
    """Glints of a vertical cylinder in many planes, moved along their normals."""
    rng = np.random.default_rng(seed)
    angle, z = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(-0.004, 0.004, n)
    normals = np.stack([np.cos(angle), np.sin(angle), 0.0 * z], axis=1)
    positions = (radius_m + offset_m) * normals + np.column_stack([0 * z, 0 * z, z])
    return glints_at(positions, normals, poses=np.arange(n) % 24)


@pytest.mark.parametrize("radius_m", [0.004, 0.02, 0.045])
def test_it_is_the_radius_of_a_sphere_and_of_a_cylinder(radius_m):
    sphere = glints_on_sphere(radius_m, 600, poses=np.arange(600) % 24)
    for glints in (sphere, ring_of_cylinder(radius_m)):
        assert modal_radius_m(glints) == pytest.approx(radius_m, abs=0.002)


@pytest.mark.parametrize("offset_m", [-0.03, 0.025])
def test_an_offset_surface_has_the_radius_that_is_larger_by_the_offset(offset_m):
    found = modal_radius_m(ring_of_cylinder(0.008, offset_m))
    assert found == pytest.approx(0.008 + offset_m, abs=0.002)


def test_pairs_of_one_plane_do_not_count_and_few_pairs_say_nothing():
    assert len(pair_radii(glints_on_sphere(0.02, 300))) == 0
    assert modal_radius_m(glints_on_sphere(0.02, 12, poses=np.arange(12))) is None
