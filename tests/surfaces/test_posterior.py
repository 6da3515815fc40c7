from dataclasses import replace

import numpy as np
import pytest

from geraf2.fields import SdfGrid
from geraf2.io.mesh import Evidence as Kind
from geraf2.scene import Grid, LosPrior
from geraf2.surfaces.extraction import extract_meshes
from geraf2.surfaces.linear_sdf import OrientedPoints, SdfTerms
from geraf2.surfaces.posterior import (
    FieldPosterior,
    PointNoise,
    faces_met,
)
from geraf2.surfaces.samples import SurfaceSamples
from helpers import solids
from helpers.glint_sets import glints_at
from reference import quadratic_sdf as twin

SHAPE = (5, 4, 5)
SPACING_M = 0.008
BOX = LosPrior.from_box((0.2, 0.24, 0.28))


def small_posterior(outside, bend_density_m=None, seed=0, n=14):
    """Posterior of random points on a small grid, and what the twin needs of it."""
    rng = np.random.default_rng(seed)
    index = rng.uniform(0.05, 0.95, (n, 3)) * (np.array(SHAPE) - 1)
    normals = rng.standard_normal((n, 3))
    weights = rng.uniform(0.2, 1.0, (2, n))
    weights /= weights.sum(axis=1, keepdims=True)
    terms = SdfTerms(
        position=30.0, normal=1.0, bending=0.3, outside=outside, outside_distance_m=0.03
    )
    grid = Grid(origin_m=(0.1, -0.2, 0.05), spacing_m=SPACING_M, shape=SHAPE)
    points = OrientedPoints(
        positions=np.array(grid.origin_m) + SPACING_M * index,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        position_weights=weights[0],
        normal_weights=weights[1],
    )
    volume_m3 = float(np.prod(np.array(SHAPE) - 1)) * SPACING_M**3
    # Weights that are precisions: sigma = 1 / sqrt(weight), lengths in centimetres.
    noise = PointNoise(
        position_sigma_m=0.01 / np.sqrt(terms.position * weights[0]),
        normal_sigma_rad=1.0 / np.sqrt(terms.normal * weights[1]),
        shared_sigma_m=np.zeros(0),
        groups=np.full((n, 1), -1),
    )
    density_m = 1e4 * volume_m3 / terms.bending if bend_density_m is None else bend_density_m
    posterior = FieldPosterior(
        SdfGrid(grid=grid, values=np.zeros(SHAPE, np.float32)),
        points,
        terms,
        noise,
        bend_density_m=density_m,
        tolerance=1e-9,
    )
    return posterior, index, weights, terms, noise, density_m


def sample_covariance(posterior, n_samples=1000):
    rng = np.random.default_rng(3)
    drawn = 100.0 * np.stack([posterior.draw(rng) for _ in range(n_samples)])
    return drawn.T @ drawn / n_samples


def test_other_errors_give_the_covariance_of_the_dense_twin():
    posterior, index, weights, terms, noise, density_m = small_posterior(0.1, bend_density_m=2.0)
    sigmas = (100.0 * noise.position_sigma_m, noise.normal_sigma_rad)
    expected = twin.covariance(
        SHAPE, 100.0 * SPACING_M, index, weights, terms, sigmas, 100.0 * density_m
    )
    found = sample_covariance(posterior)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 5.0 * np.sqrt(2.0 / 1000)


def test_shared_offsets_move_all_points_of_a_group_alike():
    noise = PointNoise(
        position_sigma_m=np.zeros(5),
        normal_sigma_rad=np.zeros(5),
        shared_sigma_m=np.array([1.0, 2.0]),
        groups=np.array([[0, 1], [0, 1], [0, -1], [-1, 1], [-1, -1]]),
    )
    rng = np.random.default_rng(0)
    drawn = np.stack([noise.draw(rng)[0] for _ in range(4000)])
    np.testing.assert_array_equal(drawn[:, 0], drawn[:, 1])
    np.testing.assert_allclose(drawn[:, 0], drawn[:, 2] + drawn[:, 3], rtol=1e-12)
    assert not drawn[:, 4].any()
    np.testing.assert_allclose(noise.total_sigma_m, [5**0.5, 5**0.5, 1.0, 2.0, 0.0])
    assert drawn.std(axis=0)[[2, 3]] == pytest.approx([1.0, 2.0], rel=0.05)


