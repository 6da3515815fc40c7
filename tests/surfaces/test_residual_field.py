from dataclasses import replace

import numpy as np
import pytest

from geraf2.io.mesh import TriangleMesh
from geraf2.learned.novel_views import render_surface_plane
from geraf2.ops import matched_filter, signal_tracer
from geraf2.scene import Grid, LosPrior
from geraf2.surfaces.config import ResidualFieldConfig, SurfaceFitConfig
from geraf2.surfaces.residual_field import (
    PlaneAtTargets,
    ResidualField,
    allowed_power,
    field_power,
    fit_residual_field,
    left_out_gain,
    loss_of_shares,
    power_matrix,
    surface_image,
)
from geraf2.surfaces.surface_fit import SurfaceEcho, make_surface_renderer
from helpers.synthetic import WAVEFORM, point_pose

PRIOR = LosPrior.from_box((0.16, 0.16, 0.16))
CONTENT = LosPrior.from_box((0.04, 0.04, 0.04))
GRID = Grid.cube((0.0, 0.0, 0.0), 0.06, 21)
CONFIG = ResidualFieldConfig(n_points=60, n_targets=400)
ECHO = SurfaceEcho(
    nodes=np.zeros((1, 3)), reflectivity=np.ones(1), power=300.0, walls=np.zeros(2, complex)
)
# One is behind the content for planes around -x.
SCATTERERS = np.array([[0.04, 0.02, 0.03], [-0.03, 0.035, -0.02], [0.0, -0.045, 0.01]])
ANGLES = (0.0, 60.0, 110.0, 170.0, 230.0, 290.0)


@pytest.fixture(scope="module")
def renderer():
    mesh = TriangleMesh(vertices=CONTENT.vertices, faces=CONTENT.faces)
    config = SurfaceFitConfig(max_edge_m=0.005, wall_edge_m=0.01)
    return make_surface_renderer(mesh, PRIOR, WAVEFORM, config)


def planes(renderer, scatterers_of, strength=2.0):
    """What the surface and points send, those that a group of antennas sees."""
    rng = np.random.default_rng(3)
    made = []
    for angle in ANGLES:
        scatterers = scatterers_of(rng)
        pose = point_pose(angle, n_side=14, spacing_m=0.006)
        shares = np.ones((1, len(renderer.content.points)))
        signal = ECHO.power * renderer.render(pose, shares)[0]
        phases = np.exp(2j * np.pi * rng.random(len(scatterers)))
        for group in renderer.groups(pose):
            lit = renderer.lit_points(scatterers, pose.phase_centers[group].mean(axis=0))
            if lit.index.size:
                amplitude = (strength * phases[lit.index]).astype(np.complex64)
                positions = lit.points, pose.tx_positions[group], pose.rx_positions[group]
                signal[group] += signal_tracer(amplitude, *positions, WAVEFORM)
        made.append(replace(pose, signal=signal.astype(np.complex64)))
    return made


def traced_power(renderer, pose, point, positions):
    """Power of an echo of power 1 at a point, by its signal and the matched filter."""
    signal = np.zeros((pose.n_antennas, WAVEFORM.n_samples), np.complex64)
    for group in renderer.groups(pose):
        lit = renderer.lit_points(point[None], pose.phase_centers[group].mean(axis=0))
        if lit.index.size:
            amplitude = (lit.spreading / WAVEFORM.n_samples).astype(np.complex64)
            antennas = pose.tx_positions[group], pose.rx_positions[group]
            signal[group] = signal_tracer(amplitude, lit.points, *antennas, WAVEFORM)
    image = matched_filter(signal, pose.tx_positions, pose.rx_positions, positions, WAVEFORM)
    return np.abs(np.asarray(image).ravel()) ** 2


def test_the_matrix_is_the_power_of_traced_echoes(renderer):
    pose = point_pose(30.0, n_side=14, spacing_m=0.006)
    targets = np.concatenate([SCATTERERS, GRID.points()[::97]])
    matrix = power_matrix(renderer, pose, SCATTERERS, targets)
    for number, point in enumerate(SCATTERERS):
        traced = traced_power(renderer, pose, point, targets)
        np.testing.assert_allclose(matrix[:, number], traced, atol=0.01)
    middle = pose.phase_centers.mean(axis=0)
    nearer = np.linalg.norm(middle) / np.linalg.norm(middle - SCATTERERS[0])
    assert matrix[0, 0] == pytest.approx(nearer**4, rel=0.02)  # no wall delays it


