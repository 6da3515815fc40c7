"""Methods to compare with: their parts on cases with a known answer."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.baselines import BackProjectionConfig
from geraf2.baselines.back_projection import back_projection_cloud
from geraf2.baselines.heat import counted_voxels, grid_inside
from geraf2.baselines.level import LevelConfig, best_level
from geraf2.baselines.matched_filter_surface import plane_normals, sum_heat
from geraf2.baselines.normal_field import antenna_votes
from geraf2.baselines.poisson import poisson_surface, solve_gradient
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.ops import signal_tracer
from geraf2.scene import Capture, Grid, LosPrior, Pose, Wall
from helpers.synthetic import waveform_of

WAVEFORM = waveform_of(path_bias_m=0.0)
AXES = np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
TARGET = np.array([0.02, 0.012, -0.012])  # a voxel of the grids below


@pytest.fixture(scope="module")
def capture():
    """One plane at x = 0.4 m that looks at a single point."""
    lines = np.arange(-0.06, 0.0601, 0.004)
    y, z = (axis.ravel() for axis in np.meshgrid(lines, lines, indexing="ij"))
    positions = np.stack([np.full(y.size, 0.4), y, z], axis=1)
    signal = signal_tracer(np.ones(1, np.float32), TARGET[None], positions, positions, WAVEFORM)
    pose = Pose(signal=signal, tx_positions=positions, rx_positions=positions, axes=AXES)
    return Capture(waveform=WAVEFORM, poses=(pose,))


def sphere_points(n=3000, radius=0.04):
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius * normals, normals


def test_poisson_surface_of_a_sphere_is_the_sphere():
    grid = Grid.cube((0.0, 0.0, 0.0), 0.06, 41)
    positions, normals = sphere_points()
    sdf = poisson_surface(positions, normals, grid)
    rng = np.random.default_rng(2)
    rays = rng.normal(size=(200, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    radii = np.linspace(0.03, 0.05, 81)
    values = np.array([sdf.sample(r * rays) for r in radii])
    assert (values[0] < 0).all()
    assert (values[-1] > 0).all()
    crossing = radii[np.argmax(values > 0, axis=0)]
    assert abs(np.median(crossing) - 0.04) < 0.0015  # half a voxel
    assert np.abs(crossing - 0.04).max() < 0.003


def test_gradient_is_integrated_exactly_with_and_without_weights():
    rng = np.random.default_rng(0)
    wanted = rng.normal(size=(9, 7, 8))
    axes = np.meshgrid(*(np.arange(n, dtype=float) for n in wanted.shape), indexing="ij")
    linear = 0.3 * axes[0] - 0.2 * axes[1] + 0.5 * axes[2]
    vectors = [np.full(wanted.shape, v) for v in (0.3, -0.2, 0.5)]
    for weights in (None, rng.uniform(0.1, 1.0, wanted.shape)):
        found = solve_gradient(vectors, weights, tolerance=1e-10)
        assert np.allclose(found, linear - linear.mean(), atol=1e-6)


def test_crop_counts_from_the_innermost_known_box():
    walls = (
        Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.004, permittivity=1.6),
        Wall(size_m=(0.1, 0.12, 0.14), thickness_m=0.003, permittivity=1.6),
    )
    prior = LosPrior.from_box((0.2, 0.2, 0.2), walls=walls)
    grid = grid_inside(prior, 0.01)
    counted = counted_voxels(prior, grid, 0.01)
    reach = np.abs(grid.points()[counted.ravel()]).max(axis=0)
    assert (reach < np.array([0.04, 0.05, 0.06]) + 1e-9).all()
    assert (reach > np.array([0.04, 0.05, 0.06]) - 0.0101).all()
    with pytest.raises(UserError, match="leaves nothing"):
        counted_voxels(prior, grid, 0.06)


def test_plane_normals_of_a_sheet_point_as_given():
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-0.02, 0.02, (400, 2)), np.zeros((400, 1))], axis=1)
    toward = np.tile([0.3, 0.0, -1.0], (400, 1))
    normals = plane_normals(points + 5.0, toward, 0.006)
    assert np.allclose(normals, [0.0, 0.0, -1.0], atol=1e-6)
    lonely = plane_normals(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), toward[:2], 0.006)
    assert np.allclose(lonely, toward[:2])


def test_heat_is_largest_at_the_point(capture):
    grid = Grid.cube(tuple(TARGET), 0.02, 11)
    total = sum_heat(capture, grid)
    assert np.unravel_index(total.heat.argmax(), grid.shape) == (5, 5, 5)
    assert (total.strongest == 0).all()


def test_votes_equal_the_sum_over_antennas(capture):
    """Against the definition: each antenna's own contribution, one after the other."""
    positions = TARGET + np.array([[0.0, 0.0, 0.0], [0.004, -0.003, 0.006], [-0.01, 0.01, 0.0]])
    pose = capture.poses[0]
    frequency = WAVEFORM.frequencies_hz
    for position in positions:
        path = 2.0 * np.linalg.norm(pose.tx_positions - position, axis=1)
        phase = np.exp(2j * np.pi * frequency * path[:, None] / 299792458.0)
        each = (pose.signal * phase).sum(axis=1) / pose.n_antennas
        whole = each.sum()
        toward = pose.phase_centers - position
        center = pose.phase_centers.mean(axis=0)
        wanted = (np.conj(whole) / abs(whole) * each).real @ toward
        wanted /= np.linalg.norm(center - position)
        grid = Grid(origin_m=tuple(position), spacing_m=0.001, shape=(1, 1, 1))
        vote = antenna_votes(capture, pose, grid).ravel()
        assert np.allclose(vote, wanted, atol=2e-3 * np.linalg.norm(wanted))


