from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.calibration.acceptance import Gain, coherence_nats, judge
from geraf2.calibration.autofocus import with_displacements
from geraf2.calibration.channel_phase import (
    interleaved_channels,
    offset_channels,
    with_channel_phases,
)
from geraf2.calibration.corrections import Corrections
from geraf2.calibration.driver import CalibrationConfig, calibrate
from geraf2.calibration.leakage import Leakage
from geraf2.calibration.wall_alignment import WallProblem
from geraf2.errors import UserError
from helpers.carton import PRIOR, carton_capture, with_bias


@pytest.fixture(scope="module")
def capture():
    return carton_capture(n_poses=6)


def turned(capture, n_channels, rms_deg):
    true = np.deg2rad(rms_deg) * np.random.default_rng(3).normal(size=n_channels)
    channels = [interleaved_channels(pose, n_channels) for pose in capture.poses]
    return with_channel_phases(capture, channels, -true), true - true.mean()


def applied(found):
    return [judgement.name for judgement in found.judgements if judgement.applied]


def numbers(found, name):
    return next(j.numbers for j in found.judgements if j.name == name)


def test_a_scan_without_errors_does_not_change(capture):
    found = calibrate(capture, PRIOR)
    assert applied(found) == []
    assert found.capture is capture
    assert found.prior is PRIOR
    assert found.corrections.are_none
    names = [judgement.name for judgement in found.judgements]
    assert names == ["leakage", "channels", "delay", "frame", "positions"]
    assert all(str(j).endswith(f"not applied, {j.against}") for j in found.judgements if j.against)


def test_interleaved_channels_are_found_and_corrected(capture):
    n_channels = 4
    wrong, true = turned(capture, n_channels, 25.0)
    found = calibrate(wrong, PRIOR)
    assert applied(found) == ["channels"]
    assert found.corrections.n_turns == n_channels
    left = found.corrections.channel_phases_rad - true
    assert np.rad2deg(np.abs(np.angle(np.exp(1j * left)))).max() < 3.0
    stated = numbers(found, "channels")
    assert stated["coherence"] > stated["coherence_before"]


def test_channels_are_distinguished_by_their_offsets(capture):
    assert offset_channels(capture.poses) is None
    spread = []
    for pose in capture.poses:
        offset = 0.0019 * interleaved_channels(pose, 4)[:, None] * pose.axes[1]
        spread.append(replace(pose, rx_positions=pose.rx_positions + offset))
    index = offset_channels(tuple(spread))
    assert index is not None
    for pose, own in zip(spread, index, strict=True):
        assert len(np.unique(own)) == 4
        assert np.array_equal(own[::4], np.full(len(own[::4]), own[0]))
        assert len(own) == pose.n_antennas


@pytest.mark.parametrize("error_m", [0.008, 0.04])
def test_a_wrong_delay_is_corrected_within_its_interval(capture, error_m):
    found = calibrate(with_bias(capture, 0.15 - error_m), PRIOR)
    assert applied(found) == ["delay"]
    stated = numbers(found, "delay")
    assert abs(stated["delay_m"] - error_m) < 2.0 * stated["sigma_m"] < 0.003
    assert found.capture.waveform.path_bias_m == 0.15 - error_m + stated["delay_m"]


def test_a_rotated_prior_moves_and_the_capture_does_not(capture):
    turn = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(3.0)])
    found = calibrate(capture, replace(PRIOR, vertices=turn.apply(PRIOR.vertices)))
    assert applied(found) == ["frame"]
    assert np.abs(found.prior.vertices - PRIOR.vertices).max() < 0.002
    assert found.capture is capture


def cut(pose, antennas, n_samples=32):
    return replace(pose, signal=pose.signal[:, :n_samples]).select(antennas)


@pytest.mark.parametrize("kind", ["empty pose", "few antennas", "one sample", "silent", "noise"])
def test_data_without_information_change_nothing(capture, kind):
    poses, waveform = capture.poses[:2], capture.waveform
    if kind == "empty pose":
        poses = (cut(poses[0], slice(0)), poses[1])
    elif kind == "few antennas":
        poses = tuple(cut(pose, slice(9)) for pose in poses)
    elif kind == "one sample":
        poses = tuple(cut(pose, slice(None), 1) for pose in poses)
        waveform = replace(waveform, n_samples=1)
    else:
        rng, level = np.random.default_rng(0), float(kind == "noise")
        poses = tuple(
            replace(p, signal=(level * rng.normal(size=p.signal.shape)).astype(np.complex64))
            for p in poses
        )
    given = replace(capture, poses=poses, waveform=waveform)
    assert calibrate(given, PRIOR).capture is given


def test_a_drift_of_a_fifth_of_a_millimetre_is_found(capture):
    slow = np.cos(np.pi * np.outer(np.arange(1, 6), np.linspace(0.0, 1.0, 12)))
    drift = np.random.default_rng(4).normal(size=(len(capture.poses), 5)) @ slow
    drift *= 2e-4 / np.sqrt((drift**2).mean())
    found = calibrate(with_displacements(capture, -drift), PRIOR)
    assert applied(found) == ["positions"]
    assert found.corrections.drift_coefficients_m is not None
    assert np.corrcoef(found.corrections.drift_coefficients_m.ravel(), drift.ravel())[0, 1] > 0.5


