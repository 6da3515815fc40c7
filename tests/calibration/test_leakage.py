from dataclasses import replace

import numpy as np
import pytest

from geraf2.calibration.channel_phase import with_phases
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
WAVELENGTH_M = WAVEFORM.center_wavelength_m
PATHS_M = np.array([0.0, 0.03, 0.06])  # the direct one, and objects before the antennas
AMPLITUDES = np.array([1.0, 0.3j, -0.2])


def sinusoid(path_m):
    delay = (np.asarray(path_m) + WAVEFORM.path_bias_m) / SPEED_OF_LIGHT_M_PER_S
    return np.exp(-2j * np.pi * np.multiply.outer(FREQUENCIES_HZ, delay))


def put_back(capture, leakage):
    """Undo `without_leakage`, to rounding."""
    turned = with_phases(capture, leakage.phases_rad) if leakage.phases_rad else capture
    pairs = zip(turned.poses, leakage.coefficients, strict=True)
    poses = (replace(p, signal=p.signal + c @ leakage.basis.T) for p, c in pairs)
    return replace(turned, poses=tuple(poses))


def rms(capture):
    return np.sqrt(np.mean([np.mean(np.abs(pose.signal) ** 2) for pose in capture.poses]))


def spoilt(capture, level_db, *, phases=None, own_phases=None, ripple=1.0):
    """Add leakage; phases of antennas turn all of the signal, own ones only the leakage."""
    waveform = sinusoid(PATHS_M) @ AMPLITUDES
    waveform *= 10.0 ** (level_db / 20.0) * rms(capture) / np.sqrt(np.mean(np.abs(waveform) ** 2))
    poses = []
    for number, pose in enumerate(capture.poses):
        own = np.zeros(pose.n_antennas) if own_phases is None else own_phases[number]
        turn = np.zeros(pose.n_antennas) if phases is None else phases[number]
        signal = (pose.signal + np.exp(1j * own)[:, None] * waveform) * ripple
        poses.append(
            replace(pose, signal=(signal * np.exp(1j * turn)[:, None]).astype(np.complex64))
        )
    return replace(capture, poses=tuple(poses))


def with_background(capture, path_m, level_db):
    """Add what all antennas share: an echo of one path, or a constant of the converter (None)."""
    waveform = np.ones(WAVEFORM.n_samples, complex) if path_m is None else sinusoid(path_m)
    waveform *= 10.0 ** (level_db / 20.0) * rms(capture) / np.sqrt(np.mean(np.abs(waveform) ** 2))
    poses = (replace(p, signal=(p.signal + waveform).astype(np.complex64)) for p in capture.poses)
    return replace(capture, poses=tuple(poses))


def of_first(capture, n_poses):
    return find_leakage(replace(capture, poses=capture.poses[:n_poses]), PRIOR)


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
    assert found.method == "none"
    assert without_leakage(clean, found) is clean


def test_leakage_is_subtracted_and_can_be_added_again(clean):
    capture = spoilt(clean, 25.0)
    found = find_leakage(capture, PRIOR)
    assert found.method == "projected"
    assert found.level_db == pytest.approx(25.0, abs=0.2)
    assert found.steadiness > 0.99
    assert "25.0 dB over the echoes" in str(found)
    mended = without_leakage(capture, found)
    assert left_over_db(mended, clean) < -30.0
    # Samples of 18 times the echoes' size are added and subtracted in single precision.
    assert left_over_db(put_back(mended, found), capture) < -120.0
    more = of_first(capture, 6).of_more(capture.poses, WAVELENGTH_M)
    assert len(more.coefficients) == 8
    assert left_over_db(without_leakage(capture, more), clean) < -30.0


def _channels_and_drift(capture):
    rng = np.random.default_rng(3)
    channel = np.deg2rad([-30.0, 45.0, -20.0, 5.0])
    phases = []
    for pose in capture.poses:
        steps = np.deg2rad(40.0) / np.sqrt(pose.n_antennas) * rng.normal(size=pose.n_antennas)
        turn = channel[np.arange(pose.n_antennas) % 4] + 6.0 * rng.random()
        phases.append(np.cumsum(steps) + turn)
    return phases