def test_level_is_judged_by_the_part_that_is_shown(capture):
    """A ball, and a larger one nearer to the plane that nobody measured."""
    grid = Grid.cube((0.0, 0.0, 0.0), 0.1, 51)
    ball, ghost = np.array([-0.02, 0.0, 0.0]), np.array([0.06, 0.04, 0.0])
    positions = grid.points()
    to_ball = np.linalg.norm(positions - ball, axis=1)
    relative = np.minimum(to_ball, np.linalg.norm(positions - ghost, axis=1) - 0.01)
    sdf = SdfGrid(grid=grid, values=relative.reshape(grid.shape).astype(np.float32))
    points, normals = sphere_points(n=20000, radius=0.02)
    pose = capture.poses[0]
    front = normals[:, 0] > 0.0
    signal = signal_tracer(
        np.ones(int(front.sum()), np.float32),
        points[front] + ball,
        pose.tx_positions,
        pose.rx_positions,
        WAVEFORM,
        normals=normals[front],
    )
    measured = Capture(waveform=WAVEFORM, poses=(replace(pose, signal=signal),))
    counted = np.ones(grid.shape, dtype=bool)
    config = LevelConfig(reach_m=0.016, n_levels=9)

    def of_the_ball(vertices, faces):
        middles = vertices[faces].mean(axis=1)
        near = np.linalg.norm(middles - ball, axis=1) < np.linalg.norm(middles - ghost, axis=1)
        return faces[near]

    step = 0.004
    level = best_level(sdf, counted, measured, 0.02, config, shown=of_the_ball)
    assert abs(level - 0.02) < 1.1 * step
    misled = best_level(sdf, counted, measured, 0.02, config)
    assert abs(misled - 0.02) > 2.9 * step


def test_cloud_finds_the_point_and_looks_at_the_plane(capture):
    prior = LosPrior.from_box((0.16, 0.16, 0.16))
    config = BackProjectionConfig(spacing_m=0.004, crop_m=0.01, dynamic_range_db=3.0)
    cloud = back_projection_cloud(capture, prior, config)
    strongest = cloud.positions[cloud.strengths.argmax()]
    assert np.linalg.norm(strongest - TARGET) < 0.004
    assert np.allclose(cloud.normals, [1.0, 0.0, 0.0])
