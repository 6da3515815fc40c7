"""Real samples: recognised, and read as the analytic signal at half the rate."""

import json

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers.import_capture import import_capture
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.imaging.volume import image_volume
from geraf2.io.manifest import AntennaManifest, RadarManifest, RasterManifest, RawManifest
from geraf2.scene import Grid, load_capture
from helpers.raw_capture import (
    BOARD_RX,
    RADAR,
    STUDIO,
    TARGET,
    WAVEFORM,
    beat,
    opened,
    raster_positions,
    scan_signal,
    write_words,
)

LAYOUTS = ("real-sequential", "real-alternating")
RANGE_BIN_M = SPEED_OF_LIGHT_M_PER_S / (2 * WAVEFORM.bandwidth_hz)
COMPLEX_LAYOUTS = ("4-lane", "2-lane-sequential", "2-lane-pairs", "iq")


def real_words(chirps, layout):
    """Words of real chirps (n_chirps, n_rx, n_samples)."""
    words = np.round(chirps).astype("<i2")
    return (words.transpose(0, 2, 1) if layout == "real-alternating" else words).tobytes()


def real_echoes(frequencies, *, n_samples=128, noise=3, seed=0):
    """48 chirps of four receivers with echoes at these shares of the sample rate."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (1, 4, len(frequencies), 1))
    times = np.arange(n_samples)
    signal = np.cos(2 * np.pi * np.array(frequencies)[:, None] * times + phases).sum(axis=2)
    return 900 * np.repeat(signal, 48, axis=0) + noise * rng.normal(size=(48, 4, n_samples))


# Shares of the sample rate at which chirps continue without jumps, so that the layout is asked.
UNCLEAR = (0.01, 0.07, 0.16, 0.25)


# There chirps of two receivers join without a jump, too: what is given is contradicted.
JOINED = {(0.07, 128), (0.16, 256)}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("n_samples", [128, 256])
@pytest.mark.parametrize("frequency", [0.01, 0.07, 0.16, 0.25, 0.37])
def test_a_single_real_echo_never_passes_for_complex(tmp_path, layout, n_samples, frequency):
    path = tmp_path / "a.bin"
    path.write_bytes(real_words(real_echoes([frequency], n_samples=n_samples), layout))
    # At a quarter of the rate a sequence of real samples is one of complex ones, too.
    text = "real|found out|middle" if frequency in (0.01, 0.25) else "the samples are real"
    with pytest.raises(UserError, match=text):
        opened(path)
    given = RawManifest(n_rx=4, layout=layout if round(frequency, 2) in UNCLEAR else None)
    if layout == "real-sequential" and (round(frequency, 2), n_samples) in JOINED:
        with pytest.raises(UserError, match="contradict the number of samples per chirp"):
            opened(path, n_samples=n_samples, raw=given)
        return
    evidence = opened(path, n_samples=n_samples, raw=given).evidence
    assert (evidence.order.layout, evidence.n_samples) == (layout, n_samples // 2)


@pytest.mark.parametrize("layout", COMPLEX_LAYOUTS)
@pytest.mark.parametrize(("noise", "offset"), [(0.01, True), (0.1, False)])
def test_complex_samples_are_none_of_these(tmp_path, layout, noise, offset):
    signal = beat(noise=noise)
    signal[:, 2] = 0  # a dead receiver
    recording = opened(write_words(tmp_path / "a.bin", signal, layout, offset_binary=offset))
    assert recording.evidence.order.layout == layout


def test_odd_numbers_and_configurations_of_the_other_kind_are_refused(tmp_path):
    path, profile = tmp_path / "a.bin", tmp_path / "a.cfg"
    path.write_bytes(real_words(real_echoes([0.2], n_samples=127), "real-sequential"))
    with pytest.raises(UserError, match=r"an odd number of real samples per chirp .* got 127"):
        opened(path, n_samples=127, raw=RawManifest(layout="real-sequential"))
    line = "profileCfg 0 77 7 6 60 0 0 60 1 {} 2000 0 0 30\nadcCfg 2 {}\n"
    options = ImportOptions(config=(profile,))
    path.write_bytes(real_words(real_echoes([0.2]), "real-sequential"))
    profile.write_text(line.format(128, 1))
    with pytest.raises(UserError, match=r"states complex ones, .* got real ones"):
        opened(path, options)
    write_words(path, beat())
    profile.write_text(line.format(64, 0))
    with pytest.raises(UserError, match=r"states real ones, .* got complex ones"):
        opened(path, options)


def real_scan(positions):
    """The recording that `scan_signal` would be with real samples, twice as many at twice the rate.

    A receiver without Q gives the cosine of the beat's phase 2 pi f(t) path / c.
    """
    tx, rx = np.repeat(positions, 4, axis=0), (positions[:, None] + BOARD_RX).reshape(-1, 3)
    path = np.linalg.norm(TARGET - tx, axis=1) + np.linalg.norm(TARGET - rx, axis=1)
    times = np.arange(2 * WAVEFORM.n_samples) / (2 * WAVEFORM.sample_rate_hz)
    frequency = WAVEFORM.start_frequency_hz + WAVEFORM.chirp_slope_hz_per_s * times
    path = path[:, None] + WAVEFORM.path_bias_m
    phase = 2 * np.pi * frequency * path / SPEED_OF_LIGHT_M_PER_S
    return (800 * np.cos(phase)).reshape(len(positions), 4, -1)


def focus_m(capture):
    """Where a capture focuses along x through the target [m], and how sharply."""
    grid = Grid(origin_m=(0.3, *TARGET[1:]), spacing_m=0.0005, shape=(200, 1, 1))
    volume = image_volume(capture, grid)
    return grid.axes_m[0][volume.argmax()], volume.max()


POSITIONS = raster_positions(8, 8, 0.002)
BOARD = {
    "raster": RasterManifest(n_rows=8, n_columns=8, row_step_m=0.002, column_step_m=0.002),
    "antennas": AntennaManifest(tx_offsets_m=[[0, 0, 0]], rx_offsets_m=BOARD_RX.tolist()),
}


@pytest.fixture(scope="module")
def complex_capture(tmp_path_factory):
    """Capture with complex samples, and where it focuses."""
    folder = tmp_path_factory.mktemp("complex")
    write_words(folder / "complex.bin", scan_signal(POSITIONS))
    radar = RadarManifest(**RADAR, **BOARD)
    import_capture("dca1000", folder / "complex.bin", folder / "a", radar=radar)
    capture = load_capture(folder / "a")
    at, sharp = focus_m(capture)
    assert at == pytest.approx(TARGET[0], abs=0.02 * RANGE_BIN_M)
    return capture, at, sharp


@pytest.mark.parametrize(
    ("given", "layout"),
    [
        ("profile", "real-sequential"),
        ("profile", "real-alternating"),
        ("studio", "real-alternating"),
        ("toml", "real-sequential"),
    ],
)
def test_real_samples_focus_where_complex_ones_do(tmp_path, complex_capture, given, layout):
    expected, at, sharp = complex_capture
    path = tmp_path / "real.bin"
    path.write_bytes(real_words(real_scan(POSITIONS), layout))
    radar, options = {**BOARD, "path_bias_m": WAVEFORM.path_bias_m}, ImportOptions()
    if given == "toml":
        numbers = {**RADAR, "sample_rate_hz": 2e6, "n_samples": 128, "raw": RawManifest(n_rx=4)}
        radar |= numbers
    else:
        options = ImportOptions(config=(written_config(tmp_path, given, layout),))
    import_capture("dca1000", path, tmp_path / "b", radar=RadarManifest(**radar), options=options)
    capture = load_capture(tmp_path / "b")
    assert capture.waveform == expected.waveform
    real_at, real_sharp = focus_m(capture)
    assert real_at == pytest.approx(at, abs=0.02 * RANGE_BIN_M)
    assert real_sharp == pytest.approx(sharp, rel=0.02)


def written_config(folder, kind, layout):
    """Configuration of `real_scan`, as the SDK or mmWave Studio writes it."""
    if kind == "profile":
        (folder / "a.cfg").write_text(
            "channelCfg 15 1 0\nadcCfg 2 0\nprofileCfg 0 77 7 6 60 0 0 60 1 128 2000 0 0 30\n"
            "chirpCfg 0 0 0 0 0 0 0 1\nframeCfg 0 0 1 64 128 50 1 0\n"
        )
        return folder / "a.cfg"
    text = json.dumps(STUDIO)
    interleave = 0 if layout == "real-alternating" else 1
    for old, new in [
        ('"b2AdcOutFmt": 1', '"b2AdcOutFmt": 0'),
        ('"numAdcSamples": 64', '"numAdcSamples": 128'),
        ('"digOutSampleRate": 1000', '"digOutSampleRate": 2000'),
        ('"numLoops": 2', '"numLoops": 1'),
        ('"numFrames": 20', '"numFrames": 64'),
        ('"chInterleave": 0', f'"chInterleave": {interleave}'),
    ]:
        text = text.replace(old, new)
    (folder / "a.mmwave.json").write_text(text)
    return folder / "a.mmwave.json"
