"""Receivers against what their effects are defined by; a handful of antennas each."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.simulation import DisturbanceSpec, FigureSpec, ScanSpec, SceneSpec, WorldSpec, simulate
from geraf2.simulation.electronics import convert, receiver_gains
from geraf2.simulation.spec import AWR1843

C = 299792458.0
FREE = SceneSpec(
    figure=FigureSpec(name="hammer", height_m=0.05),
    scan=ScanSpec(n_poses=2, arc_deg=90, aperture_m=(0.012, 0.012), spacing_m=0.006),
    disturbance=DisturbanceSpec(snr_db=np.inf),
)


def signals(world=None, seed=0, snr_db=np.inf):
    spec = replace(
        FREE, world=world or WorldSpec(), disturbance=replace(FREE.disturbance, snr_db=snr_db)
    )
    return np.stack([pose.signal for pose in simulate(spec, seed=seed)[0].poses])


def noise(*shape, seed=0):
    parts = np.random.default_rng(seed).normal(size=(2, *shape))
    return (parts[0] + 1j * parts[1]).astype(np.complex64)


def test_leakage_is_the_same_everywhere_short_and_as_strong_as_asked():
    leaked = signals(WorldSpec(leakage_db=10.0)) - signals()
    assert np.ptp(leaked, axis=(0, 1)) == pytest.approx(0.0, abs=1e-5)
    assert np.mean(np.abs(leaked) ** 2) == pytest.approx(10.0, rel=1e-4)
    # All of it is made of delays that end 8 cm after the direct path; a chance vector is not.
    extra = np.linspace(0.0, 0.08, 25) + 0.005 + AWR1843.path_bias_m
    waves = np.exp(-2j * np.pi * np.outer(AWR1843.frequencies_hz, extra) / C)
    rows = np.linalg.svd(waves)[0][:, :7]  # three dimensions a range cell, some to spare
    for vector, rest in ((leaked[0, 0], 0.01), (noise(32), 1.0)):
        left = vector - rows @ (rows.conj().T @ vector)
        assert 0.5 * rest < np.linalg.norm(left) / np.linalg.norm(vector) + 0.5 * rest < 1.5 * rest


def test_channels_gains_are_of_the_asked_size_and_the_same_in_all_planes():
    world = WorldSpec(channel_gain_rms_db=0.5, n_channels=4)
    db = [
        20.0 * np.log10(np.abs(receiver_gains(world, (8, 32), seed, 1)))[:, 0]
        for seed in range(300)
    ]
    assert np.std(db) == pytest.approx(0.5, rel=0.1)
    assert db[0][:4] == pytest.approx(db[0][4:])
    assert np.array_equal(
        receiver_gains(world, (8, 32), 0, 0), receiver_gains(world, (8, 32), 0, 5)
    )
    both = signals(WorldSpec(channel_gain_rms_db=0.5, channel_phase_rms_deg=10.0)) / signals()
    assert both[:, 0] == pytest.approx(both[:, 4], rel=1e-4)
    assert np.ptp(np.angle(both[0, :4, 0])) > 0.05


def test_a_walk_ends_as_far_off_as_asked_and_its_steps_are_independent():
    world = WorldSpec(phase_walk_deg=20.0)
    walks = [np.angle(receiver_gains(world, (50, 1), 0, n)[:, 0]) for n in range(600)]
    ends = np.rad2deg([walk[-1] - walk[0] for walk in walks])
    assert np.sqrt(np.mean(np.square(ends))) == pytest.approx(20.0, rel=0.1)
    steps = np.diff(walks, axis=1)
    assert np.mean(steps[:, 1:] * steps[:, :-1]) == pytest.approx(0.0, abs=0.02 * np.var(steps))


def test_each_plane_has_a_phase_of_its_own_uniform_on_the_circle():
    ratio = signals(WorldSpec(random_plane_phase=True)) / signals()
    assert ratio[0] == pytest.approx(np.full_like(ratio[0], ratio[0, 0, 0]), abs=1e-3)
    assert np.abs(np.angle(ratio[0, 0, 0] / ratio[1, 0, 0])) > 0.1
    world = WorldSpec(random_plane_phase=True)
    many = np.array([receiver_gains(world, (1, 1), 0, number)[0, 0] for number in range(400)])
    assert np.abs(many) == pytest.approx(1.0)
    assert np.abs([np.mean(many), np.mean(many**2)]).max() < 0.12  # 400 phases: 0.05 rms each


def test_a_ripple_is_slow_over_the_chirp_of_the_asked_size_and_the_same_for_all():
    gain = receiver_gains(WorldSpec(ripple_rms=0.12), (5, 32), 0, 3)
    assert gain.shape == (1, 32)
    assert np.sqrt(np.mean(np.abs(gain - 1.0) ** 2)) == pytest.approx(0.12)
    periods = np.abs(np.fft.fft(gain[0]) / 32)
    assert periods[0] == pytest.approx(1.0)
    assert periods[5:-4].max() < 1e-12


def test_an_unbalanced_receiver_mirrors_a_tone_as_the_formula_has_it():
    # s = exp(j a) gives exp(j a) (1 + g e^jp) / 2 + exp(-j a) (1 - g e^-jp) / 2, g = 1.06.
    tone = np.exp(2j * np.pi * 5 * np.arange(64) / 64).astype(np.complex64)[None]
    world = WorldSpec(iq_gain_error=0.06, iq_phase_error_deg=5.0)
    lines = np.fft.fft(convert(world, [tone], 0)[0][0]) / 64
    turn = 1.06 * np.exp(1j * np.deg2rad(5.0))
    assert lines[5] == pytest.approx((1 + turn) / 2, abs=1e-6)
    assert lines[-5] == pytest.approx((1 - np.conj(turn)) / 2, abs=1e-6)
    assert np.delete(np.abs(lines), [5, 59]).max() < 1e-6


def test_an_offset_is_constant_and_as_strong_as_asked():
    offset = signals(WorldSpec(dc_db=-10.0)) - signals()
    assert np.ptp(offset) == pytest.approx(0.0, abs=1e-6)
    assert np.abs(offset) ** 2 == pytest.approx(0.1, rel=1e-3)


def test_codes_of_a_converter_are_integers_and_their_error_is_uniform():
    plain = [noise(40, 32, seed=n) for n in range(2)]
    peak = max(max(np.abs(s.real).max(), np.abs(s.imag).max()) for s in plain)
    got = convert(WorldSpec(converter_bits=10), plain, 0)
    step = peak / 511
    for before, after in zip(plain, got, strict=True):
        assert after.dtype == np.complex64
        codes = after.real / step
        assert codes == pytest.approx(np.round(codes), abs=1e-3)
        error = np.concatenate([(after - before).real, (after - before).imag])
        assert np.abs(error).max() <= 0.5001 * step
        assert np.std(error) == pytest.approx(step / np.sqrt(12), rel=0.03)


def test_what_lies_above_full_scale_is_cut_off():
    plain = noise(40, 32)
    got = convert(WorldSpec(converter_bits=16, clip_db=6.0), [plain], 0)[0]
    limit = float(max(np.abs(plain.real).max(), np.abs(plain.imag).max())) * 10 ** (-0.3)
    expected = np.clip(plain.real, -limit, limit) + 1j * np.clip(plain.imag, -limit, limit)
    assert got == pytest.approx(expected, abs=limit / 30000)
    assert (np.abs(plain.real) > limit).any()


def test_an_effect_changes_no_draw_of_another():
    drawn = signals(snr_db=10.0) - signals()
    loud = WorldSpec(leakage_db=3.0, edge_energy_fraction=0.1)
    assert signals(loud, snr_db=10.0) - signals(loud) == pytest.approx(drawn, abs=1e-5)
    effects = ("channels", "walk", "plane_phase", "ripple")
    product = 1.0
    for effect in effects:
        world = WorldSpec(preset="hard", effects=(effect,))
        product = product * receiver_gains(world, (8, 32), 7, 2)
    together = receiver_gains(WorldSpec(preset="hard", effects=effects), (8, 32), 7, 2)
    assert together == pytest.approx(product)
