from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Capture, Grid, LosPrior
from geraf2.surfaces.config import HeatmapFitConfig
from geraf2.surfaces.heatmap_fit import (
    HeatmapRound,
    fit_heatmaps,
    measured_windows,
    moved_field,
    split_surface,
)
from geraf2.surfaces.workers import Workers
from helpers.specular import raster, sphere_capture
from helpers.synthetic import WAVEFORM

PRIOR = LosPrior.from_box((0.16, 0.16, 0.16))
RADIUS_M = 0.03
FAST = HeatmapFitConfig(
    n_rounds=1,
    n_steps=60,
    parts=2,
    n_antennas=150,
    n_targets=200,
    max_edge_m=0.003,
    node_spacing_m=0.012,
    rate_m=2e-5,
    target_spacing_m=0.006,
)


def ball(subdivisions=4, bump_m=0.0):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    unit = np.asarray(mesh.vertices)
    radius = RADIUS_M + bump_m * np.cos(18.0 * np.arctan2(unit[:, 1], unit[:, 0]))
    return TriangleMesh(vertices=radius[:, None] * unit, faces=np.asarray(mesh.faces))


@pytest.fixture(scope="module")
def capture():
    """A ball by geometrical optics: one echo of unit strength for each antenna."""
    return sphere_capture(
        [[0.0, 0.0, 0.0]], [RADIUS_M], n_poses=6, places=raster(21, 0.005), noise=0.01
    )


def one_round(capture, config=FAST):
    workers = Workers(1)
    windows = measured_windows(capture, PRIOR, config, np.random.default_rng(0), workers)
    surface = split_surface(ball(3), config.max_edge_m)
    return HeatmapRound(surface, capture, PRIOR, windows, config, workers)


def naive_image(window, surface):
    """Facet after facet, antenna after antenna: what the window's targets should show."""
    corners = surface.vertices[window.vertices[window.corners]]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(doubled, axis=1)
    normals = doubled / (2.0 * areas[:, None])
    points = corners.mean(axis=1) + window.shift
    way = window.middle - points
    far = np.linalg.norm(way, axis=1)
    near = window.middle - corners.mean(axis=1)
    spreading = (window.middle @ window.middle) / (near**2).sum(axis=1)  # the box is at zero
    lobe = np.maximum(2.0 * ((way * normals).sum(axis=1) / far) ** 2 - 1.0, 0.0)
    k = 2.0 * np.pi * WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    image = np.zeros(len(window.echo.targets), dtype=complex)
    for tx, rx in zip(*window.echo.antennas, strict=True):
        path = np.linalg.norm(tx - points, axis=1) + np.linalg.norm(rx - points, axis=1)
        echoes = np.exp(-1j * k[:, None] * (path + WAVEFORM.path_bias_m))
        signal = (areas * spreading * lobe * echoes).sum(axis=1)
        way = np.linalg.norm(window.echo.targets - tx, axis=1)
        way = way + np.linalg.norm(window.echo.targets - rx, axis=1) + WAVEFORM.path_bias_m
        image += np.exp(1j * way[:, None] * k) @ signal
    return image / len(window.echo.antennas[0])


def test_the_image_is_that_of_plain_loops(capture):
    fit = one_round(capture, replace(FAST, n_antennas=12))
    window = fit.windows[3]
    assert len(window.corners) > 100
    expected = naive_image(window, split_surface(ball(3), FAST.max_edge_m))
    found = fit.image(window)
    np.testing.assert_allclose(found, expected, atol=3e-3 * np.abs(expected).max())


def slope_of_differences(of, values, along, step):
    """Derivative of a function of an array, which is changed and put back."""
    ends = []
    for sign in (1.0, -2.0):
        values += sign * step * along
        ends.append(of())
    values += step * along
    return (ends[0] - ends[1]) / (2.0 * step)


def test_the_gradients_of_the_loss_are_those_of_differences(capture):
    # All antennas lie within 5 degrees as seen from the ball, so that the path to the middle does.
    fit = one_round(capture, replace(FAST, n_antennas=12, n_targets=60, parts=16))
    window, rng = fit.windows[0], np.random.default_rng(1)
    _, to_values, to_scale = fit.loss(window)
    along = rng.standard_normal(fit.values.shape)
    slope = slope_of_differences(lambda: fit.loss(window)[0], fit.values, along, 1e-6)
    assert abs(slope) > 1.0
    np.testing.assert_allclose((to_values * along).sum(), slope, rtol=2e-2)
    one = np.ones(1)
    slope = slope_of_differences(lambda: fit.loss(window)[0], fit.log_scale, one, 1e-3)
    np.testing.assert_allclose(to_scale, slope, rtol=1e-2)


