"""Signal tracer against its slow twin, the matched filter and finite differences.

Tolerances. float32: a wide block's carrier phase is at most 30 half turns, one ulp of which is
6e-6 rad, and there are four roundings of that size: 2e-5. float64: 2e3 rad of reference phase, an
ulp of which is 2e-13. Blocks: the error of every phasor is below rtol, hence of white noise too,
about ten times so.
"""

import numpy as np
import pytest
import torch

from geraf2.ops import matched_filter, signal_tracer
from helpers.antennas import scattered
from helpers.synthetic import waveform_of, white_noise
from reference import signal_tracer as reference
from reference.closeness import assert_adjoint, assert_close, relative_error

SPREADS_M = {"blocks": 0.02, "points": 0.6}
"""Half the edge of the cube of points: dense enough for blocks, or for none."""


def make_case(
    kind="shared", *, specular=True, n_antennas=37, n_samples=32, n_points=200, spread_m=0.02
):
    """Amplitudes of white noise, bistatic antennas 0.4 m and more away, points in a cube.

    The cube hangs behind x = 0, so that no point comes near an antenna, however wide it is.
    """
    rng = np.random.default_rng(0)
    tx, rx = scattered(rng, n_antennas, -0.4, 0.05)
    points = rng.uniform(-spread_m, spread_m, (n_points, 3)) + np.array([spread_m, 0.0, 0.0])
    shape = (n_points,) if kind.startswith("shared") else (n_antennas, n_points)
    amplitude = rng.normal(size=shape)
    if kind.endswith("complex"):
        amplitude = amplitude + 1j * rng.normal(size=shape)
    # Some face the antennas, some face away from both, some are cut off by the specular factor.
    normals = rng.normal(size=(n_points, 3)) + np.array([1.0, 0.0, 0.0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tensors = [torch.from_numpy(a) for a in (amplitude, points, tx, rx)]
    return tensors, torch.from_numpy(normals) if specular else None, waveform_of(n_samples)


KINDS = ("shared", "shared complex", "antenna", "antenna complex")
SOME_KINDS = ("shared complex", "antenna")
"""Both layouts and both number types; each instruction set need not see their product."""


@pytest.mark.parametrize(
    ("kind", "specular"),
    [
        ("shared", True),
        ("shared complex", True),
        ("antenna", False),
        ("antenna complex", True),
    ],
)
@pytest.mark.parametrize("spread", SPREADS_M)
def test_float64_signal_is_that_of_the_twin(kind, spread, specular, simd):
    case, normals, waveform = make_case(kind, specular=specular, spread_m=SPREADS_M[spread])
    want = reference.signal_tracer(*case, waveform, normals)
    for rtol, limit in ((1e-3, 5e-4), (1e-4, 5e-5), (1e-8, 5e-9)):
        got = signal_tracer(*case, waveform, normals=normals, rtol=rtol)
        assert got.dtype == torch.complex128
        assert relative_error(got, want) < (limit if spread == "blocks" else 1e-11)


@pytest.mark.parametrize("n_samples", [1, 2, 31, 200])
def test_any_number_of_samples(n_samples, simd):
    case, normals, waveform = make_case(n_samples=n_samples, n_points=80, spread_m=0.01)
    got = signal_tracer(*case, waveform, normals=normals, rtol=1e-8)
    assert relative_error(got, reference.signal_tracer(*case, waveform, normals)) < 1e-8


@pytest.mark.parametrize("spread", SPREADS_M)
@pytest.mark.parametrize("kind", SOME_KINDS)
def test_float32_signal_is_that_of_the_float64_twin(kind, spread, simd):
    case, normals, waveform = make_case(kind, spread_m=SPREADS_M[spread])
    single = case[0].to(torch.complex64 if case[0].is_complex() else torch.float32)
    normals = normals.float()
    got = signal_tracer(single, *case[1:], waveform, normals=normals, rtol=1e-5)
    assert got.dtype == torch.complex64
    exact = single.to(torch.complex128 if single.is_complex() else torch.float64)
    want = reference.signal_tracer(exact, *case[1:], waveform, normals.double())
    assert_close(got, want, element=2e-4, norm=2e-5, cosine=1e-8, bias=2e-5)


@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-8])
@pytest.mark.parametrize("distance_m", [3.0, 0.36, 0.05, 0.004])
def test_no_phasor_of_a_block_is_wrong_by_more_than_rtol(rtol, distance_m):
    # One unit vector of gradient and one antenna: the gradient of the amplitude is that sample's
    # phasor itself. The last sample's frequency is farthest from mid-band. At 4 mm the antenna
    # stands inside a block and the range series cannot hold: the guard must see it.
    (_, points, _, _), _, waveform = make_case(specular=False, n_points=3000, spread_m=0.01)
    points = points - torch.tensor([0.01, 0.0, 0.0])
    tx = torch.tensor([[-distance_m, 0.0, 0.001]], dtype=torch.float64)
    rx = tx + torch.tensor([[0.0, 0.003, 0.0]], dtype=torch.float64)
    amplitude = torch.zeros(3000, dtype=torch.complex128, requires_grad=True)
    sample = torch.zeros((1, waveform.n_samples), dtype=torch.complex128)
    sample[0, -1] = 1.0
    signal_tracer(amplitude, points, tx, rx, waveform, rtol=rtol).backward(sample)
    again = torch.zeros(3000, dtype=torch.complex128, requires_grad=True)
    reference.signal_tracer(again, points, tx, rx, waveform).backward(sample)
    assert float((amplitude.grad - again.grad).abs().max()) < rtol


