"""Dielectric balls with back faces of known apparent position, and metal, that stays as it is."""

import numpy as np
import pytest
import trimesh

from geraf2.echoes.chords import place_fronts
from geraf2.echoes.glints import GlintConfig, find_glints
from geraf2.echoes.transparency import describe, face_pairs, first_surfaces
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior
from geraf2.surfaces.fit import FitConfig, fit_sdf, zero_level
from helpers.glint_sets import glints_at
from helpers.specular import BOX_M, capture_of, fibonacci_sphere, sphere_capture, sphere_paths

BOX = LosPrior.from_box((BOX_M,) * 3)
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))
RADIUS_M, INDEX = 0.03, 1.6
CENTER = [[0.0, 0.0, 0.0]]


@pytest.fixture(scope="module")
def plastic():
    """Ball whose echo returns from its front and, 2 n radii later, from its back."""

    def paths(positions, _):
        front = sphere_paths(positions, CENTER, [RADIUS_M])
        return np.hstack([front, front + 4.0 * INDEX * RADIUS_M])

    capture = capture_of(paths)
    return capture, find_glints(capture, BOX, NARROW)


def through_of(capture):
    """Closed surface through glints, as the stage of the glints makes it."""
    config = FitConfig(spacing_m=0.006)
    return lambda glints: zero_level(fit_sdf(glints, config))


def test_a_dielectric_ball_keeps_its_front_and_gives_its_permittivity(plastic):
    capture, glints = plastic
    kept, behind, seen = first_surfaces(glints, through_of(capture))
    outside = np.linalg.norm(glints.positions, axis=1) > 1.5 * RADIUS_M
    assert outside.sum() > 100  # at the depth 2 n a they lie 2.2 radii from the middle
    assert np.abs(np.linalg.norm(kept.positions, axis=1) - RADIUS_M).max() < 2e-3
    assert len(kept) > 0.9 * (~outside).sum()
    assert seen.n_dropped == behind.sum() == len(glints) - len(kept)
    assert seen.permittivity == pytest.approx(INDEX**2, rel=0.05)
    assert abs(seen.permittivity - INDEX**2) < 2.0 * seen.permittivity_sigma
    assert seen.thickness_m[0] == pytest.approx(2.0 * RADIUS_M, rel=0.05)
    assert f"permittivity {seen.permittivity:.2f}" in describe(seen.numbers())


def test_metal_stays_as_it_is():
    capture = sphere_capture(CENTER, [RADIUS_M])
    glints = find_glints(capture, BOX, NARROW)
    first, behind, seen = first_surfaces(glints, through_of(capture))
    assert first is glints
    assert not behind.any()
    assert seen is None


@pytest.mark.parametrize("index", [1.55, 1.67, 1.8])
def test_back_faces_alone_show_their_front_by_opposite_planes(index):
    legs, radius_m = fibonacci_sphere(800), 0.015
    back = glints_at((1.0 - 2.0 * index) * radius_m * legs, legs)
    kept, behind, _ = first_surfaces(back, pytest.fail)
    assert behind.all()
    assert len(kept) > 0.9 * len(back)
    # S n / (2 n - 1) of opposite back faces errs by 0.02 S, and S is 2.5 times the diameter.
    off = np.linalg.norm(kept.positions, axis=1) - radius_m
    assert np.abs(off).max() < 0.03 * (2.0 * index - 1.0) * 2.0 * radius_m + 1e-3  # 1 mm of grid


def test_fronts_of_metal_are_no_back_faces():
    legs = fibonacci_sphere(800)
    assert place_fronts(glints_at(RADIUS_M * legs, legs)) is None


def test_pairs_of_faces_of_a_ball_have_its_optical_thickness():
    legs = fibonacci_sphere(400)
    front = glints_at(RADIUS_M * legs, legs)
    back = glints_at((1.0 - 2.0 * INDEX) * RADIUS_M * legs[::4], legs[::4])
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    pairs = face_pairs(back, front, MeshScene(mesh.vertices, mesh.faces))
    assert len(pairs.thickness_m) > 90
    np.testing.assert_allclose(pairs.thickness_m, 2.0 * RADIUS_M, rtol=2e-3)
    np.testing.assert_allclose(pairs.optical_m, 2.0 * INDEX * RADIUS_M, rtol=2e-3)