def test_the_phase_of_leakage_corrects_channels_and_oscillator_drift(clean):
    phases = _channels_and_drift(clean)
    capture = spoilt(clean, 10.0, phases=phases)
    found = find_leakage(capture, PRIOR)
    assert found.method == "reference"
    assert "held-out log-likelihood +" in found.reason
    # Also from some planes for further ones.
    for one in (found, of_first(capture, 6).of_more(capture.poses, WAVELENGTH_M)):
        error = np.concatenate(one.phases_rad) - np.concatenate(phases)
        error = np.angle(np.exp(1j * error) / np.exp(1j * error).mean())
        # Noise, 33 dB below the leakage in the fit, and the echoes' share: a degree.
        assert np.rad2deg(error.std()) < 1.0
    mended = without_leakage(capture, found)
    assert left_over_db(put_back(mended, found), capture) < -110.0


def test_a_phase_of_the_leakage_alone_is_not_used(clean):
    rng = np.random.default_rng(4)
    own = [0.5 * rng.normal(size=pose.n_antennas) for pose in clean.poses]
    capture = spoilt(clean, 20.0, own_phases=own)
    found = find_leakage(capture, PRIOR)
    assert found.method == "projected"
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


@pytest.mark.parametrize(
    ("path_m", "level_db"),
    [(0.4, 6.0), (0.9, 6.0), (None, 3.5)],  # before the box, where leakage is seen; behind it
)
def test_a_background_that_all_antennas_share_is_subtracted(clean, path_m, level_db):
    capture = with_background(clean, path_m, level_db)
    found = find_leakage(capture, PRIOR)
    assert found.method == "projected"
    assert found.level_db == pytest.approx(level_db, abs=0.3)
    mended = without_leakage(capture, found)
    assert left_over_db(mended, clean) < -20.0
    assert left_over_db(put_back(mended, found), capture) < -120.0


def test_a_background_is_subtracted_from_further_planes(clean):
    first = [1, 3, 5, 7, 0, 2, 4, 6]  # planes that face no wall show what all antennas share
    clean = replace(clean, poses=tuple(clean.poses[number] for number in first))
    capture = with_background(clean, 0.9, 6.0)
    found = of_first(capture, 6)
    assert (found.operator, found.method) == (None, "projected")
    mended = without_leakage(capture, found.of_more(capture.poses, WAVELENGTH_M))
    assert left_over_db(mended, clean) < -20.0


def test_walls_parallel_to_all_planes_are_not_subtracted():
    face_on = carton_capture(n_poses=4)
    found = find_leakage(spoilt(face_on, 25.0), PRIOR)
    assert found.tail_db == -np.inf
    assert left_over_db(without_leakage(spoilt(face_on, 25.0), found), face_on) < -30.0


def test_echoes_of_the_box_are_not_leakage(clean):
    # As recorded 45 cm of path too long, the delay puts the nearest wall where leakage would be.
    waveform = replace(clean.waveform, path_bias_m=clean.waveform.path_bias_m + 0.55)
    assert find_leakage(replace(clean, waveform=waveform), PRIOR).method == "none"


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
    assert find_leakage(capture, PRIOR).method == "projected"
    with pytest.raises(UserError, match="saturates the converter"):
        find_leakage(clipped(0.3)[0], PRIOR)


def test_leakage_that_needs_an_estimate_has_no_further_planes(clean):
    capture = spoilt(clean, 25.0)
    found = of_first(capture, 6)
    assert replace(found, operator=None).of_more(capture.poses, WAVELENGTH_M) is None  # as stored
    nothing = find_leakage(clean, PRIOR)
    assert nothing.of_more(clean.poses, WAVELENGTH_M) is nothing
