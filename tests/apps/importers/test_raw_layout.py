"""Order of the words and length of chirps where they are hard to see; dead receivers."""

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.io.manifest import RawManifest
from helpers.raw_capture import beat, opened, quantised, samples, words_of, write_words


def coupled(n_chirps=64, n_samples=256):
    """Echoes 30 dB below what the transmitter couples into the receivers, a tenth of a beat."""
    t = np.arange(n_samples) / n_samples
    rng = np.random.default_rng(3)
    phases = rng.uniform(0, 2 * np.pi, (n_chirps, 4, 1))
    walls = np.exp(1j * (2 * np.pi * 29.3 * t + phases))
    coupling = np.exp(2j * np.pi * 0.1 * t) * np.hanning(n_samples + 2)[1:-1] ** 0.25
    return quantised(200 * walls + 8000 * coupling)


@pytest.mark.parametrize("layout", ["2-lane-sequential", "iq"])
def test_whole_chirps_show_the_layout_where_coupling_leaks(tmp_path, layout):
    signal = coupled()
    recording = opened(write_words(tmp_path / "a.bin", signal, layout))
    order = recording.evidence.order
    assert (order.layout, order.n_rx, recording.evidence.n_samples) == (layout, 4, 256)
    assert np.array_equal(samples(recording), signal)
    with pytest.raises(UserError, match="contradict the layout given"):
        opened(tmp_path / "a.bin", raw=RawManifest(layout="iq" if layout != "iq" else "4-lane"))


def test_joined_captures_do_not_make_a_chirp_of_five(tmp_path):
    t = np.arange(64) / 64
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, (40, 4, 1))
    signal = quantised(900 * np.exp(1j * (2 * np.pi * 3.01 * t + np.repeat(phases, 5, axis=0))))
    recording = opened(write_words(tmp_path / "a.bin", signal))
    assert recording.evidence.n_samples == 64
    assert np.array_equal(samples(recording), signal)


@pytest.mark.parametrize("layout", ["4-lane", "2-lane-sequential"])
def test_a_first_capture_that_is_weak_hides_no_chirps(tmp_path, layout):
    signal = beat(n_chirps=60)
    signal[:5] = quantised(0.02 * signal[:5])
    recording = opened(write_words(tmp_path / "a.bin", signal, layout))
    assert recording.evidence.n_samples == 64
    assert np.array_equal(samples(recording), signal)


@pytest.mark.parametrize("layout", ["4-lane", "2-lane-sequential"])
def test_chirps_that_shift_are_noticed_at_the_end(tmp_path, layout):
    words = words_of(beat(n_chirps=120), layout)
    path = tmp_path / "a.bin"
    path.write_bytes(np.delete(words, slice(43000, 43000 + 8 * 13)).tobytes() + bytes(8 * 26))
    (note,) = opened(path).notes if layout == "4-lane" else opened(path).notes[1:]
    late = 64 - 13 if layout == "4-lane" else 64 - 52
    assert f"at the end, chirps begin {late} samples late" in note


def test_a_layout_that_another_beats_is_doubted(tmp_path):
    """Noise over the beat: the right order reaches 4 : 1, the wrong one 1 : 1."""
    path = write_words(tmp_path / "a.bin", beat(noise=1))
    given = {"offset_binary": False, "n_rx": 4}
    right = opened(path, raw=RawManifest(layout="4-lane", **given), n_samples=64)
    assert right.notes == ()
    wrong = opened(path, raw=RawManifest(layout="2-lane-pairs", **given), n_samples=64)
    (note,) = (note for note in wrong.notes if "doubtful" in note)
    assert "as 4-lane, two-complement" in note


@pytest.mark.parametrize("share", [0.0, 0.01, 1.0])
def test_dead_receivers_are_named(tmp_path, share):
    signal = beat()
    assert "dead receivers" not in dict(opened(write_words(tmp_path / "a.bin", signal)).facts)
    noise = np.random.default_rng(1).normal(size=(40, 64, 2)) @ [1, 1j]
    signal[:, 2] = quantised(share * 400 * noise)
    recording = opened(write_words(tmp_path / "b.bin", signal))
    reason = {0.0: "constant", 0.01: "dB below", 1.0: "noise"}[share]
    assert dict(recording.facts)["dead receivers"].startswith("2 (")
    (note,) = (note for note in recording.notes if "receiver 2 is dead" in note)
    assert reason in note
