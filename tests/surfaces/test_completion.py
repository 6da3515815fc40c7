"""Completion of a fitted field: what the network reads, what it may change, and what that gains."""

import itertools
from importlib.resources import as_file, files

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.io.checkpoint import Checkpoint, save_checkpoint
from geraf2.scene import Grid
from geraf2.scene.aperture import Aperture
from geraf2.surfaces.completion import (
    BAND_CM,
    SPACING_M,
    WEIGHTS_KIND,
    WEIGHTS_NAME,
    WEIGHTS_VERSION,
    Network,
    complete,
    features,
    load_network,
    trained_network,
)
from geraf2.surfaces.fit import FitConfig, fit_sdf
from geraf2.surfaces.isosurface import extract_surface
from geraf2.surfaces.linear_sdf import OrientedPoints
from helpers.glint_sets import glints_at
from helpers.shadows import outlines
from helpers.specular import fibonacci_sphere, frame
from reference.completion import inputs_of_voxel

RADIUS_M = 0.04
CENTER = np.array([0.003, -0.002, 0.001])
PLANES = [
    Aperture.from_rectangle(-0.4 * (axes := frame(30.0 * k))[0], axes, np.array([0.07, 0.12]))
    for k in range(12)
]


def sphere_field(spacing_m=SPACING_M, reach_m=0.075):
    """Signed distance of the sphere, with a ripple, so that no normal is exact."""
    n = round(2.0 * reach_m / spacing_m) + 1
    grid = Grid(origin_m=(-reach_m,) * 3, spacing_m=spacing_m, shape=(n, n, n))
    points = grid.points()
    ripple = 0.002 * np.sin(points @ np.array([90.0, 70.0, 50.0]))
    values = np.linalg.norm(points - CENTER, axis=1) - RADIUS_M + ripple
    return SdfGrid(grid=grid, values=values.reshape(grid.shape).astype(np.float32))