def ball_glints(radius_m=0.03, n=400, off_m=0.0, sigma_m=5e-4, seed=0):
    directions = np.random.default_rng(seed).standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    glints = glints_at((radius_m + off_m) * directions, directions)
    return replace(glints, position_sigma_m=np.full(n, sigma_m))


def ball_field(radius_m=0.03):
    grid = Grid.centered((0.0, 0.0, 0.0), 0.005, (25, 25, 25))
    distance = np.linalg.norm(grid.points(), axis=1) - radius_m
    return SdfGrid(grid=grid, values=distance.reshape(grid.shape).astype(np.float32))


def test_glints_belong_to_the_face_that_their_normal_meets():
    normals = [[1, 0.1, 0], [-1, 0, 0.2], [0.1, 1, 0], [0, -1, 0], [0, 0.2, 1], [0, 0, -1]]
    normals = np.array(normals) / np.linalg.norm(normals, axis=1, keepdims=True)
    glints = glints_at(np.zeros((6, 3)), normals)
    np.testing.assert_array_equal(faces_met(glints, BOX), [1, 0, 3, 2, 5, 4])


def test_a_surface_without_glints_has_a_larger_error():
    glints = ball_glints()
    half = glints.select(glints.normals[:, 2] < 0.2)
    samples = extract_meshes(ball_field(), half, BOX).samples
    up = samples.mesh.vertices[:, 2] / 0.03
    error_m = samples.mesh.expected_error_m
    assert np.median(error_m[up > 0.9]) > 2.5 * np.median(error_m[up < -0.3])
    assert (samples.mesh.evidence[up > 0.9] == Kind.NOT_SEEN).all()
    assert np.isfinite(error_m).all()
    assert error_m.min() > 0.0


def test_the_expected_error_is_the_spread_of_the_samples():
    found = extract_meshes(ball_field(), ball_glints(), BOX)
    spread_m = np.sqrt((found.samples.displacements_m**2).mean(axis=0))
    np.testing.assert_allclose(spread_m, found.mesh_content.expected_error_m, rtol=1e-4)


def test_intervals_include_shared_offsets():
    ball = solids.ball(0.02, 3)
    n = len(ball.vertices)
    shared = np.linspace(-1.7e-3, 1.7e-3, 25)[:, None] * np.ones(n)
    rng = np.random.default_rng(0)
    own = 1e-3 * rng.standard_normal((25, n))
    for moves, wide in ((shared, True), (own, False)):
        samples = SurfaceSamples(ball, moves, 1e-3)
        numbers = samples.size_numbers()
        low, high = numbers["volume_95_percent_cm3"]
        assert low < numbers["volume_cm3"] < high
        # 1 mm on a radius of 20 mm is 15 % of the volume.
        assert ((high - low) / numbers["volume_cm3"] > 0.4) == wide
    with pytest.raises(ValueError, match="at least 2 samples, got 1"):
        SurfaceSamples(ball, shared[:1], 1e-3).interval(lambda mesh: mesh.vertices.max())


def test_samples_are_written_and_read_as_arrays(tmp_path):
    ball = solids.ball(0.02, 2)
    moves = np.full((3, len(ball.vertices)), 1e-3)
    SurfaceSamples(ball, moves, 9e-4).save(tmp_path / "samples.npz")
    with np.load(tmp_path / "samples.npz") as stored:
        moved = stored["vertices"] + stored["displacements_m"][0][:, None] * stored["normals"]
        assert float(stored["common_offset_sigma_m"]) == 9e-4
        np.testing.assert_array_equal(stored["faces"], ball.faces)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 0.021, atol=2e-5)
    first = next(SurfaceSamples(ball, moves, 9e-4).meshes())
    np.testing.assert_allclose(first.vertices, moved)
