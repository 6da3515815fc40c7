"""Real samples are refused, also where a single echo makes them look complex."""

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.io.manifest import RawManifest
from helpers.raw_capture import beat, opened, write_words


def real_words(frequencies, *, interleaved, n_samples=128, noise=3, seed=0):
    """48 chirps of four receivers with echoes at these shares of the sample rate."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (1, 4, len(frequencies), 1))
    times = np.arange(n_samples)
    signal = np.cos(2 * np.pi * np.array(frequencies)[:, None] * times + phases).sum(axis=2)
    signal = 900 * np.repeat(signal, 48, axis=0) + noise * rng.normal(size=(48, 4, n_samples))
    chirps = np.round(signal).astype("<i2")
    return chirps.transpose(0, 2, 1) if interleaved else chirps


@pytest.mark.parametrize("interleaved", [False, True])
@pytest.mark.parametrize("n_samples", [128, 256])
@pytest.mark.parametrize("frequency", np.linspace(0.01, 0.4, 14))
def test_a_single_real_echo_never_passes_for_complex(tmp_path, interleaved, n_samples, frequency):
    path = tmp_path / "a.bin"
    words = real_words([frequency], interleaved=interleaved, n_samples=n_samples)
    path.write_bytes(words.tobytes())
    with pytest.raises(UserError, match="real"):
        opened(path)


@pytest.mark.parametrize("seed", range(6))
def test_two_real_echoes_never_pass_for_complex(tmp_path, seed):
    path = tmp_path / "a.bin"
    frequencies = np.random.default_rng(seed).uniform(0.02, 0.4, 2)
    path.write_bytes(real_words(frequencies, interleaved=seed % 2 == 0, seed=seed).tobytes())
    with pytest.raises(UserError, match=r"real|cannot be found out"):
        opened(path)


@pytest.mark.parametrize("layout", ["4-lane", "2-lane-sequential", "2-lane-pairs", "iq"])
@pytest.mark.parametrize("noise", [0.01, 0.1])
@pytest.mark.parametrize("offset", [False, True])
def test_complex_samples_are_none_of_these(tmp_path, layout, noise, offset):
    signal = beat(noise=noise)
    signal[:, 2] = 0  # a dead receiver
    recording = opened(write_words(tmp_path / "a.bin", signal, layout, offset_binary=offset))
    assert recording.evidence.order.layout == layout


def test_a_layout_that_is_given_is_believed(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(real_words([0.24], interleaved=True).tobytes())
    given = RawManifest(layout="4-lane", n_rx=4, offset_binary=False)
    assert opened(path, n_samples=64, raw=given).evidence.order.layout == "4-lane"
