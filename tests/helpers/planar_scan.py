"""A planar scan with stepped frequencies, written as its readers expect it."""

import numpy as np

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.scene import Pose, Waveform

FREQUENCIES = np.linspace(22.2e9, 26.2e9, 11)
STEP = 0.003
# Horizontal and vertical in the plane, and depth.
TARGETS = np.array([[0.012, -0.009, 0.09], [-0.015, 0.006, 0.09]])


HOLOGRAM_FREQUENCIES = np.linspace(22e9, 22.5e9, 6)
HOLOGRAM_STEP = 0.004
# An L of points, 40 x 30 mm.
LETTER = np.concatenate(
    [
        np.column_stack([np.full(9, -0.018), np.linspace(-0.02, 0.02, 9)]),
        np.column_stack([np.linspace(-0.013, 0.012, 6), np.full(6, -0.02)]),
    ]
)


def letter_pose(positions, n_frequencies=1, slope_hz_per_s=1e14):
    """The L 0.1 m before antennas that see it at 22 GHz and a bit."""
    waveform = Waveform(
        start_frequency_hz=22e9,
        chirp_slope_hz_per_s=slope_hz_per_s,
        sample_rate_hz=1e6,
        n_samples=n_frequencies,
        path_bias_m=0.1,
    )
    points = np.column_stack([np.full(len(LETTER), 0.1), LETTER])
    distance = 2 * np.linalg.norm(positions[:, None] - points, axis=2) + waveform.path_bias_m
    k = 2 * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    signal = np.exp(-1j * distance[:, :, None] * k).sum(axis=1).astype(np.complex64)
    antennas = {"tx_positions": positions, "rx_positions": positions}
    return Pose(signal=signal, axes=np.eye(3), **antennas), waveform


def write_hologram(path, *, depth=0.1, n=31, frequencies=HOLOGRAM_FREQUENCIES, **changes):
    """Complex samples I + jQ of an L, of echoes exp(+j k d), and a constant leakage."""
    along = (np.arange(n) - (n - 1) / 2) * HOLOGRAM_STEP
    frequencies = np.atleast_1d(frequencies)
    data = np.zeros((len(frequencies), n, n), dtype=np.complex128)
    for across, up in LETTER:
        distance = np.sqrt((along[:, None] - across) ** 2 + (along - up) ** 2 + depth**2)
        data += np.exp(4j * np.pi * frequencies[:, None, None] * distance / SPEED_OF_LIGHT_M_PER_S)
    arrays = {
        "data": 1e-3 * data + 0.1 + 0.05j,
        "f1": np.array(frequencies[0]),
        "f2": np.array(frequencies[-1]),
        "nf": np.array(len(frequencies), dtype=np.int32),
        "step": np.array([HOLOGRAM_STEP, HOLOGRAM_STEP]),
        "d": np.array(0.2),
        **changes,
    }
    with path.open("wb") as handle:
        for array in arrays.values():
            np.save(handle, array)
    return path


def antenna_phase(frequencies):
    return 2e-9 * 2 * np.pi * (frequencies - 22e9) + 0.3


def write_planar(folder, *, n_x=31, n_y=25, targets=TARGETS, flat=0.0, phase=True, **changes):
    """Echoes of points, and of a flat sheet right before the antennas, 40 mm away."""
    x = (np.arange(n_x) - (n_x - 1) / 2) * STEP
    y = (np.arange(n_y) - (n_y - 1) / 2) * STEP
    positions = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((n_x, n_y))], axis=-1)
    distance = 2 * np.linalg.norm(positions[..., None, :] - targets, axis=-1)
    k = 2 * np.pi * FREQUENCIES[:, None, None] / SPEED_OF_LIGHT_M_PER_S
    signal = np.exp(-1j * k[..., None] * distance).sum(axis=-1)
    signal = signal + flat * np.cos(40 * x)[:, None] * np.exp(-1j * k * 0.08)
    signal = signal * np.exp(1j * antenna_phase(FREQUENCIES))[:, None, None]
    # With a constant leakage.
    counts = np.round(2000 * signal + 30000 - 31000j)
    arrays = {
        "data": np.stack([-counts.imag, counts.real]).astype(np.uint16),
        "f1": np.array(FREQUENCIES[0]),
        "f2": np.array(FREQUENCIES[-1]),
        "nf": np.array(len(FREQUENCIES)),
        "step": np.array([STEP, STEP]),
        "d": np.array(0.09),
        **changes,
    }
    folder.mkdir(exist_ok=True)
    with (folder / "scan.npy").open("wb") as handle:
        for array in arrays.values():
            np.save(handle, array)
    if phase:
        f = np.linspace(22.2e9, 26.2e9, 81)
        np.savetxt(folder / "antenna_phase.txt", [f, antenna_phase(f)])
    return folder
