from dataclasses import replace

import numpy as np
import pytest

from geraf2.calibration.leakage import (
    clipped_share,
    find_leakage,
    leakage_operator,
    without_leakage,
)
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.echoes.prior_check import locate_echoes
from geraf2.errors import UserError
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import LosPrior
from helpers.carton import PRIOR, carton_capture
from helpers.synthetic import WAVEFORM

FREQUENCIES_HZ = WAVEFORM.frequencies_hz
PATHS_M = np.array([0.0, 0.03, 0.06])  # the direct one, and objects before the antennas
AMPLITUDES = np.array([1.0, 0.3j, -0.2])


def sinusoid(path_m):
    delay = (np.asarray(path_m) + WAVEFORM.path_bias_m) / SPEED_OF_LIGHT_M_PER_S
    return np.exp(-2j * np.pi * np.multiply.outer(FREQUENCIES_HZ, delay))


def rms(capture):
    return np.sqrt(np.mean([np.mean(np.abs(pose.signal) ** 2) for pose in capture.poses]))


def spoilt(capture, level_db, *, own_phases=None, ripple=1.0):
    """Add leakage, which own phases of the antennas turn."""
    waveform = sinusoid(PATHS_M) @ AMPLITUDES
    waveform *= 10.0 ** (level_db / 20.0) * rms(capture) / np.sqrt(np.mean(np.abs(waveform) ** 2))
    poses = []
    for number, pose in enumerate(capture.poses):
        own = np.zeros(pose.n_antennas) if own_phases is None else own_phases[number]
        signal = (pose.signal + np.exp(1j * own)[:, None] * waveform) * ripple
        poses.append(replace(pose, signal=signal.astype(np.complex64)))
    return replace(capture, poses=tuple(poses))


def left_over_db(capture, clean):
    """Energy of the difference over that of the clean capture."""
    pairs = zip(capture.poses, clean.poses, strict=True)
    power = np.mean([np.mean(np.abs(a.signal - b.signal) ** 2) for a, b in pairs])
    return 10.0 * np.log10(power / rms(clean) ** 2)


@pytest.fixture(scope="module")
def clean():
    return carton_capture(n_poses=8)


def test_a_scan_without_leakage_does_not_change_a_bit(clean):
    found = find_leakage(clean, PRIOR)
    assert "no signal in front" in str(found)
    assert without_leakage(clean, found) is clean


def test_leakage_is_subtracted_from_these_and_further_planes(clean):
    capture = spoilt(clean, 25.0)
    first = replace(capture, poses=capture.poses[:6])
    for found in (find_leakage(capture, PRIOR), find_leakage(first, PRIOR)):
        assert found.level_db == pytest.approx(25.0, abs=0.3)
        assert found.steadiness > 0.99
        assert "dB over the echoes, at " in str(found)
        assert left_over_db(without_leakage(capture, found), clean) < -30.0


def test_leakage_with_a_phase_of_its_own_is_subtracted(clean):
    rng = np.random.default_rng(4)
    own = [0.5 * rng.normal(size=pose.n_antennas) for pose in clean.poses]
    capture = spoilt(clean, 20.0, own_phases=own)
    found = find_leakage(capture, PRIOR)
    assert left_over_db(without_leakage(capture, found), clean) < -30.0


def test_ripple_of_the_chirp_is_subtracted_with_the_leakage(clean):
    n = WAVEFORM.n_samples
    # Four waves along the chirp: paired echoes of the leakage, 33 cm of path behind it.
    ripple = np.exp(0.12j * np.sin(2.0 * np.pi * 4.0 * np.arange(n) / n))
    capture = spoilt(clean, 25.0, ripple=ripple)
    found = find_leakage(capture, PRIOR)
    rippled = spoilt(clean, -300.0, ripple=ripple)
    assert found.tail_db == pytest.approx(20.0 * np.log10(0.06) + 3.0, abs=1.0)
    mended = without_leakage(capture, found)
    assert left_over_db(mended, rippled) < -20.0
    assert locate_echoes(capture, PRIOR, KeptPeaks(PRIOR).of(capture)).in_front > 0.1
    assert locate_echoes(mended, PRIOR, KeptPeaks(PRIOR).of(mended)).in_front < 0.01


