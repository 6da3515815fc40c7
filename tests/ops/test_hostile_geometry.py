"""Geometry that no radar has: every kernel gives a bounded result or a clear error.

Coincident points and antennas, zero distances, denormal and huge coordinates, one antenna, no
points, NaN. A sum of unit phasors is bounded by the sum of its magnitudes whatever the geometry,
and that is what is asked of it; where coordinates are moderate, twins are in the other files.
"""

from contextlib import nullcontext

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from geraf2.ops import matched_filter, ray_march, sdf_grid, signal_tracer
from geraf2.ops.grid_energy import GridEnergy
from geraf2.ops.physical_optics import SurfaceElements, physical_optics
from geraf2.ops.subaperture import subaperture_peaks
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid, Wall
from helpers import hostile
from helpers.antennas import bins_of, blocks_of, members_of
from helpers.aperture_images import kernel_images
from helpers.synthetic import waveform_of, white_noise

WAVEFORM = waveform_of(9)
LEVELS = st.sampled_from(hostile.levels())
COMPLEX = st.sampled_from((np.complex64, np.complex128))
SCALES = st.sampled_from((0.0, 1e-42, 1e-30, 1.0, 1e15))
THREADS = st.sampled_from((1, 3))
ROUNDING = 1.01
"""Room for rtol = 1e-3 of each phasor, and rounding."""
# Seeds are fixed, so that a green run stays green; more examples find more.
few = settings(max_examples=30, deadline=None, derandomize=True)


