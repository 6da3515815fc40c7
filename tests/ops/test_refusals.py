"""Arguments of ops that do not go together, or would end the process, are refused by name."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import torch

from geraf2 import MatchedFilterPlan
from geraf2.ops import (
    EchoForm,
    SamplePairs,
    _threads,
    matched_filter,
    ray_march,
    sdf_grid,
    signal_tracer,
    simd_level,
)
from geraf2.ops.grid_energy import GridEnergy
from geraf2.ops.lensless import echo_amplitudes, facing_samples
from geraf2.ops.physical_optics import SurfaceElements, physical_optics
from geraf2.ops.point_images import point_images
from geraf2.ops.subaperture import CosineAxis, Lattice
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid
from helpers import hostile
from helpers.antennas import bins_of, blocks_of, members_of
from helpers.aperture_images import kernel_images
from helpers.synthetic import WAVEFORM, waveform_of

GRID = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=1.0, shape=(5, 4, 6))
GEOMETRY = {"tx": np.zeros((4, 3)), "rx": np.zeros((4, 3)), "points": np.zeros((2, 3))}
GEOMETRY["waveform"] = waveform_of()
TWO_BY_THREE = np.zeros((2, 3))
GOOD = {
    matched_filter: {"signal": np.zeros((4, 32), complex), **GEOMETRY},
    signal_tracer: {"amplitude": np.zeros(2), **GEOMETRY},
    ray_march: {"sdf": TWO_BY_THREE, "cos": TWO_BY_THREE, "step": TWO_BY_THREE, "inv_s": 9.0},
    sdf_grid: {"values": np.zeros(GRID.shape), "grid": GRID, "points": TWO_BY_THREE},
}
OF_GEOMETRY = (
    ({"tx": np.zeros((4, 2))}, ValueError, r"tx must have shape \(\*, 3\)"),
    ({"tx": np.zeros((4, 3), complex)}, TypeError, "tx must be real"),
    ({"rx": np.zeros((1, 3))}, ValueError, r"rx must have shape \(4, 3\)"),
    ({"tx": np.zeros((0, 3)), "rx": np.zeros((0, 3))}, ValueError, "one antenna"),
    ({"points": np.full((2, 3), np.nan)}, ValueError, "finite.*row 0"),
    ({"points": np.full((2, 3), 1e7)}, ValueError, "within 1e"),
    ({"points": np.zeros((2, 4))}, ValueError, "points must have shape"),
    ({"waveform": 77e9}, TypeError, "waveform must be a geraf2.scene.Waveform"),
    ({"rtol": 0.0}, ValueError, "rtol must lie between 0 and 1"),
    ({"rtol": np.nan}, ValueError, "rtol must lie between 0 and 1"),
    ({"num_threads": 0}, ValueError, "num_threads must be at least 1"),
    ({"num_threads": 1.5}, TypeError, "num_threads must be an int"),
)
OWN = {
    matched_filter: (
        ({"signal": np.zeros(32, complex)}, ValueError, r"signal must have shape"),
        ({"signal": np.zeros((5, 31), complex)}, ValueError, r"\(4, 32\), got \(5, 31\)"),
        ({"signal": np.zeros((4, 32))}, TypeError, "complex64 or complex128"),
        ({"method": "fast"}, ValueError, "'block', 'factorised', got 'fast'"),
    ),
    signal_tracer: (
        ({"amplitude": np.zeros((1, 4, 2))}, ValueError, r"\(2,\) or \(4, 2\), got"),
        ({"amplitude": np.zeros((1, 2))}, ValueError, r"got \(1, 2\)"),
        ({"amplitude": np.zeros(2, int)}, TypeError, "amplitude must be float32"),
        ({"normals": np.zeros((3, 3))}, ValueError, r"normals must have shape"),
        ({"normals": np.zeros((2, 3), int)}, TypeError, "normals must be float32"),
    ),
    ray_march: (
        ({"sdf": np.zeros(4)}, ValueError, "sdf must have shape"),
        ({"sdf": np.zeros((2, 3), int)}, TypeError, "sdf must be float32"),
        ({"cos": np.zeros((2, 4))}, ValueError, r"cos must have shape \(2, 3\)"),
        ({"step": np.zeros((2, 3), np.float32)}, TypeError, "step must be float64 as sdf is"),
        ({"inv_s": 0.0}, ValueError, "inv_s must be finite and positive, got 0.0"),
        ({"two_way": "both"}, ValueError, "'unbiased', 'squared', 'none', got 'both'"),
    ),
    sdf_grid: (
        ({"values": np.zeros((5, 4, 5))}, ValueError, r"values must have shape \(5, 4, 6\)"),
        ({"values": np.zeros(GRID.shape, int)}, TypeError, "values must be float32"),
        ({"points": np.full((1, 3), np.nan)}, ValueError, "finite.*row 0"),
        ({"grid": None}, TypeError, "grid must be a geraf2.scene.Grid, got NoneType"),
        ({"interpolation": "spline"}, ValueError, "'linear' or 'cubic', got 'spline'"),
    ),
}
ROWS = [(f, *row) for f in (matched_filter, signal_tracer) for row in OF_GEOMETRY]
ROWS += [(f, *row) for f, rows in OWN.items() for row in rows]


@pytest.mark.parametrize("kind", ["numpy", "torch"])
@pytest.mark.parametrize(("function", "change", "error", "message"), ROWS)
def test_arguments_of_arrays_and_tensors(function, change, error, message, kind):
    arguments = GOOD[function] | change
    if kind == "torch":
        arguments = {
            key: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
            for key, value in arguments.items()
        }
    with pytest.raises(error, match=message):
        function(**arguments)


N, POINT = 16, np.zeros((1, 3))
PLANE = np.random.default_rng(0).uniform(-0.006, 0.006, (N, 3))
SAMPLES = np.ones((N, WAVEFORM.n_samples), complex)
FORM = EchoForm(centers=np.array([[1.0, 0.0, 0.0]]))
PLAN = MatchedFilterPlan(PLANE, PLANE, GRID, WAVEFORM, dtype=np.complex128)


def plan(**changes):
    points = changes.pop("points", GRID)
    return MatchedFilterPlan(PLANE, PLANE, points, WAVEFORM, **{"dtype": np.complex128} | changes)


def triangle(faces=((0, 1, 2),), **options):
    return MeshScene(np.eye(3), np.array(faces).reshape(-1, 3), **options)


def energy(columns=(), **changes):
    matrix = sp.csr_matrix((8, 8))
    matrix.indptr = np.array([0] + 8 * [len(columns)], dtype=np.int32)
    matrix.indices, matrix.data = np.array(columns, dtype=np.int32), np.ones(len(columns))
    parts = {"shape": (2, 2, 2), "spacing": (1.0,) * 3, "bending": 1.0, "sparse": matrix}
    parts |= {"diagonal": np.ones(8), **changes}
    return GridEnergy(parts.pop("shape"), parts.pop("spacing"), **parts)


def looks(n_looks=1, points=None):
    points = np.zeros((6, 3)) if points is None else points
    return facing_samples(torch.ones(2, 3), torch.ones(6, 3), points, FORM, n_looks=n_looks)


def amplitudes(outside=0, shift=6, form=FORM):
    rays = torch.ones(2, 3)
    pairs = SamplePairs(outside + np.arange(6), np.array([0, 6]), 1)
    return echo_amplitudes(
        rays, rays, torch.ones(6, 3), np.zeros((6, 3)), pairs, torch.zeros(shift), form
    )


def images(lattice=None, scale=1.0, signal=SAMPLES, bins=None, **changes):
    members = members_of(scale * PLANE[:, 1:], lattice=lattice)
    members = replace(members, **{k: change(members) for k, change in changes.items()})
    return kernel_images(signal, PLANE, PLANE, WAVEFORM, members, bins or bins_of())


def lattice(shape):
    return Lattice(shape=shape, spacing_m=(1.0, 1.0))


def echo(weights):
    return physical_optics(SurfaceElements(points=POINT), weights, blocks_of(PLANE), WAVEFORM)


def aside():
    return replace(bins_of(), vertical=replace(bins_of().vertical, first=0.0))


def imaged(others, points=POINT):
    signals = torch.from_numpy(SAMPLES)[None]
    return point_images(signals, signals[others], PLANE, PLANE, points, WAVEFORM)


def on_meta():
    arguments = GOOD[matched_filter]
    return matched_filter(**arguments | {"signal": torch.zeros((4, 32), device="meta")})


CALLS = [
    (on_meta, "signal must be on the CPU, got device meta"),
    (lambda: triangle(np.zeros((0, 3), int)), "at least one triangle"),
    (lambda: triangle(num_threads=10**6), "at most 1024, got 1000000"),
    (lambda: triangle(num_threads=-1), "at least 1, got -1"),
    (lambda: triangle([[0, 1, 2**40]]), "index 3 vertices"),
    (lambda: triangle().closest_hit(POINT, POINT), "directions must not be zero"),
    (lambda: triangle().occluded(POINT, POINT + 1, margin_m=np.nan), "margin_m must be finite"),
    (lambda: looks(0), "n_looks must be 1 to 10000, got 0"),
    (lambda: looks(2**40), "n_looks must be 1 to 10000"),
    (lambda: looks(points=np.full((6, 3), np.nan)), "points must be finite"),
    (lambda: amplitudes(shift=5), "shift must have shape"),
    (lambda: amplitudes(outside=1), "sample must be indices"),
    (lambda: amplitudes(form=replace(FORM, centers=np.ones((2, 3)))), "a part for each group"),
    (lambda: energy([8]), "must be < 8"),
    (lambda: energy([2**31 - 1]), "must be < 8"),
    (lambda: energy([-1]), "must be >"),
    (lambda: energy(shape=(1, 4, 4)), "at least 2"),
    (lambda: energy(spacing=(0.1, 0.0, 0.1)), "positive"),
    (lambda: energy(bending=np.nan), "finite"),
    (lambda: energy(sparse=sp.csr_matrix((3, 3))), "sparse must have shape"),
    (lambda: energy(diagonal=np.zeros(5)), "diagonal"),
    (lambda: blocks_of(PLANE, pattern_exponent=2**31 - 1), "0 to 100, got 2147483647"),
    (lambda: blocks_of(PLANE, pattern_exponent=-1), "pattern_exponent must be 0 to 100, got -1"),
    (lambda: blocks_of(PLANE, offsets=[0, 9]), "offsets must rise from 0 to 16"),
    (lambda: echo(np.ones((1, 1))), "weights must be complex64 or complex128, got float64"),
    (lambda: echo(np.ones((2, 1), complex)), r"weights must have shape \(1, 1\), got \(2, 1\)"),
    (lambda: SurfaceElements(points=POINT, reflector="slab"), "needs slab and normals"),
    (lambda: images(lattice((2**40, 2**40))), "lattice needs 1 to"),
    (lambda: images(lattice((0, 4))), "lattice needs 1 to"),
    (lambda: images(scale=1e30), "`places` must lie in a sub-aperture"),
    (lambda: images(signal=SAMPLES.real), "complex64 or complex128, got float64"),
    (lambda: images(antennas=lambda m: m.antennas + 1), "antennas must lie in 0 to"),
    (lambda: images(offsets=lambda _: np.array([1, N])), "offsets must ascend"),
    (lambda: images(positions=lambda m: np.nan * m.positions), "positions must be finite"),
    (lambda: images(bins=aside()), "symmetric"),
    (lambda: CosineAxis.symmetric(4, 0.1, wraps=False), "odd"),
    (lambda: bins_of(n_ranges=0), "n_ranges must be at least 1"),
    (lambda: imaged((slice(None), slice(1, None))), "others must have shape"),
    (lambda: imaged(slice(0), np.full((1, 3), np.inf)), "points must be finite"),
    (lambda: PLAN.execute(SAMPLES.astype("c8")), "signal must be complex128, as the plan .*64"),
    (lambda: PLAN.execute(SAMPLES[1:]), r"signal .*\(16, 32\).*\(15, 32\)"),
    (lambda: PLAN.adjoint(np.zeros(120, complex)), r"image .*\(5, 4, 6\).*\(120,\)"),
    (lambda: plan(dtype=np.float64), "dtype must be complex64 or complex128, got float64"),
    (lambda: plan(points=POINT, method="factorised"), "'factorised' needs points on a"),
    (lambda: plan(method="fast"), "method must be one of"),
]


@pytest.mark.parametrize(("call", "message"), CALLS, ids=[message for _, message in CALLS])
def test_arguments_of_other_ops(call, message):
    with pytest.raises((ValueError, TypeError), match=message):
        call()


@pytest.mark.parametrize("value", hostile.REFUSED_M)
def test_coordinates_of_meshes_that_are_not_finite(value):
    bad = np.array([[0.0, 0.0, value]])
    with pytest.raises(ValueError, match="vertices must be finite and within"):
        MeshScene(np.repeat(bad, 3, axis=0), [[0, 1, 2]])
    scene = triangle()
    for query in (scene.distance, scene.contains, scene.winding_number):
        with pytest.raises(ValueError, match="points must be finite and within"):
            query(bad)
    with pytest.raises(ValueError, match="targets must be finite and within"):
        scene.occluded(POINT, bad)


@pytest.mark.gradient
@pytest.mark.parametrize("function", [matched_filter, signal_tracer])
def test_a_second_derivative_is_not_silently_missing(function):
    arguments = GOOD[function] | {"points": torch.full((2, 3), 0.3)}
    name = next(iter(arguments))
    given = torch.from_numpy(arguments[name]).requires_grad_(True)
    found = function(**arguments | {name: given})
    (grad,) = torch.autograd.grad(found.abs().pow(2).sum(), given, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        grad.abs().sum().backward()


def test_settings_of_the_environment(monkeypatch):
    monkeypatch.setenv("GERAF2_SIMD", "neon")
    with pytest.raises(ValueError, match="GERAF2_SIMD must be baseline, avx2 or avx512, got neon"):
        simd_level()
    monkeypatch.setattr(_threads.sys, "modules", {})  # without torch, whose number they are
    monkeypatch.setattr(_threads._core, "max_threads", lambda: 99999)
    with pytest.raises(ValueError, match="at most 1024, got 99999; is OMP_NUM_THREADS right"):
        triangle()
