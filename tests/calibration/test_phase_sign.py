from dataclasses import replace

import numpy as np
import pytest

from geraf2.calibration import phase_sign
from geraf2.calibration.phase_sign import find_phase_sign
from synthetic import WAVEFORM, point_capture, point_pose


def noisy(pose, snr_db, rng):
    power = float((np.abs(pose.signal) ** 2).mean()) * 10 ** (-snr_db / 10)
    noise = rng.normal(size=pose.signal.shape) + 1j * rng.normal(size=pose.signal.shape)
    return replace(pose, signal=(pose.signal + np.sqrt(power / 2) * noise).astype(np.complex64))


def conjugated(pose):
    return replace(pose, signal=np.conj(pose.signal))


@pytest.mark.parametrize("snr_db", [40.0, 0.0])
def test_both_signs_are_found_with_the_same_evidence(snr_db):
    rng = np.random.default_rng(0)
    poses = [noisy(pose, snr_db, rng) for pose in point_capture(4, n_side=12).poses]
    right = find_phase_sign(poses, WAVEFORM)
    wrong = find_phase_sign([conjugated(pose) for pose in poses], WAVEFORM)
    assert (right.sign, wrong.sign) == (-1, 1)
    assert right.is_clear
    assert right.peak_ratio > 5
    assert wrong.peak_ratio == pytest.approx(right.peak_ratio, rel=1e-3)
    assert wrong.sharpness_ratio == pytest.approx(right.sharpness_ratio, rel=1e-3)
    assert "conjugated on import" in str(wrong)


def test_noise_alone_decides_nothing():
    rng = np.random.default_rng(1)
    pose = point_pose(0.0, n_side=12)
    noise = noisy(replace(pose, signal=0 * pose.signal + 1), -60.0, rng)
    sign = find_phase_sign([noise], WAVEFORM)
    assert not sign.is_clear
    assert "not clear" in str(sign)


def test_nothing_to_look_at_decides_nothing():
    sign = find_phase_sign([], WAVEFORM)
    assert (sign.sign, sign.n_poses, sign.is_clear) == (-1, 0, False)


def test_silence_decides_nothing():
    pose = point_pose(0.0)
    assert not find_phase_sign([replace(pose, signal=0 * pose.signal)], WAVEFORM).is_clear


def test_a_doubt_is_looked_at_with_all_antennas(monkeypatch):
    """At -25 dB the quick look at 128 antennas leaves a doubt, 40 dB decides at once."""
    looks = []
    original = phase_sign.matched_filter

    def counting(signal, *args, **kwargs):
        looks.append(len(signal))
        return original(signal, *args, **kwargs)

    monkeypatch.setattr(phase_sign, "matched_filter", counting)
    pose = point_pose(0.0, n_side=24)
    rng = np.random.default_rng(0)
    assert find_phase_sign([noisy(pose, 40.0, rng)], WAVEFORM).sign == -1
    assert looks == [128, 128]
    looks.clear()
    find_phase_sign([noisy(pose, -25.0, rng)], WAVEFORM)
    assert looks == [128, 128, 512, 512]