def test_walls_parallel_to_all_planes_are_not_subtracted():
    face_on = carton_capture(n_poses=4)
    found = find_leakage(spoilt(face_on, 25.0), PRIOR)
    assert found.tail_db == -np.inf
    assert left_over_db(without_leakage(spoilt(face_on, 25.0), found), face_on) < -30.0


def test_echoes_of_the_box_are_not_leakage(clean):
    # As recorded 45 cm of path too long, the delay puts the nearest wall where leakage would be.
    waveform = replace(clean.waveform, path_bias_m=clean.waveform.path_bias_m + 0.55)
    assert find_leakage(replace(clean, waveform=waveform), PRIOR).basis is None


@pytest.mark.parametrize("recorded_m", [0.0, 0.22])
def test_leakage_is_found_with_a_wrong_delay(clean, recorded_m):
    capture = spoilt(clean, 25.0)
    waveform = replace(capture.waveform, path_bias_m=recorded_m)
    found = find_leakage(replace(capture, waveform=waveform), PRIOR)
    assert left_over_db(without_leakage(capture, found), clean) < -25.0


def test_a_box_too_near_the_antennas_leaves_leakage():
    capture = carton_capture(n_poses=2)
    near = LosPrior.from_box((0.72, 0.72, 0.3))
    assert "too coarse" in find_leakage(spoilt(capture, 25.0), near).reason


def test_the_fit_is_weighted_least_squares_and_blind_to_the_box():
    near, box = (-0.02, 0.085), (0.5, 1.2)
    basis, taken = leakage_operator(WAVEFORM, near, box)
    rng = np.random.default_rng(0)
    samples = rng.normal(size=32) + 1j * rng.normal(size=32)
    # The twin: echoes' covariance summed up, its inverse's root, and plain least squares.
    many = sinusoid(np.linspace(*box, 4001))
    weight = np.linalg.inv(np.eye(32) + 1000.0 * (many @ many.conj().T) / 4001)
    root = np.linalg.cholesky(weight).conj().T
    twin = np.linalg.lstsq(root @ basis, root @ samples, rcond=None)[0]
    assert samples @ taken == pytest.approx(twin, rel=1e-3, abs=1e-3)
    assert basis.conj().T @ basis == pytest.approx(np.eye(basis.shape[1]), abs=1e-5)
    echoes, leakage = sinusoid(np.linspace(*box, 50)), sinusoid(np.linspace(*near, 20))
    assert (np.abs(echoes.T @ taken) ** 2).sum(axis=1).max() / 32 < 0.002
    left = leakage.T - leakage.T @ taken @ basis.T
    assert (np.abs(left) ** 2).sum(axis=1).max() / 32 < 3e-6


def test_leakage_that_saturates_the_converter_is_an_error(clean):
    """Twelve bits, clipped at a share of the largest value."""

    def clipped(share):
        top = share * max(np.abs(p.signal.view("f4")).max() for p in leaky.poses)
        cut = (np.clip(p.signal.view("f4"), -top, top).view("c8") for p in leaky.poses)
        poses = [replace(p, signal=s) for p, s in zip(leaky.poses, cut, strict=True)]
        true = np.mean([np.abs(p.signal.real) > top for p in leaky.poses])
        return replace(leaky, poses=tuple(poses)), true

    leaky = spoilt(clean, 25.0)
    assert clipped_share(leaky) < 1e-3
    capture, true = clipped(0.7)
    assert clipped_share(capture) == pytest.approx(true, rel=0.3)
    assert find_leakage(capture, PRIOR).basis is not None
    with pytest.raises(UserError, match="saturates the converter"):
        find_leakage(clipped(0.3)[0], PRIOR)
