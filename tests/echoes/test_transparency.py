"""Dielectric balls with back faces of known apparent position, and metal."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.echoes.faces import AIR, Scan, find_faces, likeliest_index
from geraf2.echoes.faces import INDEX as INDEX_OF_PLASTICS
from geraf2.echoes.glints import GlintConfig, find_glints
from geraf2.echoes.transparency import describe, face_pairs, place_on_faces
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior
from geraf2.simulation.spec import AWR1843
from geraf2.surfaces.fit import FitConfig, fit_sdf, zero_level
from helpers.glint_sets import glints_at, glints_on_sphere
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


def through(glints):
    """Closed surface through glints, as the stage of the glints makes it."""
    return zero_level(fit_sdf(glints, FitConfig(spacing_m=0.006), num_threads=1))


def scan_of(glints):
    return Scan(
        glints=glints,
        surface_through=through,
        cell_m=AWR1843.range_cell_m,
        volume_m3=BOX_M**3,
        num_threads=1,
    )


def test_a_dielectric_ball_has_both_faces_and_gives_its_permittivity(plastic):
    _, glints = plastic
    assert likeliest_index(glints, scan_of(glints)) == INDEX_OF_PLASTICS
    faces, seen = place_on_faces(scan_of(glints))
    placed, behind = faces.glints, faces.of_glints(len(glints))[1]
    outside = np.linalg.norm(glints.positions, axis=1) > 1.5 * RADIUS_M
    assert outside.sum() > 100  # at the depth 2 n a they lie 2.2 radii from the middle
    assert (behind == outside).mean() > 0.98
    # With the permittivity that the scan shows they err less than with that of plastics in general.
    off = np.abs(np.linalg.norm(placed.positions, axis=1) - RADIUS_M)
    first = find_faces(scan_of(glints)).glints.positions
    assert off.max() < 0.6 * np.abs(np.linalg.norm(first, axis=1) - RADIUS_M).max()
    assert off.max() < 1.5e-3
    assert len(placed) > 0.95 * len(glints)
    assert (np.einsum("ij,ij->i", placed.positions, placed.normals) > 0.9 * RADIUS_M).all()
    assert seen.n_behind == behind.sum()
    assert seen.permittivity == pytest.approx(INDEX**2, rel=0.05)
    assert abs(seen.permittivity - INDEX**2) < 2.0 * seen.permittivity_sigma
    assert seen.thickness_m[0] == pytest.approx(2.0 * RADIUS_M, rel=0.05)
    assert f"permittivity {seen.permittivity:.2f}" in describe(seen.numbers())


def from_many_planes(places, legs):
    """Glints at places, of which each plane sees few, with normals legs once or twice."""
    glints = glints_at(places, np.tile(legs, (len(places) // len(legs), 1)))
    return replace(glints, poses=np.arange(len(glints)) % 17)


def index_of(glints):
    return likeliest_index(glints, scan_of(glints))


@pytest.mark.parametrize("index", [1.5, INDEX, 1.8])
def test_solid_plastic_and_metal_are_no_shells(index):
    legs = fibonacci_sphere(400)
    for radius_m in (0.005, 0.01, RADIUS_M):
        front, back = radius_m * legs, (1.0 - 2.0 * index) * radius_m * legs
        metal, both = front, np.concatenate([front, back])
        found = [index_of(from_many_planes(places, legs)) for places in (metal, both)]
        assert AIR not in found
        if radius_m > 0.005:  # of a ball below the spacing of the surface the two are one
            assert found == [None, INDEX_OF_PLASTICS]


def test_few_glints_and_one_plane_show_no_shell():
    legs = fibonacci_sphere(400)
    both = RADIUS_M * np.concatenate([legs, -legs])
    one_plane, few = glints_at(both, np.tile(legs, (2, 1))), fibonacci_sphere(6)
    both_sides = from_many_planes(RADIUS_M * np.concatenate([few, -few]), few)
    for glints in (one_plane, both_sides, both_sides.select([0])):
        assert index_of(glints) != AIR


def test_a_body_seen_by_two_planes_is_not_taken_for_plastic():
    legs = fibonacci_sphere(400)
    ahead = glints_at(RADIUS_M * legs, legs).select(legs[:, 0] > 0.9)
    both = from_many_planes(RADIUS_M * np.concatenate([legs, -legs]), legs)
    for glints in (ahead, both):
        assert index_of(replace(glints, poses=glints.poses % 2)) is None


def test_the_order_of_the_planes_does_not_matter():
    legs = fibonacci_sphere(400)
    both = from_many_planes(RADIUS_M * np.concatenate([legs, -legs]), legs)
    other = replace(both, poses=np.random.default_rng(0).permutation(17)[both.poses])
    assert index_of(other) == index_of(both) == AIR


def test_both_sides_of_a_shell_stand_on_one_ball():
    legs = fibonacci_sphere(400)
    both = from_many_planes(RADIUS_M * np.concatenate([legs, -legs]), legs)
    assert index_of(both) == AIR
    faces, seen = place_on_faces(scan_of(both), AIR)
    assert seen.is_hollow
    assert seen.permittivity is None
    assert seen.n_behind == pytest.approx(400, abs=40)
    off = np.abs(np.linalg.norm(faces.glints.positions, axis=1) - RADIUS_M)
    assert np.quantile(off, 0.95) < 1e-3
    outward = np.einsum("ij,ij->i", faces.glints.positions, faces.glints.normals)
    assert (outward > 0.9 * RADIUS_M).all()
    assert "a shell" in describe(seen.numbers())


@pytest.mark.parametrize(
    ("centers", "radii"),
    [
        (CENTER, [RADIUS_M]),
        (CENTER, [0.4 * RADIUS_M]),
        (CENTER, [0.1 * RADIUS_M]),
        ([[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0]], [0.025, 0.025]),  # behind each other
    ],
)
def test_metal_is_not_taken_for_plastic(centers, radii):
    assert index_of(find_glints(sphere_capture(centers, radii), BOX, NARROW)) is None


def test_a_shell_and_what_is_in_it_are_not_taken_for_plastic():
    glints = glints_on_sphere(0.07, 6000).join(glints_on_sphere(0.02, 600, seed=1))
    assert index_of(glints) is None


@pytest.mark.parametrize("index", [1.58, 1.67, 1.8])
def test_back_faces_alone_show_the_body(index):
    legs, radius_m = fibonacci_sphere(400), 0.015
    back = glints_at((1.0 - 2.0 * index) * radius_m * legs, legs)
    faces = find_faces(scan_of(back))
    assert faces.is_back.all()
    assert len(faces.glints) > 0.9 * len(back)
    # Both ends of a chord lie (2 n - 1) t apart, of which 2 n / 1.67 - 1 are known.
    off = np.linalg.norm(faces.glints.positions, axis=1) - radius_m
    assert np.quantile(np.abs(off), 0.9) < 2e-3


def test_one_echo_of_both_faces_of_a_thin_plate_is_put_on_both():
    # 0.67 n t behind its front, an echo of a plate of 8 mm seems to lie beyond the plate.
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-0.04, 0.04, 17)] * 2))
    half_m, plane = 0.004, np.zeros_like(x)
    middles = np.concatenate([np.column_stack([x, y, plane])] * 2)
    side = np.repeat([1.0, -1.0], len(x))
    normals = np.outer(side, [0.0, 0.0, 1.0])
    seen = middles + ((half_m - 0.67 * INDEX_OF_PLASTICS * 2.0 * half_m) * side)[:, None] * [
        0,
        0,
        1,
    ]
    faces = find_faces(scan_of(glints_at(seen, normals)))
    off = np.abs(np.abs(faces.glints.positions[:, 2]) - half_m)
    outward = np.sign(faces.glints.positions[:, 2]) * faces.glints.normals[:, 2]
    assert np.median(off) < 2e-3
    assert (outward > 0.9).mean() > 0.8


def test_pairs_of_faces_of_a_ball_have_its_optical_thickness():
    legs = fibonacci_sphere(400)
    front = glints_at(RADIUS_M * legs, legs)
    back = glints_at((1.0 - 2.0 * INDEX) * RADIUS_M * legs[::4], legs[::4])
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    pairs = face_pairs(back, front, MeshScene(mesh.vertices, mesh.faces))
    assert len(pairs.thickness_m) > 90
    np.testing.assert_allclose(pairs.thickness_m, 2.0 * RADIUS_M, rtol=2e-3)
    np.testing.assert_allclose(pairs.optical_m, 2.0 * INDEX * RADIUS_M, rtol=2e-3)