@pytest.mark.parametrize("spread", SPREADS_M)
def test_it_is_the_adjoint_of_the_matched_filter(spread):
    (amplitude, points, tx, rx), _, waveform = make_case(
        "shared complex", specular=False, spread_m=SPREADS_M[spread]
    )
    noise = torch.from_numpy(white_noise((37, 32)))
    image = matched_filter(noise, tx, rx, points, waveform, rtol=1e-9)
    signal = signal_tracer(amplitude, points, tx, rx, waveform, rtol=1e-9)
    assert_adjoint(amplitude, signal, noise, image * tx.shape[0], ulp=5e6)  # 1e-9


def gradients(case, normals, waveform, signal_grad, **options):
    inputs = [t.clone().requires_grad_(True) for t in case]
    facing = None if normals is None else normals.clone().requires_grad_(True)
    signal_tracer(*inputs, waveform, normals=facing, **options).backward(signal_grad)
    return [t.grad for t in (*inputs, facing) if t is not None]


@pytest.mark.gradient
@pytest.mark.parametrize(("specular", "near"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kind", SOME_KINDS)
def test_backward_is_the_adjoint(kind, dtype, specular, near, simd):
    # Forward and backward use the same approximation, so only rounding may part them: products
    # with up to 100 ulp each, with random signs (docs/testing.md). Were they different, rtol =
    # 1e-3 would leave about 1e-5. Near an antenna the guard must decide alike in both.
    case, normals, waveform = make_case(kind, specular=specular)
    case[2] = case[2] + torch.tensor([0.38 if near else 0.0, 0.0, 0.0])
    normals = None if normals is None else normals.to(dtype)
    amplitude = case[0].to(dtype.to_complex() if case[0].is_complex() else dtype)
    amplitude.requires_grad_(True)
    y = torch.from_numpy(white_noise((37, 32))).to(dtype.to_complex())
    forward = signal_tracer(amplitude, *case[1:], waveform, normals=normals)
    forward.backward(y)
    assert_adjoint(amplitude, forward, y, amplitude.grad)


@pytest.mark.gradient
@pytest.mark.parametrize("specular", [False, True])
@pytest.mark.parametrize("spread_m", [0.0005, 0.6])
@pytest.mark.parametrize("kind", KINDS)
def test_gradcheck_of_everything(kind, spread_m, specular):
    # Within 1 mm a few points form a block, here at its most accurate tier. A step of 1e-7 m turns
    # the phase by 3e-4 rad: truncation 2e-8, rounding 1e-8 of the slope.
    case, normals, waveform = make_case(
        kind, specular=specular, n_antennas=3, n_samples=5, n_points=6, spread_m=spread_m
    )
    inputs = [t.requires_grad_(True) for t in (*case, normals) if t is not None]
    assert torch.autograd.gradcheck(
        lambda *args: signal_tracer(
            *args[:4], waveform, normals=args[4] if specular else None, rtol=1e-11, num_threads=1
        ),
        inputs,
        eps=1e-7,
        atol=2e-3,  # slopes to positions are of the order of 1e4, and 2e3 rad round at 2e-13
        rtol=1e-5,
    )


@pytest.mark.gradient
@pytest.mark.parametrize("spread", SPREADS_M)
@pytest.mark.parametrize("kind", SOME_KINDS)
def test_float32_gradients_are_those_of_the_float64_twin(kind, spread, simd):
    case, normals, waveform = make_case(
        kind, n_antennas=19, n_points=120, spread_m=SPREADS_M[spread]
    )
    single = [t.to(torch.complex64 if t.is_complex() else torch.float32) for t in (*case, normals)]
    signal_grad = torch.from_numpy(white_noise((19, 32)))
    got = gradients(single[:4], single[4], waveform, signal_grad.to(torch.complex64), rtol=1e-5)
    # The twin sees the rounded positions: a float32 ulp of 0.36 m is 3e-8 m, or 1e-4 rad.
    inputs = [t.to(torch.complex128 if t.is_complex() else torch.float64) for t in single]
    inputs = [t.requires_grad_(True) for t in inputs]
    reference.signal_tracer(*inputs[:4], waveform, inputs[4]).backward(signal_grad)
    for have, want, given in zip(got, inputs, single, strict=True):
        assert have.dtype == given.dtype
        assert_close(have, want.grad, element=1e-3, norm=3e-5, cosine=1e-8, bias=3e-5)


@pytest.mark.gradient
def test_gradients_of_blocks_keep_to_rtol(simd):
    case, normals, waveform = make_case("antenna", n_points=400)
    signal_grad = torch.from_numpy(white_noise((37, 32)))
    got = gradients(case, normals, waveform, signal_grad, rtol=1e-3)
    inputs = [t.clone().requires_grad_(True) for t in (*case, normals)]
    reference.signal_tracer(*inputs[:4], waveform, inputs[4]).backward(signal_grad)
    for have, want in zip(got, inputs, strict=True):
        assert relative_error(have, want.grad) < 1e-3


def test_a_mirror_sends_back_what_meets_it_head_on():
    # Monostatic, at the angle a to the normal, the factor is cos 2a; beyond 45 degrees nothing.
    waveform = waveform_of(4)
    tx = torch.zeros((1, 3), dtype=torch.float64)
    point = torch.tensor([[0.5, 0.0, 0.0]], dtype=torch.float64)
    amplitude = torch.ones(1, dtype=torch.float64)
    for degrees in (0.0, 20.0, 44.0, 50.0, 130.0, 180.0):
        a = np.deg2rad(degrees)
        normal = torch.tensor([[-np.cos(a), np.sin(a), 0.0]], dtype=torch.float64)
        signal = signal_tracer(amplitude, point, tx, tx, waveform, normals=normal)
        want = max(0.0, np.cos(2.0 * a))
        assert signal.abs().numpy() == pytest.approx(np.full((1, 4), want), abs=1e-12)
        assert torch.equal(
            signal, signal_tracer(amplitude, point, tx, tx, waveform, normals=-normal)
        )


@pytest.mark.parametrize("specular", [False, True])
@pytest.mark.parametrize(
    ("dtype", "crowd"), [(torch.float32, 1), (torch.float32, 80), (torch.float64, 80)]
)
def test_points_on_an_antenna(dtype, crowd, specular, simd):
    # Alone the point takes the exact method; in a crowd of coincident points it is a block whose
    # centre, point and transmitter all coincide.
    case, _, waveform = make_case(specular=False, n_antennas=5)
    points = case[2][:1].repeat(crowd, 1)
    normals = torch.tensor([[0.0, 0.0, 1.0]], dtype=dtype).repeat(crowd, 1) if specular else None
    case = [torch.ones(crowd, dtype=dtype), points, *case[2:]]
    got = signal_tracer(*case, waveform, normals=normals)
    twin = [case[0].double(), *case[1:]]
    want = reference.signal_tracer(*twin, waveform, None if normals is None else normals.double())
    assert relative_error(got, want) < 1e-3
    found = gradients(case, normals, waveform, torch.ones((5, 32), dtype=dtype.to_complex()))
    assert all(torch.isfinite(grad).all() for grad in found)
    assert not found[2][0].any()
    assert specular or found[3][0].any()


def test_far_away_and_huge():
    case, normals, waveform = make_case(n_points=50)
    case[1] = case[1] + 9e5
    got = signal_tracer(case[0].float(), *case[1:], waveform, normals=normals.float())
    # 2e6 m of path are 3e9 rad, an ulp of which is 5e-7.
    want = reference.signal_tracer(*case, waveform, normals)
    assert relative_error(got, want) < 1e-3


def test_a_nan_amplitude_reaches_its_antennas_and_a_nan_normal_all():
    case, normals, waveform = make_case("antenna")
    case[0][3, 7] = np.nan
    signal = signal_tracer(*case, waveform, normals=normals)
    assert not torch.isfinite(signal[3].abs()).any()
    assert torch.isfinite(signal.abs()).sum() == signal.numel() - signal.shape[1]
    case, normals, waveform = make_case()
    normals[5, 1] = np.nan
    assert not torch.isfinite(signal_tracer(*case, waveform, normals=normals).abs()).any()


def test_strides_and_conjugate_views_change_nothing():
    case, normals, waveform = make_case("antenna complex")
    want = signal_tracer(*case, waveform, normals=normals)
    strided = torch.empty((200, 37), dtype=torch.complex128).T
    strided.copy_(case[0])
    view = case[0].conj().resolve_conj().conj()
    rows = torch.empty((3, 200), dtype=torch.float64).T
    rows.copy_(normals)
    for amplitude, facing in ((strided, normals), (view, normals), (case[0], rows)):
        got = signal_tracer(amplitude, *case[1:], waveform, normals=facing)
        assert torch.equal(got, want)
    y = torch.from_numpy(white_noise((37, 32)))
    spread = torch.empty((37, 32, 2), dtype=torch.complex128)[..., 0]
    spread.copy_(y)
    for a, b in zip(
        gradients(case, normals, waveform, y),
        gradients(case, normals, waveform, spread),
        strict=True,
    ):
        assert torch.equal(a, b)