def evidence(n=60, seed=0):
    """Glints of the sphere's waist with errors."""
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((n, 3)) * np.array([1.0, 1.0, 0.3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = CENTER + (RADIUS_M + 0.001 * rng.standard_normal((n, 1))) * normals
    return weighted(positions, normals, rng.uniform(0.2, 1.0, n))


def weighted(positions, normals, weights):
    return OrientedPoints(
        positions=positions, normals=normals, position_weights=weights, normal_weights=weights
    )


def some_network(n_inputs, n_networks=2, seed=1):
    """Networks whose output has the order of a centimetre."""
    rng = np.random.default_rng(seed)

    def draw(*shape):
        return (rng.standard_normal(shape) / np.sqrt(shape[-1])).astype(np.float32)

    sizes = (n_inputs, 16, 16, 1)
    layers = [
        (draw(n_networks, n_out, n_in), draw(n_networks, n_out))
        for n_in, n_out in itertools.pairwise(sizes)
    ]
    mean, scale = draw(n_inputs), np.full(n_inputs, 0.5, dtype=np.float32)
    return Network(mean, scale, tuple(layers))


def n_inputs():
    return features(sphere_field(), evidence(), PLANES, chosen=np.array([0]))[0].shape[1]


@pytest.mark.parametrize(("n_glints", "axes"), [(60, None), (5, [1]), (60, [0, 1])])
def test_inputs_are_those_of_plain_loops(n_glints, axes):
    """With fewer glints than the network asks for as well, and with one outline, or none."""
    sdf, of = sphere_field(), evidence(n_glints)
    seen = None if axes is None else outlines(axes, (0.04, 0.03, 0.03))
    inputs, voxels, nearest_cm = features(sdf, of, PLANES, seen)
    chosen = np.random.default_rng(2).choice(len(voxels), 5, replace=False)
    for k in chosen:
        voxel = tuple(int(i) for i in np.unravel_index(voxels[k], sdf.grid.shape))
        expected, nearest = inputs_of_voxel(sdf, of, PLANES, seen, voxel)
        # Inputs are float32: an ulp at 4 cm is 5e-7 cm.
        np.testing.assert_allclose(inputs[k], expected, rtol=2e-6, atol=2e-6)
        assert nearest_cm[k] == pytest.approx(nearest)


def test_chosen_voxels_have_the_inputs_that_they_have_among_all():
    sdf, of = sphere_field(), evidence()
    every, voxels, nearest_cm = features(sdf, of, PLANES)
    chosen = np.array([5, 3, 400])
    some = features(sdf, of, PLANES, chosen=chosen)
    np.testing.assert_array_equal(voxels, np.flatnonzero(np.abs(sdf.values) < BAND_CM / 100.0))
    for got, expected in zip(some, (every, voxels, nearest_cm), strict=True):
        np.testing.assert_allclose(got, expected[chosen], rtol=1e-6)


def test_the_least_change_on_which_networks_agree_is_that_of_plain_loops():
    network, inputs = (
        some_network(7, n_networks=3),
        5.0 * np.random.default_rng(4).standard_normal((20, 7)),
    )
    expected = []
    for row in inputs:
        outputs = []
        for number in range(3):
            values = [(x - m) * s for x, m, s in zip(row, network.mean, network.scale, strict=True)]
            for depth, (matrix, offset) in enumerate(network.layers):
                sums = [
                    sum(float(w) * v for w, v in zip(weights, values, strict=True)) + float(shift)
                    for weights, shift in zip(matrix[number], offset[number], strict=True)
                ]
                values = sums if depth == 2 else [max(0.0, s) for s in sums]
            outputs.append(values[0])
        if min(outputs) > 0.0:
            expected.append(min(outputs))
        else:
            expected.append(min(0.0, max(outputs)))
    assert 0 < np.count_nonzero(expected) < len(expected)
    np.testing.assert_allclose(network.change_cm(inputs), expected, rtol=1e-6)


def test_the_field_stays_at_glints_and_changes_away_from_them():
    """At the voxels themselves, bit for bit: the network reads the field at the same spacing."""
    sdf, known = sphere_field(), evidence()
    points = sdf.grid.points()
    positions = np.concatenate([known.positions, points[::97]])  # many voxels have a glint
    normals = np.concatenate([known.normals, np.tile([0.0, 0.0, 1.0], (len(points[::97]), 1))])
    of = weighted(positions, normals, np.ones(len(positions))), PLANES
    completed = complete(sdf, *of, network=some_network(n_inputs(), n_networks=1))
    away = np.linalg.norm(points[:, None] - positions[None], axis=2).min(axis=1)
    change = (completed.values - sdf.values).ravel()
    band = np.abs(sdf.values.ravel()) < BAND_CM / 100.0
    assert (away < 0.003).sum() > 200
    np.testing.assert_array_equal(change[(away < 0.003) | ~band], 0.0)
    assert np.abs(change[(away > 0.003) & band]).max() > 0.005


def test_a_finer_field_changes_by_what_lies_between():
    """The change is interpolated from voxels of 5 mm; those of 2.5 mm take the same at the same
    places."""
    coarse, of = sphere_field(), (evidence(), PLANES)
    index = np.arange(2 * coarse.grid.shape[0] - 1) // 2
    fine = sphere_field(0.5 * SPACING_M)
    assert fine.grid.shape[0] == len(index)
    network = some_network(n_inputs())
    changes = [complete(sdf, *of, network=network).values - sdf.values for sdf in (coarse, fine)]
    np.testing.assert_allclose(changes[1][::2, ::2, ::2], changes[0], atol=1e-6)
    between = 0.5 * (changes[0][:-1] + changes[0][1:])
    np.testing.assert_allclose(changes[1][1::2, ::2, ::2], between, atol=1e-6)


def test_a_written_network_is_read_and_another_file_is_not(tmp_path):
    network = some_network(4)
    arrays = {"mean": network.mean, "scale": network.scale}
    for k, (matrix, offset) in enumerate(network.layers):
        arrays |= {f"matrix_{k}": matrix, f"offset_{k}": offset}
    kinds = {"network": WEIGHTS_KIND, "other": "another"}
    for name, kind in kinds.items():
        checkpoint = Checkpoint(kind=kind, version=WEIGHTS_VERSION, arrays=arrays, header={})
        save_checkpoint(tmp_path / name, checkpoint)
    inputs = np.random.default_rng(0).standard_normal((10, 4)).astype(np.float32)
    read = load_network(tmp_path / "network").change_cm(inputs)
    np.testing.assert_array_equal(read, network.change_cm(inputs))
    with pytest.raises(UserError, match="another kind"):
        load_network(tmp_path / "other")


def test_the_network_of_the_package_takes_the_inputs_that_there_are():
    with as_file(files("geraf2.surfaces") / WEIGHTS_NAME) as path:
        assert path.stat().st_size < 500_000
    network = trained_network()
    assert network.mean.shape == network.scale.shape == (n_inputs(),)
    assert [len(matrix) for matrix, _ in network.layers] == 3 * [len(network.layers[0][0])]


def balls(half_gap_m, radius_m=0.02):
    """Two balls one above the other, of which planes around see the waists.

    Returns the field of the fit, its evidence, and a function that gives the mean distance of the
    surface of a field to the balls [m].
    """
    centers = np.array([[0.0, 0.0, -half_gap_m], [0.0, 0.0, half_gap_m]])
    normals = fibonacci_sphere(800)
    normals = normals[np.abs(normals[:, 2]) < 0.35]
    positions = np.concatenate([center + radius_m * normals for center in centers])
    normals = np.tile(normals, (2, 1))
    sdf = fit_sdf(glints_at(positions, normals), FitConfig(spacing_m=SPACING_M), num_threads=1)

    def mean_error_m(of):
        vertices = extract_surface(of).vertices
        away = np.linalg.norm(vertices[:, None] - centers, axis=2).min(axis=1)
        return np.abs(away - radius_m).mean()

    return sdf, (weighted(positions, normals, np.ones(len(positions))), PLANES), mean_error_m


def test_two_balls_that_the_fit_joins_are_parted():
    sdf, of, mean_error_m = balls(half_gap_m=0.03)
    assert mean_error_m(complete(sdf, *of)) < 0.5 * mean_error_m(sdf)


def test_balls_that_the_fit_closes_well_stay_as_they_are():
    sdf, of, mean_error_m = balls(half_gap_m=0.05)
    assert mean_error_m(complete(sdf, *of)) < 1.1 * mean_error_m(sdf)


@pytest.mark.parametrize("n_glints", [1, 3, 31])
def test_few_glints_are_enough(n_glints):
    sdf = sphere_field()
    completed = complete(sdf, evidence(n_glints), PLANES)
    assert np.isfinite(completed.values).all()
    assert not np.array_equal(completed.values, sdf.values)


def test_a_scan_without_planes_is_completed_as_one_that_received_nothing():
    completed = complete(sphere_field(), evidence(), [])
    assert np.isfinite(completed.values).all()


def test_every_call_gives_the_same_bits_whatever_the_number_of_threads():
    sdf, of = sphere_field(), (evidence(), PLANES)
    found = []
    for n_threads in (1, 2, 2):
        with threadpool_limits(n_threads):
            found.append(complete(sdf, *of).values.tobytes())
    assert len(set(found)) == 1
