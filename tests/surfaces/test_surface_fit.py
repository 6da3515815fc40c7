from dataclasses import replace

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh
from geraf2.learned.novel_views import render_surface_plane
from geraf2.scene import Grid, LosPrior
from geraf2.surfaces.config import SurfaceFitConfig
from geraf2.surfaces.surface_fit import (
    SurfaceEcho,
    _MagnitudeFit,
    _PlaneImages,
    departure_rows,
    fit_surface_echo,
    make_surface_renderer,
    node_shares,
    spread_nodes,
)
from helpers.synthetic import WAVEFORM, point_pose

PRIOR = LosPrior.from_box((0.16, 0.16, 0.16))
CONTENT = LosPrior.from_box((0.05, 0.05, 0.05))
CONTENT_MESH = TriangleMesh(vertices=CONTENT.vertices, faces=CONTENT.faces)
GRID = Grid.cube((0.0, 0.0, 0.0), 0.08, 21)
CONFIG = SurfaceFitConfig(
    n_nodes=4, max_edge_m=0.004, wall_edge_m=0.006, n_targets=600, n_planes=4, stiffness=(1e-4,)
)
ANGLES = (0.0, 3.0, 90.0, 177.0, 270.0)


@pytest.fixture(scope="module")
def surface():
    return make_surface_renderer(CONTENT_MESH, PRIOR, WAVEFORM, CONFIG)


@pytest.fixture(scope="module")
def truth(surface):
    nodes = spread_nodes(surface.content.points, 4)
    return SurfaceEcho(
        nodes=nodes,
        reflectivity=np.array([0.4, 0.8, 1.2, 1.6]),
        power=2500.0,
        walls=np.array([0.3 + 0.1j, -0.1 + 0.05j]),
    )


@pytest.fixture(scope="module")
def poses(surface, truth):
    shares = truth.reflectivity_at(surface.content.points)[None]
    made = []
    for angle in ANGLES:
        pose = point_pose(angle, n_side=24, spacing_m=0.004)
        parts = surface.render(pose, shares)
        signal = np.tensordot(truth.power * np.r_[1.0, truth.walls], parts, axes=1)
        made.append(replace(pose, signal=signal.astype(np.complex64)))
    return tuple(made)


def test_the_fit_recovers_a_simulated_echo(surface, truth, poses):
    found = fit_surface_echo(surface, poses, GRID, CONFIG)
    np.testing.assert_allclose(found.reflectivity, truth.reflectivity, atol=0.1)
    assert found.power == pytest.approx(truth.power, rel=0.05)
    np.testing.assert_allclose(np.abs(found.walls[0]), np.abs(truth.walls[0]), rtol=0.1)
    view = render_surface_plane(surface, found, poses[1], GRID)
    dark = 10 * np.log10(view.measured.max() ** 2 / np.mean(view.measured**2.0))
    assert view.psnr_db > dark + 12.0


def test_stiffness_makes_reflectivity_uniform(surface, poses):
    found = fit_surface_echo(surface, poses[:2], GRID, replace(CONFIG, stiffness=(100.0,)))
    np.testing.assert_allclose(found.reflectivity, 1.0, atol=0.02)


def test_the_stiffness_with_the_least_left_out_error_is_chosen(surface, truth, poses):
    both = replace(CONFIG, stiffness=(100.0, 1e-4))
    painted = fit_surface_echo(surface, poses, GRID, both)
    np.testing.assert_allclose(painted.reflectivity, truth.reflectivity, atol=0.1)
    # Of one reflectivity and noise: what a soft fit finds besides is the noise.
    uniform = replace(truth, reflectivity=np.ones(4))
    rng = np.random.default_rng(0)
    noisy = []
    for pose in poses:
        parts = surface.render(pose, uniform.reflectivity_at(surface.content.points)[None])
        signal = np.tensordot(uniform.power * np.r_[1.0, uniform.walls], parts, axes=1)
        noise = rng.normal(size=(*signal.shape, 2)) @ [1.0, 1j]
        signal = signal + 3.0 * np.abs(signal).std() * noise
        noisy.append(replace(pose, signal=signal.astype(np.complex64)))
    found = fit_surface_echo(surface, tuple(noisy), GRID, both)
    np.testing.assert_allclose(found.reflectivity, 1.0, atol=0.02)