def test_corrections_come_back_from_a_file(capture, tmp_path):
    rng = np.random.default_rng(0)
    sizes = [pose.n_antennas for pose in capture.poses]
    basis, operator = (rng.normal(size=(32, 2)).astype(np.complex64) for _ in range(2))
    some = Corrections(
        leakage=Leakage(basis=basis, operator=operator),
        n_turns=4,
        channel_phases_rad=rng.normal(size=4),
        delay_m=0.002,
        drift_coefficients_m=rng.normal(size=(len(sizes), 12)) * 1e-4,
        prior_to_capture=np.eye(4),
    )
    for corrections in (some, replace(some, leakage=None, n_turns=0, channel_phases_rad=None)):
        corrections.save(tmp_path / "calibration.npz")
        kept = Corrections.load(tmp_path / "calibration.npz").applied(capture)
        once = corrections.applied(capture)
        assert kept.waveform == once.waveform
        for one, other in zip(kept.poses, once.poses, strict=True):
            assert np.array_equal(one.signal, other.signal)
            assert np.array_equal(one.tx_positions, other.tx_positions)
            assert np.array_equal(one.axes, other.axes)
    assert not some.are_none
    (tmp_path / "other.npz").write_bytes(b"no arrays")
    with pytest.raises(UserError, match="cannot read the arrays"):
        Corrections.load(tmp_path / "other.npz")


def test_without_recorded_delay_channels_use_that_of_the_walls(capture):
    wrong, true = turned(capture, 4, 25.0)
    found = calibrate(with_bias(wrong, 0.0), PRIOR)
    assert {"channels", "delay"} <= set(applied(found))
    left = found.corrections.channel_phases_rad - true
    assert np.rad2deg(np.abs(np.angle(np.exp(1j * left)))).max() < 3.0
    assert found.capture.waveform.path_bias_m == pytest.approx(0.15, abs=1e-3)


def test_only_requested_corrections_are_estimated(capture):
    wrong = with_bias(turned(capture, 4, 25.0)[0], 0.142)
    settings = {"leakage": False, "frame": False, "channels": False, "positions": False}
    found = calibrate(wrong, PRIOR, CalibrationConfig(**settings))
    assert [one.name for one in found.judgements] == applied(found) == ["delay"]
    kept = calibrate(wrong, PRIOR, CalibrationConfig(**settings, delay=False))
    assert kept.judgements == ()
    assert kept.capture is wrong


def test_unseen_walls_are_an_error_if_requested(capture):
    small = PRIOR.move(np.diag([0.1, 0.1, 0.1, 1.0]))
    found = calibrate(
        capture, small, CalibrationConfig(leakage=False, channels=False, positions=False)
    )
    assert found.capture is capture
    (one,) = found.judgements
    assert (one.name, one.applied, one.against) == ("delay", False, "no data")
    assert "walls of the box do not stand out" in str(one.error)


def test_walls_without_a_usable_echo_give_no_estimate(capture, monkeypatch):
    chosen = WallProblem.walls_of

    def none_left(problem, values, share, use=None):
        walls = chosen(problem, values, share, use)
        return walls.select(np.zeros(len(walls.index), dtype=bool))

    monkeypatch.setattr(WallProblem, "walls_of", none_left)
    (one,) = calibrate(
        capture, PRIOR, CalibrationConfig(leakage=False, channels=False, positions=False)
    ).judgements
    assert (one.name, one.applied, one.against) == ("delay", False, "no data")
    assert "walls of the box do not stand out" in str(one.error)


@pytest.mark.parametrize(
    ("nats", "is_modelled", "applied"),
    [
        ([5.0], True, True),  # a Gaussian value 3.2 standard deviations off
        ([4.4], True, False),  # 2.97
        ([10.0, -8.0] * 30, False, False),  # 60 of 70: what some gain others lose
        ([2.0, 1.0] * 30, False, True),
        ([-1.0] * 30, False, False),
        ([], False, False),
    ],
)
def test_a_correction_is_accepted_if_held_out_data_gain_three_standard_errors(
    nats, is_modelled, applied
):
    gain = Gain.of(np.array(nats), is_modelled=is_modelled)
    found = judge("delay", "1 mm", {"delay_m": 0.001}, gain)
    assert found.applied is applied
    assert found.against == ("" if applied else "held-out echoes fit no better")
    assert found.numbers["gain"] == pytest.approx(sum(nats))


def test_coherence_is_the_likelihood_of_constant_phasors_in_one_noise():
    """Twin: log-likelihood of four Gaussian terms an echo about its mean, of pooled power."""
    rng = np.random.default_rng(1)
    sizes = np.array([1.0, 3.0, 0.5])
    noise = np.exp(1j * rng.normal(size=(3, 400)) * np.array([[0.30], [0.31], [0.6]]))
    less = np.exp(0.99j * np.angle(noise))
    before, after = (np.abs(z.mean(axis=1)) for z in (noise, less))
    left = [
        sizes**2 * np.mean(np.abs(z - z.mean(axis=1, keepdims=True)) ** 2, axis=1)
        for z in (noise, less)
    ]
    twin = 4.0 * len(sizes) * np.log(left[0].sum() / left[1].sum())
    assert coherence_nats(before, after, sizes**2).sum() == pytest.approx(twin, rel=1e-3)