@pytest.fixture(autouse=True, scope="module")
def _any_unit():
    """Positions that look like millimetres reach the kernels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("geraf2.ops._geometry.MAX_SPACING_WAVELENGTHS", np.inf)
        yield


@st.composite
def antennas_and_points(draw, counts=(0, 1, 2, 70)):
    n_antennas = draw(st.sampled_from((1, 2, 17)))
    tx = draw(hostile.positions(n_antennas))
    rx = draw(hostile.positions(n_antennas, near=tx))
    return tx, rx, draw(hostile.positions(draw(st.sampled_from(counts)), near=tx))


def refused_beyond(*positions, match=r"must be finite and within 1e\+06 m"):
    """What must be an error where positions are not finite or too far, and nothing else."""
    if hostile.allowed(*positions):
        return nullcontext()
    return pytest.raises(ValueError, match=match)


def assert_bounded(values, bound):
    """Finite, and no larger than the sum of the magnitudes."""
    values = np.asarray(values)
    assert np.isfinite(values).all()
    tiny = np.finfo(values.dtype).tiny
    assert (np.abs(values) <= ROUNDING * np.asarray(bound, dtype=np.float64) + tiny).all()


@few
@given(
    antennas_and_points(),
    COMPLEX,
    SCALES,
    LEVELS,
    THREADS,
    st.sampled_from(("exact", "block", "auto")),
)
def test_matched_filter(geometry, dtype, scale, level, threads, method):
    tx, rx, points = geometry
    signal = white_noise((len(tx), WAVEFORM.n_samples), dtype, scale=scale)
    with hostile.forced(level), refused_beyond(tx, rx, points):
        image = matched_filter(signal, tx, rx, points, WAVEFORM, method=method, num_threads=threads)
        assert_bounded(image, np.abs(signal).astype(np.float64).sum() / len(tx))
        tensors = [torch.from_numpy(a).requires_grad_(True) for a in (signal, tx, rx, points)]
        image = matched_filter(*tensors, WAVEFORM, method=method, num_threads=threads)
        (image.real.sum() + image.imag.sum()).backward()
        assert all(bool(torch.isfinite(t.grad).all()) for t in tensors)


@few
@given(
    hostile.positions(40),
    st.sampled_from(hostile.COORDINATES_M),
    st.sampled_from((1e-12, 1e-9, 1e-3, 0.1, 1e4)),
    st.sampled_from(((1, 1, 1), (1, 1, 40), (12, 12, 12))),
    COMPLEX,
    LEVELS,
)
def test_factorised_matched_filter(tx, origin, spacing, shape, dtype, level):
    signal = white_noise((len(tx), WAVEFORM.n_samples), dtype)
    grid = Grid(origin_m=(origin, 0.0, 0.01), spacing_m=spacing, shape=shape)
    with hostile.forced(level), refused_beyond(tx, np.abs(grid.points()[-1])):
        image = matched_filter(signal, tx, tx, grid, WAVEFORM, method="factorised")
        assert_bounded(image, np.abs(signal).sum() / len(tx))


@few
@given(antennas_and_points(), COMPLEX, SCALES, LEVELS, THREADS, st.booleans(), st.booleans())
def test_signal_tracer(geometry, dtype, scale, level, threads, specular, own):
    tx, rx, points = geometry
    shape = (len(tx), len(points)) if own else (len(points),)
    amplitude = white_noise(shape, dtype, scale=scale)
    normals = None
    if specular:
        rng = np.random.default_rng(4)
        normals = rng.choice([0.0, 1e-310, 0.6, -0.8], (len(points), 3)).astype(
            amplitude.real.dtype
        )
    with hostile.forced(level), refused_beyond(tx, rx, points):
        options = {"normals": normals, "num_threads": threads}
        signal = signal_tracer(amplitude, points, tx, rx, WAVEFORM, **options)
        # (w_o . w_r)+ <= 1 + 2 |n|^2
        gain = 1.0 if normals is None else 1.0 + 2.0 * (normals.astype(float) ** 2).sum(axis=1)
        bound = (np.abs(amplitude.astype(np.complex128)) * gain).sum(axis=-1)
        assert_bounded(signal, np.broadcast_to(bound, len(tx))[:, None])
        tensors = [torch.from_numpy(a).requires_grad_(True) for a in (amplitude, points, tx, rx)]
        echo = signal_tracer(*tensors, WAVEFORM, **options)
        (echo.real.sum() + echo.imag.sum()).backward()
        assert all(bool(torch.isfinite(t.grad).all()) for t in tensors)


@few
@given(antennas_and_points(counts=(1, 70)), COMPLEX, LEVELS, st.sampled_from(("exact", "block")))
def test_a_sample_that_is_no_number_is_not_hidden(geometry, dtype, level, method):
    tx, rx, points = geometry
    if not hostile.allowed(tx, rx, points):
        return
    signal = white_noise((len(tx), WAVEFORM.n_samples), dtype)
    signal[-1, 0] = np.nan
    amplitude = white_noise(len(points), dtype)
    amplitude[-1] = np.nan
    with hostile.forced(level):
        assert np.isnan(matched_filter(signal, tx, rx, points, WAVEFORM, method=method)).all()
        assert np.isnan(signal_tracer(amplitude, points, tx, rx, WAVEFORM)).all()


@st.composite
def subapertures(draw):
    n = draw(st.sampled_from((1, 2, 30)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pool = (0.0, 5e-324, 1e-9, 0.01, -0.04)
    positions = rng.choice(pool, (n, 2))
    if draw(st.integers(0, 4)) == 0:
        positions[0, 0] = draw(st.sampled_from((1e3, -1e6, 1e300, np.nan)))
    return positions, {
        "offsets": np.array([0, n, n]),
        "focus": draw(hostile.positions(2)),
        "focus_range_m": rng.choice((0.0, 0.4, 1e6), 2),
    }


@few
@given(subapertures(), st.data(), COMPLEX, LEVELS)
def test_subaperture_images_and_peaks(members, data, dtype, level):
    positions, rest = members
    n = len(positions)
    tx = data.draw(hostile.positions(n, near=rest["focus"]))
    signal = white_noise((n, WAVEFORM.n_samples), dtype)

    refused = refused_beyond(
        *(tx, rest["focus"], 1e4 * positions), match=r"must be finite|`places` must lie in"
    )
    with hostile.forced(level), refused:
        problem = (signal, tx, tx, WAVEFORM, members_of(positions, **rest), bins_of())
        assert_bounded(kernel_images(*problem), np.abs(signal).max())
        peaks = subaperture_peaks(*problem, thresholds_db=(99.0, -99.0))
        assert np.isfinite(peaks.cosines).all()


@few
@given(
    antennas_and_points(),
    COMPLEX,
    LEVELS,
    st.sampled_from(("point", "triangle", "rectangle")),
    st.booleans(),
    THREADS,
)
def test_physical_optics(geometry, dtype, level, shape, walled, threads):
    tx, rx, points = geometry
    n = len(points)
    rng = np.random.default_rng(8)
    elements = SurfaceElements(
        points=points,
        normals=rng.choice([0.0, 1e-310, 1.0], (n, 3)),
        edges=rng.choice([0.0, 5e-324, 1e-3, 2.0], (n, 2, 3)),
        shape=shape,
    )
    antennas = blocks_of(tx, rx, boresight=np.array([1.0, 0.0, 0.0]))
    weights = white_noise((1, n), dtype, scale=1e-6)
    walls = [Wall(size_m=(0.02, 0.02, 2.0), thickness_m=1e-3, permittivity=1.6)] if walled else []
    options = {"walls": walls, "num_threads": threads}
    with hostile.forced(level), refused_beyond(tx, rx, points):
        signal = physical_optics(elements, weights, antennas, WAVEFORM, **options)
        assert signal.shape == (len(tx), WAVEFORM.n_samples)
        # The echo goes as 1 / (R_t R_r): on an antenna it has no bound, NaN is its honest value.
        away = min(np.abs(points[:, None] - a).max(axis=2).min(initial=np.inf) for a in (tx, rx))
        assert away < 1e-9 or np.isfinite(signal).all()


REAL = st.sampled_from((np.float32, np.float64))


@few
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(((0, 4), (3, 0), (1, 1), (5, 17))),
    REAL,
    st.sampled_from((5e-324, 1e-30, 84.0, 1e30, 1e300)),
    THREADS,
    st.sampled_from(("unbiased", "squared", "none")),
)
def test_ray_march(seed, shape, dtype, inv_s, threads, two_way):
    rng = np.random.default_rng(seed)
    pool = np.array([0.0, 1e-42, -1e-42, 0.01, -0.01, 1e30, -1e30, 3e38, -3e38])
    sdf = rng.choice(pool, shape).astype(dtype)
    cos = rng.choice([-1.0, 0.0, 1e-42, 1.0, -1e30], shape).astype(dtype)
    step = rng.choice([0.0, 1e-42, 0.01, 1e6], shape).astype(dtype)
    with np.errstate(over="ignore", under="ignore"):
        if inv_s > np.finfo(dtype).max:
            with pytest.raises(ValueError, match="inv_s must be finite as float32, got 1e\\+300"):
                ray_march(sdf, cos, step, inv_s, two_way=two_way)
            return
        out = ray_march(sdf, cos, step, inv_s, two_way=two_way, num_threads=threads)
    for name in ("alpha", "transmittance", "weight"):
        values = getattr(out, name)
        assert values.shape == shape
        assert ((values >= 0.0) & (values <= 1.0 + 1e-6)).all(), name
    assert (out.depth >= 0.0).all()
    if sdf.size:
        sdf[0, 0] = np.nan
        spread = ray_march(sdf, cos, step, inv_s, two_way=two_way, num_threads=threads)
        assert np.isnan(spread.weight[0]).all()
        np.testing.assert_array_equal(spread.weight[1:], out.weight[1:])


@few
@given(
    hostile.positions(30),
    st.sampled_from(hostile.COORDINATES_M),
    st.sampled_from((1e-12, 1e-3, 1.0, 1e6, 1e300)),
    st.sampled_from(((1, 1, 1), (2, 1, 3), (4, 5, 6))),
    REAL,
    THREADS,
    st.sampled_from(("linear", "cubic")),
)
def test_sdf_grid(points, origin, spacing, shape, dtype, threads, interpolation):
    values = np.random.default_rng(10).choice([-0.02, 0.0, 1e-42, 0.03], shape).astype(dtype)
    grid = Grid(origin_m=(origin, 0.0, -0.02), spacing_m=spacing, shape=shape)
    options = {"interpolation": interpolation, "num_threads": threads}
    with refused_beyond(points):
        out = sdf_grid(values, grid, points, **options)
        # Catmull-Rom overshoots by at most a quarter of the values' span an axis, (5/4)^3 < 2.
        assert_bounded(out.value, 2.0 * 0.03)
        assert not np.isnan(out.gradient).any()


@few
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(((2, 2, 2), (2, 3, 9), (5, 4, 17))),
    REAL,
    st.sampled_from((1e-3, 1.0, 1e3)),
    LEVELS,
    THREADS,
)
def test_grid_energy(seed, shape, dtype, spacing, level, threads):
    n = int(np.prod(shape))
    rng = np.random.default_rng(seed)
    with hostile.forced(level):
        energy = GridEnergy(
            shape,
            (spacing,) * 3,
            bending=0.5,
            sparse=sp.csr_matrix((n, n)),
            diagonal=np.zeros(n),
            dtype=dtype,
            num_threads=threads,
        )
        field = rng.choice([0.0, 5e-324, 1e-30, 1.0, -1e10], n).astype(dtype)
        product = energy.apply(field)
        assert np.isfinite(product).all()
        # Never negative, but for rounding of the terms that cancel in it.
        wide = field.astype(np.float64)
        terms = (wide**2 * energy.diagonal()).sum()
        assert wide @ product.astype(np.float64) >= -64 * np.finfo(dtype).eps * terms
        field[-1] = np.nan
        assert np.isnan(energy.apply(field)[-1])


@few
@given(
    hostile.positions(30, refused=False),
    hostile.positions(9, refused=False),
    st.sampled_from((1.0, 1e-300, 1e300)),
    THREADS,
)
def test_mesh_scene(points, vertices, scale, threads):
    """Faces without area, coincident vertices, huge meshes: Embree keeps to float32 itself."""
    faces = np.arange(9).reshape(3, 3)
    scene = MeshScene(vertices, faces, num_threads=threads)
    with np.errstate(over="ignore"):
        distance = scene.distance(points)
        assert (distance >= 0.0).all()
        np.testing.assert_allclose(np.abs(scene.signed_distance(points)), distance)
        assert scene.contains(points).shape == (len(points),)
        assert np.isfinite(scene.winding_number(points)).all()
        assert not (scene.occluded(points, points)).any()
        directions = scale * np.array([[1.0, 0.0, 0.0]])
        away, _ = scene.closest_hit(points[:1], directions)
        assert (away >= 0.0).all()


@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1e300])
def test_a_direction_may_have_any_length(scale):
    """The square of its length under- or overflows; Embree aborts on a ray of NaN."""
    scene = MeshScene([[1.0, -1, -1], [1.0, 2, -1], [1.0, -1, 2]], [[0, 1, 2]])
    distance, face = scene.closest_hit(np.zeros((1, 3)), [[scale, 0.0, 0.0]])
    assert distance[0] == pytest.approx(1.0)
    assert face[0] == 0
    assert np.isfinite(scene.entry_exit(np.zeros((1, 3)), [[scale, 0.0, 0.0]]).t_entry).all()