def test_the_leave_one_out_error_equals_that_of_refits():
    rng = np.random.default_rng(5)
    truth = np.r_[rng.uniform(0.5, 1.5, 6), 0.4 + 0.2j, -0.3 + 0.1j]
    planes = []
    for _ in range(6):
        parts = rng.normal(size=(8, 400)) + 1j * rng.normal(size=(8, 400))
        noise = rng.normal(size=400) + 1j * rng.normal(size=400)
        measured = np.abs(truth @ parts + 0.3 * noise)
        planes.append(_PlaneImages(parts.astype(np.complex64), measured.astype(np.float32)))
    rows = 0.3 * departure_rows(rng.uniform(0.0, 0.05, (6, 3)), 0.02)

    def error(kept, plane):
        problem = _MagnitudeFit(kept, 6)
        echo = problem.echo(problem.solve(rows), np.zeros((6, 3)))
        factors = echo.power * np.r_[echo.reflectivity, echo.walls]
        return float(np.square(np.abs(factors @ plane.parts) - plane.measured).sum())

    whole = _MagnitudeFit(planes, 6)
    left_out = whole.left_out_error(whole.solve(rows))
    seen = sum(error(planes, plane) for plane in planes)
    refitted = sum(error(planes[:k] + planes[k + 1 :], plane) for k, plane in enumerate(planes))
    assert refitted > 1.005 * seen  # what was fitted to is explained better
    assert left_out - seen == pytest.approx(refitted - seen, rel=0.05)


def test_departure_rows_whiten_the_covariance():
    rng = np.random.default_rng(3)
    nodes, x, length = rng.uniform(0, 0.06, (7, 3)), rng.uniform(0, 2, 7), 0.02
    covariance = np.empty((7, 7))
    for k in range(7):
        for other in range(7):
            squared = sum((a - b) ** 2 for a, b in zip(nodes[k], nodes[other], strict=True))
            covariance[k, other] = np.exp(-squared / (2 * length**2)) + 0.05 * (k == other)
    off = x - x.mean()
    wanted = off @ np.linalg.solve(covariance, off)
    assert np.square(departure_rows(nodes, length) @ x).sum() == pytest.approx(wanted)
    np.testing.assert_allclose(departure_rows(nodes, length) @ np.ones(7), 0.0, atol=1e-9)


def test_arrays_restore_the_echo(truth):
    again = SurfaceEcho.of_arrays(truth.arrays())
    for name in ("nodes", "reflectivity", "walls"):
        np.testing.assert_array_equal(getattr(again, name), getattr(truth, name))
    assert again.power == truth.power


def test_shares_of_a_point_sum_to_one_and_a_node_has_its_own():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]])
    points = np.concatenate([nodes, [[0.5, 0.5, 0.0]]])
    shares = node_shares(nodes, points)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    np.testing.assert_allclose(shares[:, :4], np.eye(4), atol=1e-9)
    assert shares[3, 4] == 0.0
    np.testing.assert_allclose(node_shares(nodes[:1], points), 1.0)
    assert len(spread_nodes(np.zeros((5, 3)), 3)) == 1  # all at one point


def test_an_impossible_fit_is_a_user_error(surface, poses):
    silent = tuple(replace(p, signal=np.zeros_like(p.signal)) for p in poses)
    with pytest.raises(UserError, match="heat map is zero or not finite"):
        fit_surface_echo(surface, silent, GRID, CONFIG)
    no_faces = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(UserError, match="no surface to render"):
        make_surface_renderer(no_faces, PRIOR, WAVEFORM)
