from dataclasses import replace

import numpy as np
import pytest

from geraf2.fields import SdfGrid
from geraf2.io.mesh import Evidence as Kind
from geraf2.scene import Grid, LosPrior
from geraf2.surfaces.error_field import COMMON_SHARE, CORRELATION_M, sample_surface, smooth_noise
from geraf2.surfaces.extraction import extract_meshes
from geraf2.surfaces.fit import Evidence
from geraf2.surfaces.samples import SurfaceSamples
from helpers import solids
from helpers.glint_sets import glints_at

BOX = LosPrior.from_box((0.2, 0.24, 0.28))


def ball_glints(radius_m=0.03, n=400, off_m=0.0, sigma_m=5e-4, seed=0):
    directions = np.random.default_rng(seed).standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    glints = glints_at((radius_m + off_m) * directions, directions)
    return replace(glints, position_sigma_m=np.full(n, sigma_m))


def ball_field(radius_m=0.03):
    grid = Grid.centered((0.0, 0.0, 0.0), 0.005, (25, 25, 25))
    distance = np.linalg.norm(grid.points(), axis=1) - radius_m
    return SdfGrid(grid=grid, values=distance.reshape(grid.shape).astype(np.float32))


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


def test_the_field_has_the_stated_correlation():
    """Against the kernel itself, at random points whose spacing is no multiple of the cells."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 0.04, (60, 3))
    drawn = smooth_noise(points, 1500, rng)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    expected = np.exp(-0.5 * (apart / CORRELATION_M) ** 2)
    np.testing.assert_allclose(np.corrcoef(drawn.T), expected, atol=0.12)
    assert drawn.std(axis=0).mean() == pytest.approx(1.0, abs=0.1)  # a grid interpolates low


def test_far_vertices_share_a_part_of_their_error():
    ball = solids.ball(0.06, 3)
    glints = replace(ball_glints(), positions=0.0 * ball_glints().positions)  # all at the centre
    moved = sample_surface(ball, Evidence(glints=glints, common_sigma_m=1e-9), n_samples=400)
    up, down = ball.vertices[:, 2].argmax(), ball.vertices[:, 2].argmin()
    together = np.corrcoef(moved.displacements_m[:, up], moved.displacements_m[:, down])[0, 1]
    assert together == pytest.approx(COMMON_SHARE, abs=0.15)


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