def test_stiffness_is_the_sum_of_squared_differences(capture):
    fit = one_round(capture, replace(FAST, n_antennas=12, n_targets=60))
    fit.values[:] = 1e-3 * np.random.default_rng(2).standard_normal(fit.values.shape)
    h = fit.values / FAST.node_spacing_m
    bent = sum(float((np.diff(h, n=2, axis=axis) ** 2).sum()) for axis in range(3))
    total, gradient = fit.stiffness()
    np.testing.assert_allclose(total, FAST.bending * bent + FAST.anchor * (h**2).sum(), rtol=1e-10)
    along = np.random.default_rng(3).standard_normal(fit.values.shape)
    slope = slope_of_differences(lambda: fit.stiffness()[0], fit.values, along, 1e-6)
    np.testing.assert_allclose((gradient * along).sum(), slope, rtol=1e-6)


def dents_m(surface):
    """Standard deviation of the radius where an aperture is faced; mean over the planes."""
    radius = np.linalg.norm(surface.vertices, axis=1)
    unit = surface.vertices / radius[:, None]
    azimuth = np.degrees(np.arctan2(unit[:, 1], unit[:, 0]))
    found = []
    for angle in range(0, 360, 60):
        turned = np.abs((azimuth - angle + 180.0) % 360.0 - 180.0)
        found.append(np.std(radius[(turned < 6.0) & (np.abs(unit[:, 2]) < 0.1)]))
    return np.mean(found)


def test_a_dented_ball_is_beaten_round(capture):
    start = ball(5, bump_m=1e-4)
    config = replace(FAST, node_spacing_m=0.004, n_steps=100)
    fit = fit_heatmaps(start, capture, PRIOR, config, seed=0)
    assert fit.best == 1
    assert fit.residuals[1] < 0.6 * fit.residuals[0]
    assert dents_m(start) > 4e-5
    assert dents_m(fit.surface) < 0.6 * dents_m(start)


def test_what_noise_asks_for_is_not_done(capture):
    rng = np.random.default_rng(2)
    noise = tuple(
        replace(
            pose,
            signal=(rng.standard_normal((2, *pose.signal.shape)) * np.array([1, 1j])[:, None, None])
            .sum(axis=0)
            .astype(np.complex64),
        )
        for pose in capture.poses
    )
    fit = fit_heatmaps(
        ball(), Capture(waveform=WAVEFORM, poses=noise), PRIOR, replace(FAST, n_steps=30), seed=0
    )
    assert fit.best == 0
    np.testing.assert_array_equal(
        fit.surface.vertices, split_surface(ball(), FAST.max_edge_m).vertices
    )


def test_no_bit_depends_on_the_number_of_threads_and_progress_rises(capture):
    shares = []
    config = replace(FAST, n_steps=12)
    first = fit_heatmaps(ball(3), capture, PRIOR, config, num_threads=1, progress=shares.append)
    second = fit_heatmaps(ball(3), capture, PRIOR, config, num_threads=3)
    np.testing.assert_array_equal(first.surface.vertices, second.surface.vertices)
    assert first.residuals == second.residuals
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < shares[-1] <= 1.0


def test_split_surfaces_keep_their_shape_and_their_neighbours():
    whole = ball(2)
    fine = split_surface(whole, 0.003)
    edges = fine.vertices[fine.faces] - fine.vertices[np.roll(fine.faces, 1, axis=1)]
    assert np.linalg.norm(edges, axis=2).max() <= 0.003 + 1e-12
    mesh = trimesh.Trimesh(fine.vertices, fine.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(
        trimesh.Trimesh(whole.vertices, whole.faces).volume, rel=1e-9
    )


def test_the_field_of_a_moved_surface_is_its_distance():
    grid = Grid.centered((0.0, 0.0, 0.0), 0.005, (17, 17, 17))
    field = moved_field(SdfGrid(grid=grid, values=np.zeros(grid.shape, np.float32)), ball())
    expected = np.linalg.norm(grid.points(), axis=1) - RADIUS_M
    near = np.abs(expected) < 0.019
    assert 0.2 < near.mean() < 0.8
    np.testing.assert_allclose(field.values.ravel()[near], expected[near], atol=2e-4)
    np.testing.assert_allclose(field.values.ravel(), expected, atol=0.005)
    sure = np.abs(expected) > 2e-4  # the ball has facets
    np.testing.assert_array_equal(field.values.ravel()[sure] < 0.0, expected[sure] < 0.0)


def test_a_surface_without_faces_is_a_user_error(capture):
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(UserError, match="no surface to move"):
        fit_heatmaps(empty, capture, PRIOR, FAST)


def test_a_silent_plane_is_a_user_error(capture):
    first = replace(capture.poses[0], signal=np.zeros_like(capture.poses[0].signal), name="ten")
    silent = Capture(waveform=WAVEFORM, poses=(first, *capture.poses[1:]))
    with pytest.raises(UserError, match=r"heat map of plane 0 \(ten\) is zero"):
        fit_heatmaps(ball(3), silent, PRIOR, FAST)


@pytest.mark.parametrize(
    ("name", "value"),
    [("n_rounds", -1), ("rate_m", 0.0), ("withheld", 0.9), ("bending", -1.0), ("final_rate", 2.0)],
)
def test_bad_settings_name_the_value(name, value):
    with pytest.raises(ValueError, match=f"{name} must .* got {value}"):
        HeatmapFitConfig(**{name: value})
