import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from helpers.planar_scan import (
    FREQUENCIES,
    HOLOGRAM_FREQUENCIES,
    LETTER,
    STEP,
    TARGETS,
    write_hologram,
    write_planar,
)


def opened(source, options=None, **radar):
    return load_importer("planar").open(source, RadarManifest(**radar), options or ImportOptions())


def test_positions_frequencies_and_samples_are_those_of_the_scan(tmp_path):
    scan = opened(write_planar(tmp_path / "scan"))
    waveform = scan.manifest.waveform
    step_hz = waveform.chirp_slope_hz_per_s / waveform.sample_rate_hz
    assert np.allclose(waveform.start_frequency_hz + step_hz * np.arange(11), FREQUENCIES)
    (pose,) = scan.poses()
    assert scan.n_antennas == (31 * 25,)
    assert np.array_equal(pose.tx_positions, pose.rx_positions)
    assert np.allclose(pose.tx_positions[25] - pose.tx_positions[0], [0, STEP, 0])
    assert np.allclose(pose.tx_positions[1] - pose.tx_positions[0], [0, 0, STEP])
    assert np.allclose(pose.tx_positions.mean(axis=0), 0, atol=1e-12)
    # The echoes as they were written, on top of their mean over the plane.
    points = np.column_stack([TARGETS[:, 2], TARGETS[:, 0], TARGETS[:, 1]])
    distance = 2 * np.linalg.norm(pose.tx_positions[:, None] - points, axis=2)
    k = 2 * np.pi * FREQUENCIES / 299792458.0
    expected = 2000 * np.exp(-1j * distance[:, :, None] * k).sum(axis=1)
    expected -= expected.mean(axis=0)
    assert np.abs(pose.signal - expected).max() < 1.0  # rounded to whole counts
    assert scan.phase_sign == -1


def test_nan_samples_are_refused(tmp_path):
    data = np.random.default_rng(0).normal(size=(2, 11, 5, 4))
    data[0, 3, 2, 1] = np.nan
    scan = opened(write_planar(tmp_path / "scan", data=data))
    with pytest.raises(UserError, match="1 samples are NaN"):
        list(scan.poses())


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ([[22.2e9, 25e9], [0, 1]], "does not cover the frequencies"),
        ([[26.2e9, 22.2e9], [0, 1]], "does not cover the frequencies"),
        ([[22.2e9, 24e9, 26.2e9], [0, np.nan, 1]], "1 of 3 columns hold NaN"),
    ],
)
def test_a_phase_that_does_not_fit_is_named(tmp_path, table, text):
    folder = write_planar(tmp_path / "scan")
    path = folder / "antenna_phase.txt"
    np.savetxt(path, table)
    with pytest.raises(UserError, match=text):
        opened(folder)
    if "NaN" in text:
        assert "left out" in opened(folder, ImportOptions(keep_good=True)).notes[0]


def letter_signal(depth, frequencies, positions):
    """Echoes exp(-j k d) of the letter, less their mean over the plane."""
    points = np.column_stack([np.full(len(LETTER), depth), LETTER])
    distance = 2 * np.linalg.norm(positions[:, None] - points, axis=2)
    k = 2 * np.pi * np.asarray(frequencies) / 299792458.0
    signal = 1e-3 * np.exp(-1j * distance[:, :, None] * k).sum(axis=1)
    return signal - signal.mean(axis=0)


def test_complex_samples_are_kept_in_their_own_sign(tmp_path):
    scan = opened(write_hologram(tmp_path / "letter.npy"))
    (pose,) = scan.poses()
    assert scan.phase_sign == 1
    assert scan.n_antennas == (31 * 31,)
    expected = letter_signal(0.1, HOLOGRAM_FREQUENCIES, pose.tx_positions)
    assert np.abs(pose.signal.conj() - expected).max() < 1e-6
    (other,) = opened(tmp_path).poses()  # the only .npy file of a folder
    assert np.array_equal(other.signal, pose.signal)
    write_hologram(tmp_path / "second.npy")
    with pytest.raises(UserError, match="no such file"):
        opened(tmp_path)


@pytest.mark.parametrize("sign", [None, -1, 1])
def test_the_phase_of_the_antenna_is_subtracted_with_either_sign(tmp_path, sign):
    path = write_hologram(tmp_path / "letter.npy", n=9)
    plain = next(iter(opened(path).poses())).signal
    f = np.array([21e9, 23e9])
    np.savetxt(tmp_path / "antenna_phase.txt", [f, (f - 21e9) * 1e-9])
    scan = opened(path, ImportOptions(phase_sign=sign))
    assert scan.manifest.waveform.path_bias_m == 0
    corrected = next(iter(scan.poses())).signal / plain
    phase = (HOLOGRAM_FREQUENCIES - 21e9) * 1e-9
    # exp(-j phase) on a signal that runs as exp(-j k d): the opposite on its conjugate.
    assert np.abs(corrected - np.exp(1j * (sign or 1) * phase)).max() < 1e-5


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"data": np.zeros((2, 6, 4, 4), np.complex64)}, "array 1 has the wrong shape"),
        ({"data": np.array([{"a": 1}])}, "array 1 of 6 cannot be read"),
        ({"nf": np.array(5)}, "contradicts the samples, expected 6, got 5"),
        ({"data": np.ones((1, 4, 4), complex), "nf": np.array(1)}, "one frequency, but the last"),
        ({"f1": np.array(23e9)}, "last frequency must lie above the first"),
        ({"f1": np.array(22.0), "f2": np.array(22.5)}, "start_frequency_hz"),
        ({"step": np.array([[0.004, -0.004]])}, "steps must be positive"),
        ({"f1": np.array(np.nan)}, "first frequency must be 1 finite numbers"),
        ({"nf": np.array("eleven")}, "number of frequencies must be 1 finite numbers"),
    ],
)
def test_scans_that_make_no_sense_are_named(tmp_path, changes, text):
    with pytest.raises(UserError, match=text) as caught:
        opened(write_hologram(tmp_path / "letter.npy", n=4, **changes))
    assert "\n" not in str(caught.value)