def test_the_content_hides_what_is_behind_it(renderer):
    pose = point_pose(180.0, n_side=6)
    assert power_matrix(renderer, pose, np.array([[0.05, 0.0, 0.0]]), GRID.points()).max() == 0.0
    field = ResidualField(
        points=np.array([[0.05, 0.0, 0.0]]), power=np.ones(1), looks=np.zeros(1, np.int64)
    )
    assert field_power(renderer, field, pose, GRID).max() == 0.0


def test_powers_of_the_field_add_as_in_the_matrix(renderer):
    pose = point_pose(30.0, n_side=14, spacing_m=0.006)
    field = ResidualField(
        points=SCATTERERS, power=np.array([1.0, 4.0, 2.0]), looks=np.array([0, 3, 3])
    )
    expected = power_matrix(renderer, pose, SCATTERERS, GRID.points()) @ field.power
    found = field_power(renderer, field, pose, GRID).ravel()
    np.testing.assert_allclose(found, expected, atol=0.05 * expected.max())


def test_the_bound_is_the_lower_quartile_over_the_planes():
    unexplained = np.array([[5.0, 1.0], [1.0, np.nan], [2.0, np.nan], [3.0, 2.0], [4.0, np.nan]])
    np.testing.assert_array_equal(allowed_power(unexplained), [2.0, 0.0])


def test_the_gradient_is_that_of_the_loss():
    rng = np.random.default_rng(0)
    matrix, surface, measured, weights = (
        rng.random((30, 7)), rng.random(30), 2.0 * rng.random(30), rng.random(30) + 0.5
    )  # fmt: skip
    shares = rng.random(7)
    _, gradient = loss_of_shares(shares, matrix, surface, measured, weights)
    for position in range(7):
        step = 1e-6 * np.eye(7)[position]
        both = [loss_of_shares(shares + s, matrix, surface, measured, weights)[0]
                for s in (step, -step)]  # fmt: skip
        assert gradient[position] == pytest.approx((both[0] - both[1]) / 2e-6, rel=1e-6)


def test_only_echoes_beside_the_surface_are_found(renderer):
    poses = planes(renderer, lambda _: SCATTERERS)
    fitted = fit_residual_field(renderer, ECHO, poses[:-1], GRID, CONFIG)
    assert fitted.gain_db > 1.0
    near = np.linalg.norm(fitted.field.points[:, None] - SCATTERERS, axis=2)
    by_power = np.bincount(near.argmin(axis=1), fitted.field.power * (near.min(axis=1) < 0.02))
    assert by_power.sum() > 0.8 * fitted.field.power.sum()
    assert (by_power > 0.0).all()
    view = render_surface_plane(renderer, ECHO, poses[-1], GRID, field=fitted.field)
    assert view.surface_psnr_db is not None
    assert view.psnr_db > view.surface_psnr_db + 1.0


def test_no_field_where_the_surface_is_too_bright(renderer):
    poses = [
        replace(pose, signal=0.7 * pose.signal)
        for pose in planes(renderer, lambda _: SCATTERERS[:0])
    ]
    fitted = fit_residual_field(renderer, ECHO, poses, GRID, CONFIG)
    assert fitted.gain_db == 0.0
    assert fitted.field.points.shape == (0, 3)


@pytest.mark.parametrize(("is_own", "helps"), [(True, False), (False, True)])
def test_echoes_at_other_points_in_each_plane_give_no_gain(is_own, helps):
    """Point v is lit in every fourth plane, its own, or in all."""
    n_planes, n_positions = 8, 12
    lit = np.arange(n_planes)[:, None] % 4 == np.arange(n_positions) % 4
    measured = np.where(lit | (not is_own), 1.0, 0.0)
    matrix, ones = np.eye(n_positions, dtype=np.float32), np.ones(n_positions)
    made = [PlaneAtTargets(matrix, 0.0 * ones, m, ones) for m in measured]
    positions = np.arange(n_positions)
    gain = left_out_gain(made, np.ones((n_planes, n_positions)), positions, CONFIG)
    assert (gain > 3.0) if helps else (gain < 0.0)


def test_arrays_restore_the_field_and_an_empty_field_adds_no_power(renderer):
    field = ResidualField(points=SCATTERERS, power=np.arange(3.0), looks=np.array([1, 0, 2]))
    again = ResidualField.of_arrays(field.arrays())
    for name in ("points", "power", "looks"):
        np.testing.assert_array_equal(getattr(again, name), getattr(field, name))
    pose = point_pose(0.0)
    assert surface_image(renderer, ECHO, pose, GRID).shape == GRID.shape
