"""Tiny captures of point targets, straight from the signal equation."""

import json

import numpy as np

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.scene import Capture, Pose, Waveform


def waveform_of(n_samples=32, path_bias_m=0.15):
    """Chirp of the same bandwidth with another number of samples."""
    return Waveform(
        start_frequency_hz=77.3704e9,
        chirp_slope_hz_per_s=70.15e12,
        sample_rate_hz=10e6 * n_samples / 512,
        n_samples=n_samples,
        path_bias_m=path_bias_m,
    )


WAVEFORM = waveform_of()
TARGETS = np.array([[0.02, 0.01, 0.0], [-0.01, 0.03, 0.02], [0.0, -0.02, -0.03]])


def white_noise(shape, dtype=np.complex128, *, scale=1.0, seed=5):
    rng = np.random.default_rng(seed)
    return (scale * (rng.normal(size=shape) + 1j * rng.normal(size=shape))).astype(dtype)


def point_signal(tx, rx, targets, waveform=WAVEFORM):
    """sum_x exp(-j 2 pi (nu + k t) d / c), d with the instrument delay."""
    path = np.linalg.norm(targets[None] - tx[:, None], axis=2)
    path += np.linalg.norm(targets[None] - rx[:, None], axis=2) + waveform.path_bias_m
    phase = 2 * np.pi * path[:, :, None] * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    return np.exp(-1j * phase).sum(axis=1).astype(np.complex64)


def point_pose(angle_deg=0.0, *, targets=TARGETS, n_side=6, spacing_m=0.006, standoff_m=0.4):
    angle = np.deg2rad(angle_deg)
    outward = np.array([np.cos(angle), np.sin(angle), 0.0])
    horizontal = np.array([-np.sin(angle), np.cos(angle), 0.0])
    vertical = np.array([0.0, 0.0, 1.0])
    steps = (np.arange(n_side) - (n_side - 1) / 2) * spacing_m
    y, z = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    center = standoff_m * outward + y[:, None] * horizontal + z[:, None] * vertical
    tx, rx = center + 0.0025 * horizontal, center - 0.0025 * horizontal
    return Pose(
        signal=point_signal(tx, rx, targets),
        tx_positions=tx,
        rx_positions=rx,
        axes=np.stack([-outward, horizontal, vertical]),
        name=f"{round(angle_deg / 10)}_{angle_deg:g}_0",
        angle_deg=float(angle_deg),
    )


def point_capture(n_poses=3, **options):
    angles = 360.0 / n_poses * np.arange(n_poses)
    return Capture(
        waveform=WAVEFORM,
        poses=tuple(point_pose(angle, **options) for angle in angles),
        provenance={"importer": "test"},
    )


CAPTURE_JSON = {
    "start_frequency_hz": WAVEFORM.start_frequency_hz,
    "chirp_slope_hz_per_s": WAVEFORM.chirp_slope_hz_per_s,
    "adc_sample_rate_hz": WAVEFORM.sample_rate_hz,
    "n_adc_samples": WAVEFORM.n_samples,
    "path_bias_m": WAVEFORM.path_bias_m,
    "box_size_m": [0.22],
    "wall_thickness_m": 0.004,
    "wall_permittivity": 1.6,
}


def write_frame(folder, pose, dtype=np.float32):
    folder.mkdir(parents=True)
    np.save(folder / "tpos.npy", pose.tx_positions.astype(dtype))
    np.save(folder / "rpos.npy", pose.rx_positions.astype(dtype))
    np.save(folder / "adcr.npy", pose.signal.real)
    np.save(folder / "adci.npy", pose.signal.imag)
    np.save(folder / "rotation.npy", pose.axes.T.astype(dtype))


def write_geraf_sens(folder, capture, *, parameters=CAPTURE_JSON):
    for index, pose in enumerate(capture.poses):
        write_frame(folder / "mf" / f"{index}_{pose.angle_deg:g}_0", pose)
    if parameters is not None:
        (folder / "capture.json").write_text(json.dumps(parameters))
    return folder
