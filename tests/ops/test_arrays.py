"""Arrays as users have them: points of any shape, both precisions, lengths in millimetres."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from geraf2.fields import SdfGrid
from geraf2.imaging.volume import image_volume
from geraf2.ops import MatchedFilterPlan, matched_filter, signal_tracer
from geraf2.scene import Grid
from helpers.antennas import scattered
from helpers.synthetic import point_capture, waveform_of, white_noise

WAVEFORM = waveform_of(8)
TX, RX = scattered(np.random.default_rng(0), 37, -0.36, 0.01)
SIGNAL = white_noise((37, 8), seed=1)
SHAPES = [(), (5,), (2, 3), (2, 1, 4)]


def points_of(shape):
    return np.random.default_rng(2).uniform(-0.02, 0.02, (*shape, 3))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_an_image_has_the_shape_of_its_points_and_the_precision_of_its_signal(shape, dtype):
    points, signal = points_of(shape), SIGNAL.astype(dtype)
    image = matched_filter(signal, TX, RX, points, WAVEFORM)
    assert (image.shape, image.dtype) == (shape, dtype)
    rows = matched_filter(signal, TX, RX, points.reshape(-1, 3), WAVEFORM)
    assert np.array_equal(image.reshape(-1), rows)
    plan = MatchedFilterPlan(TX, RX, points, WAVEFORM, dtype=dtype)
    assert plan.image_shape == shape
    assert np.array_equal(plan.execute(signal), image)
    assert plan.adjoint(image).shape == signal.shape


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("before", [(), (37,)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_reflectors_may_have_any_shape(shape, before, dtype):
    points, normals = points_of(shape), -points_of(shape)
    amplitude = np.random.default_rng(3).uniform(size=(*before, *shape)).astype(dtype)
    got = signal_tracer(amplitude, points, TX, RX, WAVEFORM, normals=normals)
    rows = amplitude.reshape(*before, -1), points.reshape(-1, 3)
    want = signal_tracer(*rows, TX, RX, WAVEFORM, normals=normals.reshape(-1, 3))
    assert np.array_equal(got, want)
    assert got.dtype == (np.complex64 if dtype == np.float32 else np.complex128)
    with pytest.raises(ValueError, match="amplitude must have shape"):
        signal_tracer(np.ones((9, 9, 9)), points, TX, RX, WAVEFORM)


def test_gradients_have_the_shapes_of_their_tensors():
    points = torch.tensor(points_of((2, 3)), requires_grad=True)
    signal = torch.tensor(SIGNAL, dtype=torch.complex128)
    matched_filter(signal, TX, RX, points, WAVEFORM).abs().sum().backward()
    rows = points.detach().reshape(-1, 3).requires_grad_()
    matched_filter(signal, TX, RX, rows, WAVEFORM).abs().sum().backward()
    assert torch.equal(points.grad.reshape(-1, 3), rows.grad)
    points.grad = None
    amplitude = torch.ones((2, 3), dtype=torch.float64, requires_grad=True)
    signal_tracer(amplitude, points, TX, RX, WAVEFORM).abs().sum().backward()
    assert (points.grad.shape, amplitude.grad.shape) == ((2, 3, 3), (2, 3))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_field_is_sampled_at_points_of_any_shape(shape):
    grid = Grid.cube((0.0, 0.0, 0.0), 0.03, 7)
    values = np.random.default_rng(4).normal(size=grid.shape).astype(np.float32)
    field, points = SdfGrid(grid=grid, values=values), points_of(shape)
    found = field.sample(points)
    assert (found.shape, found.dtype) == (shape, np.float64)
    assert np.array_equal(found.reshape(-1), field.sample(points.reshape(-1, 3)))


@pytest.mark.parametrize("bad", [np.zeros(()), np.zeros((3, 2)), np.zeros((0, 4))])
def test_what_is_no_points_is_refused(bad):
    for call in (
        lambda: matched_filter(SIGNAL, TX, RX, bad, WAVEFORM),
        lambda: signal_tracer(np.ones(3), bad, TX, RX, WAVEFORM),
        lambda: SdfGrid(grid=Grid.cube((0, 0, 0), 0.1, 3), values=np.zeros((3,) * 3)).sample(bad),
    ):
        with pytest.raises(ValueError, match=r"points must have shape \(..., 3\)"):
            call()


def test_positions_in_millimetres_are_refused_and_a_long_sparse_line_is_not():
    line = np.linspace(-30.0, 30.0, 21)
    y, z = np.meshgrid(line, line)
    raster = np.stack([np.full(y.size, -360.0), y.ravel(), z.ravel()], axis=1)
    signal, points = white_noise((441, 8), seed=5), 1e3 * points_of((4,))
    grid = Grid.cube((0.0, 0.0, 0.0), 20.0, 3)
    for call in (
        lambda: matched_filter(signal, raster, raster, points, WAVEFORM),
        lambda: matched_filter(signal, raster, raster, grid, WAVEFORM),
        lambda: signal_tracer(np.ones(4), points, raster, raster, WAVEFORM),
    ):
        with pytest.raises(ValueError, match="if they are in millimetres, convert them to metres"):
            call()
    matched_filter(signal, 1e-3 * raster, 1e-3 * raster, 1e-3 * points, WAVEFORM)
    rail = np.stack([np.full(441, -9.0), np.linspace(-2.0, 2.0, 441), np.zeros(441)], axis=1)
    matched_filter(signal, rail, rail, 1e-3 * points, WAVEFORM)


@pytest.mark.parametrize(("dtype", "real"), [("complex64", "float32"), ("complex128", "float64")])
def test_a_volume_has_the_precision_of_the_samples(dtype, real):
    capture = point_capture(2)
    poses = tuple(replace(pose, signal=pose.signal.astype(dtype)) for pose in capture.poses)
    grid = Grid.cube((0.0, 0.0, 0.0), 0.03, 3)
    assert image_volume(replace(capture, poses=poses), grid).dtype == real
