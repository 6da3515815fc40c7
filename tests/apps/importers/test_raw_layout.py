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
def test_chirps_that_shift_are_noticed(tmp_path, layout):
    words = words_of(beat(n_chirps=120), layout)
    path = tmp_path / "a.bin"
    path.write_bytes(np.delete(words, slice(43000, 43000 + 8 * 13)).tobytes() + bytes(8 * 26))
    (note,) = opened(path).notes if layout == "4-lane" else opened(path).notes[1:]
    late = 64 - 13 if layout == "4-lane" else 64 - 52
    assert f"chirps begin {late} samples late" in note


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


@pytest.mark.parametrize(("n_rx", "n_samples"), [(2, 64), (4, 256)])
@pytest.mark.parametrize("layout", ["iq", "iq-sequential"])
@pytest.mark.parametrize("in_phase", [False, True])
def test_pairs_of_receivers_alternate_or_follow_each_other(
    tmp_path, n_rx, n_samples, layout, in_phase
):
    """Receivers nearly in phase that alternate are nearly a signal when read in sequence."""
    rng = np.random.default_rng(9)
    signal = beat(n_chirps=512 // n_rx, n_rx=n_rx, n_samples=n_samples, noise=0.0)
    if in_phase:
        turns = np.exp(1j * rng.normal(0, 0.3, (1, n_rx, 1)))
        signal = signal[:, :1] * turns
    signal = quantised(signal + 20 * rng.normal(size=(*signal.shape, 2)) @ [1, 1j])
    recording = opened(write_words(tmp_path / "a.bin", signal, layout), raw=RawManifest(n_rx=n_rx))
    assert (recording.evidence.order.layout, recording.evidence.n_samples) == (layout, n_samples)
    assert np.array_equal(samples(recording), signal)


def test_one_receiver_is_said_to_be_assumed(tmp_path):
    path = write_words(tmp_path / "a.bin", beat(), "iq-sequential")
    recording = opened(path)
    assert recording.evidence.order.n_rx == 1
    assert any("n_rx (receivers) is not known" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("kind", "scale", "named"),
    [
        ("<f4", 1e-4, "floating-point numbers of 32 bits"),
        ("<f8", 3e4, "floating-point numbers of 64 bits"),
        ("<c8", 3e4, "floating-point numbers of 32 bits"),
        ("<c16", 1e-4, "floating-point numbers of 64 bits"),
        (">f4", 1.0, "floating-point numbers of 32 bits"),
        ("<f2", 3.0, "floating-point numbers of 16 bits"),
        ("<i4", 1.0, "integers of 32 bits"),
        ("i1", 0.04, "integers of 8 bits"),
        (">i2", 1.0, "big-endian integers of 16 bits"),
    ],
)
def test_numbers_of_other_kinds_are_no_words(tmp_path, kind, scale, named):
    signal = beat().reshape(-1) * scale / (32768 if kind[1] in "f8c" else 1)
    values = signal if "c" in kind else np.stack([signal.real, signal.imag], axis=-1)
    (np.round(values) if "i" in kind else values).astype(kind).tofile(tmp_path / "a.bin")
    with pytest.raises(UserError, match=named):
        opened(tmp_path / "a.bin")


@pytest.mark.parametrize("n_together", [1, 4])
def test_blocks_of_i_and_q_are_no_real_samples(tmp_path, n_together):
    pairs = words_of(beat(), "iq-sequential").reshape(-1, n_together, 64, 2)
    np.moveaxis(pairs, -1, 1).tofile(tmp_path / "a.bin")
    with pytest.raises(UserError, match="write I and Q as arrays"):
        opened(tmp_path / "a.bin", raw=RawManifest(n_rx=4), n_samples=64)


@pytest.mark.parametrize(("amplitude", "offset"), [(3, True), (300, False), (30000, True)])
def test_words_of_any_amplitude_are_no_floating_point_numbers(tmp_path, amplitude, offset):
    signal = beat()
    signal = np.round(signal * amplitude / np.abs(signal).max())
    path = write_words(tmp_path / "a.bin", signal, "2-lane-sequential", offset_binary=offset)
    assert opened(path).evidence.order.layout == "2-lane-sequential"


def packets_without(data, lost):
    """Bytes of a recording without some of its packets."""
    parts = [data[k : k + 1456] for k in range(0, len(data), 1456)]
    return b"".join(part for k, part in enumerate(parts) if k not in lost)


@pytest.mark.parametrize(
    ("layout", "given", "lost"),
    [
        ("4-lane", False, {60}),
        ("2-lane-sequential", True, {190}),
        ("iq", False, {350}),
        ("4-lane", True, {40, 200, 320}),
        ("2-lane-sequential", False, {100, 101, 102}),
        ("iq", True, {60}),
    ],
)
def test_lost_packets_are_put_back_as_zeros(tmp_path, layout, given, lost):
    signal = beat(n_chirps=600, noise=0.0)
    path = tmp_path / "a.bin"
    path.write_bytes(packets_without(words_of(signal, layout).tobytes(), lost))
    recording = opened(path, raw=RawManifest(n_rx=4), **({"n_samples": 64} if given else {}))
    assert recording.n_frames == 600
    first = min(lost) * 1456 // 1024
    assert any(f"lost after {first} whole frames" in note for note in recording.notes)
    wrong = (samples(recording) != signal).any(axis=(1, 2))
    # Chirps that a lost packet meets, 1.4 each.
    assert 0 < wrong.sum() <= 3 * len(lost)


@pytest.mark.parametrize(
    ("kept", "given"),
    [
        (lambda k: k % 2 == 0, False),
        (lambda k: k % 3 < 2, True),
        (lambda k: k % 5 < 3, False),
    ],
)
def test_packets_that_are_missing_throughout_are_no_chirps(tmp_path, kept, given):
    data = words_of(beat(n_chirps=1200), "2-lane-sequential").tobytes()
    lost = {k for k in range(len(data) // 1456 + 1) if not kept(k)}
    (tmp_path / "a.bin").write_bytes(packets_without(data, lost))
    with pytest.raises(UserError, match="packets are missing at many places") as caught:
        opened(tmp_path / "a.bin", **({"n_samples": 64} if given else {}))
    assert "n_samples" not in str(caught.value)


@pytest.mark.parametrize("n_samples", [364, 182, 104, 52])
def test_chirps_as_long_as_packets_are_read(tmp_path, n_samples):
    signal = beat(n_chirps=200, n_samples=n_samples)
    recording = opened(write_words(tmp_path / "a.bin", signal, "2-lane-sequential"))
    assert recording.evidence.n_samples == n_samples
    assert np.array_equal(samples(recording), signal)
