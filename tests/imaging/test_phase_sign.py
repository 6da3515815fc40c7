from dataclasses import replace

import numpy as np
import pytest

from geraf2.imaging.phase_sign import PhaseSign, find_phase_sign
from helpers.planar_scan import letter_pose
from helpers.specular import raster
from helpers.synthetic import WAVEFORM, point_capture, point_pose


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
    assert right.evidence > 5
    assert wrong.evidence == pytest.approx(right.evidence, rel=1e-3)
    assert "conjugated on import" in str(wrong)


def test_noise_silence_and_no_antennas_decide_nothing():
    pose = point_pose(0.0, n_side=12)
    silent = replace(pose, signal=0 * pose.signal)
    noise = noisy(replace(silent, signal=silent.signal + 1), -60.0, np.random.default_rng(1))
    for poses in ([noise], [silent], []):
        sign = find_phase_sign(poses, WAVEFORM)
        assert (sign.n_poses, sign.is_clear) == (len(poses), False)
        assert "not clear" in str(sign)


@pytest.mark.parametrize("n_frequencies", [1, 6])
def test_a_single_plane_is_searched_in_depth(n_frequencies):
    # Its range cell is 0.25 m.
    pose, waveform = letter_pose(np.insert(raster(31, 0.004), 0, 0.0, axis=1), n_frequencies)
    right = find_phase_sign([pose], waveform)
    wrong = find_phase_sign([conjugated(pose)], waveform)
    assert (right.sign, wrong.sign) == (-1, 1)
    assert right.is_clear
    assert wrong.is_clear
    assert right.depth_m == pytest.approx(0.1, abs=0.007)
    assert "times as sharp" in str(right)


def test_irregular_antennas_are_focused_as_finely():
    """Ranges in steps of half a range cell, 75 m here, would miss the L altogether."""
    positions = np.zeros((900, 3))
    positions[:, 1:] = np.random.default_rng(0).uniform(-0.06, 0.06, (900, 2))
    pose, waveform = letter_pose(positions, slope_hz_per_s=1e12)
    right = find_phase_sign([pose], waveform)
    assert (right.sign, right.is_clear, right.depth_m) == (-1, True, None)
    assert find_phase_sign([conjugated(pose)], waveform).sign == 1


@pytest.mark.parametrize(
    ("stated", "forced", "ratio", "is_positive", "doubt"),
    [
        (None, False, 1.2, True, "is not clear"),
        (None, False, 3.0, True, None),
        (-1, False, 1.2, False, None),
        (-1, False, 3.0, False, "--phase-sign +1 takes that one"),
        (-1, False, 9.0, True, "--phase-sign -1 keeps it"),
        (1, False, 3.0, True, None),
        (-1, True, 1.2, False, None),
        (-1, True, 90.0, False, "that --phase-sign does not have"),
        (1, True, 90.0, True, None),
    ],
)
def test_only_a_large_ratio_overrides_the_format(stated, forced, ratio, is_positive, doubt):
    for depth in (None, 0.2):
        sign = PhaseSign(
            sign=1,
            evidence=ratio,
            n_poses=1,
            depth_m=depth,
            stated=stated,
            is_forced=forced,
        )
        assert sign.is_positive == is_positive
        assert len(sign.doubts) == (doubt is not None)
        assert doubt is None or doubt in sign.doubts[0]
        assert ("conjugated" in str(sign)) == is_positive
