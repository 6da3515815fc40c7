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
    fit_surface_echo,
    make_surface_renderer,
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


def test_an_impossible_fit_is_a_user_error(surface, poses):
    silent = tuple(replace(p, signal=np.zeros_like(p.signal)) for p in poses)
    with pytest.raises(UserError, match="heat map is zero or not finite"):
        fit_surface_echo(surface, silent, GRID, CONFIG)
    no_faces = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(UserError, match="no surface to render"):
        make_surface_renderer(no_faces, PRIOR, WAVEFORM)
