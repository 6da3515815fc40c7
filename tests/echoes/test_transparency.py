"""A dielectric ball whose back face's apparent place is known, and metal, that stays as it is."""

import numpy as np
import pytest
import trimesh

from geraf2.echoes.back_faces import seen_through_share
from geraf2.echoes.glints import GlintConfig, find_glints
from geraf2.echoes.transparency import describe, drop_back_faces, face_pairs
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
    config = FitConfig(spacing_m=0.006, distance_rounds=1)
    return lambda glints: zero_level(fit_sdf(glints, capture, BOX, config))


def test_a_dielectric_ball_keeps_its_front_and_tells_its_permittivity(plastic):
    capture, glints = plastic
    kept, seen = drop_back_faces(glints, 12, NARROW, through_of(capture))
    outside = np.linalg.norm(glints.positions, axis=1) > 1.5 * RADIUS_M
    assert outside.sum() > 100  # at the depth 2 n a they lie 2.2 radii from the middle
    assert np.abs(np.linalg.norm(kept.positions, axis=1) - RADIUS_M).max() < 2e-3
    assert len(kept) > 0.9 * (~outside).sum()
    assert seen.n_dropped == len(glints) - len(kept)
    assert seen.permittivity == pytest.approx(INDEX**2, rel=0.05)
    assert abs(seen.permittivity - INDEX**2) < 2.0 * seen.permittivity_sigma
    assert seen.thickness_m[0] == pytest.approx(2.0 * RADIUS_M, rel=0.05)
    assert f"permittivity {seen.permittivity:.2f}" in describe(seen.numbers())


def test_metal_stays_as_it_is():
    capture = sphere_capture(CENTER, [RADIUS_M])
    glints = find_glints(capture, BOX, NARROW)
    kept, seen = drop_back_faces(glints, 12, NARROW, through_of(capture))
    assert kept is glints
    assert seen is None


def test_pairs_of_faces_of_a_ball_have_its_optical_thickness():
    ways = fibonacci_sphere(400)
    front = glints_at(RADIUS_M * ways, ways)
    back = glints_at((1.0 - 2.0 * INDEX) * RADIUS_M * ways[::4], ways[::4])
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    pairs = face_pairs(back, front, MeshScene(mesh.vertices, mesh.faces))
    assert len(pairs.thickness_m) > 90
    np.testing.assert_allclose(pairs.thickness_m, 2.0 * RADIUS_M, rtol=2e-3)
    np.testing.assert_allclose(pairs.optical_m, 2.0 * INDEX * RADIUS_M, rtol=2e-3)


def test_what_is_not_known_is_said():
    assert describe({"n_glints": 3}) == ""
    said = describe({"n_back_faces": 5, "back_face_share": 0.25})
    assert "25 %" in said
    assert "does not show" in said


def test_scatterers_around_metal_are_no_body_that_waves_pass_through():
    """Scatterers lie behind each other, but do not hang together as a surface does."""
    rng = np.random.default_rng(0)
    around = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0.0, 2.0 * np.pi, 13)[:-1]])
    places = rng.uniform(-0.08, 0.08, (400, 3))
    places = places[np.linalg.norm(places, axis=1) > RADIUS_M + 0.01]
    towards = around[rng.integers(0, 12, (len(places), 4))].reshape(-1, 3)
    cloud = glints_at(np.repeat(places, 4, axis=0), towards, strengths=0.1)
    seen = fibonacci_sphere(400)
    glints = glints_at(RADIUS_M * seen, seen).join(cloud)
    assert seen_through_share(glints) > 0.05
    kept, body = drop_back_faces(glints, 12, NARROW, through_of(sphere_capture(CENTER, [RADIUS_M])))
    assert kept is glints
    assert body is None
