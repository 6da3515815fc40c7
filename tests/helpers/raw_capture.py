"""Raw captures of a TI board, written word by word as its manuals say."""

import json
import struct

import numpy as np

from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers._recording import open_recording
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.io.manifest import RadarManifest
from geraf2.io.samples import complex_samples
from geraf2.scene import Waveform

WAVEFORM = Waveform(
    start_frequency_hz=77.36e9,
    chirp_slope_hz_per_s=60e12,
    sample_rate_hz=1e6,
    n_samples=64,
    path_bias_m=0.15,
)
# The ramp starts 6 us before the first sample.
RADAR = {
    "start_frequency_hz": 77e9,
    "chirp_slope_hz_per_s": 60e12,
    "sample_rate_hz": 1e6,
    "adc_start_s": 6e-6,
    "path_bias_m": 0.15,
}
RADAR_TOML = "".join(f"{name} = {value}\n" for name, value in RADAR.items())
BOARD_RX = np.array(
    [[0.0, -0.0107, 0.0], [0.0, -0.0088, 0.0], [0.0, -0.0069, 0.0], [0.0, -0.005, 0.0]]
)
TARGET = np.array([0.35, 0.01, -0.01])


def beat(n_chirps=40, n_rx=4, n_samples=64, *, noise=0.01, seed=0):
    """Three echoes at positive beat frequencies, other phases in each receiver."""
    rng = np.random.default_rng(seed)
    t = np.arange(n_samples) / n_samples
    phases = rng.uniform(0, 2 * np.pi, (1, n_rx, 3, 1))
    waves = np.exp(1j * (2 * np.pi * np.array([[3.3], [5.1], [7.4]]) * t + phases)).sum(axis=2)
    noises = rng.normal(size=(n_chirps, n_rx, n_samples, 2)) @ [1, 1j]
    return quantised(800 * (waves + noise * noises))


def echo(tx, rx, targets=TARGET[None], waveform=WAVEFORM, amplitude=800.0):
    """Raw phase exp(+j 2 pi f d / c), as the board has it, (n_antennas, n_samples)."""
    path = np.linalg.norm(targets[None] - tx[:, None], axis=2)
    path += np.linalg.norm(targets[None] - rx[:, None], axis=2) + waveform.path_bias_m
    phase = 2 * np.pi * path[:, :, None] * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    return quantised(amplitude * np.exp(1j * phase).sum(axis=1))


def quantised(signal):
    return np.round(signal.real) + 1j * np.round(signal.imag)


def words_of(signal, layout="4-lane", *, offset_binary=False, swap_iq=False):
    """16-bit words of chirps (n_chirps, n_rx, n_samples), in the order of the layout."""
    parts = (signal.imag, signal.real) if swap_iq else (signal.real, signal.imag)
    words = np.stack(parts).astype(np.int64)  # I or Q, chirp, receiver, sample
    _, n_chirps, n_rx, n_samples = words.shape
    if layout == "2-lane-sequential":
        words = words.reshape(2, n_chirps, n_rx, -1, 2).transpose(1, 2, 3, 0, 4)
    elif layout == "iq-sequential":
        words = words.transpose(1, 2, 3, 0)
    else:
        n_together = {"4-lane": n_rx, "2-lane-pairs": 2, "iq": 1}[layout]
        words = words.reshape(2, n_chirps, -1, n_together, n_samples).transpose(1, 4, 2, 0, 3)
    values = words.reshape(-1)
    return (values + 32768).astype("<u2") if offset_binary else values.astype("<i2")


def write_words(path, signal, layout="4-lane", **order):
    """File of the words of chirps, see `words_of`."""
    path.write_bytes(words_of(signal, layout, **order).tobytes())
    return path


def opened(path, options=None, **radar):
    """Recording of a file or folder."""
    return open_recording(path, RadarManifest(**radar), options or ImportOptions())


def samples(recording):
    """All chirps, (n_chirps, n_rx, n_samples)."""
    frames = recording.read_frames(0, recording.n_frames)
    return frames.reshape(-1, *frames.shape[3:])


def whole_pose(scan):
    """Signal, transmitters and receivers of all parts of a scan of one pose."""
    parts = list(scan.poses())
    signal, tx, rx = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("signal", "tx_positions", "rx_positions")
    )
    assert scan.integers == (signal.dtype == np.int16)
    assert scan.n_antennas == (len(signal),)
    return complex_samples(signal), tx, rx


def packets_of(data, payload=1456):
    """UDP packets with sequence number from 1 and count of the bytes before."""
    return [
        struct.pack("<IQ", number + 1, at)[:10] + data[at : at + payload]
        for number, at in enumerate(range(0, len(data), payload))
    ]


def raster_positions(n_rows, n_columns, step_m, *, serpentine=False):
    positions = []
    for row in range(n_rows):
        columns = range(n_columns)
        for column in reversed(columns) if serpentine and row % 2 else columns:
            y = (column - (n_columns - 1) / 2) * step_m
            positions.append([0.0, y, (row - (n_rows - 1) / 2) * step_m])
    return np.array(positions)


def scan_signal(positions, rx_offsets=BOARD_RX):
    """One chirp a position, transmitter at the position, (n_positions, n_rx, n_samples)."""
    tx = np.repeat(positions, len(rx_offsets), axis=0)
    rx = (positions[:, None] + rx_offsets).reshape(-1, 3)
    return echo(tx, rx).reshape(len(positions), len(rx_offsets), -1)


STUDIO = json.loads("""
{"mmWaveDevices": [{
  "rfConfig": {
    "rlChanCfg_t": {"rxChannelEn": "0xF", "txChannelEn": "0x1"},
    "rlAdcOutCfg_t": {"fmt": {"b2AdcBits": 2, "b2AdcOutFmt": 1}},
    "rlProfiles": [{"rlProfileCfg_t": {
      "profileId": 0, "startFreqConst_GHz": 77.0, "freqSlopeConst_MHz_usec": 60.0,
      "adcStartTimeConst_usec": 6.0, "numAdcSamples": 64, "digOutSampleRate": 1000}}],
    "rlChirps": [{"rlChirpCfg_t": {
      "chirpStartIdx": 0, "chirpEndIdx": 0, "profileId": 0, "txEnable": "0x1"}}],
    "rlFrameCfg_t": {"chirpStartIdx": 0, "chirpEndIdx": 0, "numLoops": 2, "numFrames": 20,
      "framePeriodicity_msec": 4.0}},
  "rawDataCaptureConfig": {
    "rlDevDataFmtCfg_t": {"chInterleave": 0}, "rlDevLaneEnable_t": {"laneEn": "0xF"}}}]}
""")

PROFILE = """% made by hand
channelCfg 15 3 0
adcCfg 2 1
profileCfg 0 77 7 6 60 0 0 60 1 64 1000 0 0 30
chirpCfg 0 0 0 0 0 0 0 1
chirpCfg 1 1 0 0 0 0 0 2
frameCfg 0 1 10 2 50 1 0
"""
